#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Everything that has to pass: installs what is missing, checks the sources, builds and runs the tests as they are
# and under the sanitizers.
#   tests/run.sh                    all of it; under a sanitizer, of what reads others' bytes or has threads
#   tests/run.sh --preset NAME      one preset only, release, debug, asan or tsan, and all of its tests
#   tests/run.sh --fuzz SECONDS     every fuzz target for so long, from tests/fuzz/seeds (tests/fuzz/run.sh)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

usage="usage: $0 [--preset release|debug|asan|tsan | --fuzz SECONDS]"
presets=(release asan tsan)
is_whole=false
case "${1:-}" in
  "") ;;
  --preset) presets=("${2:?$usage}") && is_whole=true ;;
  --fuzz) exec tests/fuzz/run.sh "${2:?$usage}" ;;
  *) echo "$usage" >&2; exit 2 ;;
esac

jobs=$(nproc)
deploy/install-dependencies.sh --test

echo "== $SECONDS s  lint"
tests/lint/run.sh

export ASAN_OPTIONS=detect_stack_use_after_return=1:strict_string_checks=1
export UBSAN_OPTIONS=print_stacktrace=1
export LSAN_OPTIONS=suppressions=$PWD/tests/lsan_suppressions.txt:print_suppressions=0
# Debian's libraries are not instrumented: what they allocate and free by themselves is none of our races.
export TSAN_OPTIONS=second_deadlock_stack=1:ignore_noninstrumented_modules=1:suppressions=$PWD/tests/tsan_suppressions.txt
for preset in "${presets[@]}"; do
  folders=(core server client tests)
  # What takes minutes under a sanitizer and does nothing that other tests do not do, too: statistics over many trials,
  # accuracies over seconds, bits compared over whole recordings, the examples of the help; under tsan, what has one
  # thread.
  left_out=()
  case $preset in
    asan)
      # Others' bytes come in there. What the programs make of them is of the same parts.
      $is_whole ||
        folders=(core/{base,numerics,events,geometry,models,windows,detection,association,estimation,initialization,tracking} core/baselines/estimators server client/lib tests/fuzz)
      left_out=(SimulatedLines TheErrorsAreThoseOfTheCovariance TheReleasedCodeIsLessAccurate TracksSimulatedObject
        ManyDirections RotationBnbVariants NoCubeIsClaimed SessionPipelineStateTest.DamagedStates GoesOnWhereItWas
        GoOnWhereTheyWere TrialsTest TrialTest CliTest.Bench BenchServiceTest ExamplesOfEveryHelp
        ConnectionCutAtRandomPlaces ClientKilledAtRandomMoments)
      ;;
    tsan)
      # Nothing else has threads; what the programs do together, the tests of server/rpc do in one process.
      folders=(server client/lib)
      left_out=(SessionPipelineStateTest)
      ;;
  esac
  export GTEST_FILTER='*'
  ((${#left_out[@]} == 0)) || GTEST_FILTER+="-$(printf '*%s*:' "${left_out[@]}")"
  echo "== $SECONDS s  $preset: build"
  cmake --preset "$preset" -DEVPOSE_BUILD_TESTS=ON >/dev/null
  cmake --build --preset "$preset" -j "$jobs" --target "${folders[@]/%//all}"
  for folder in "${folders[@]}"; do
    echo "== $SECONDS s  $preset: tests of $folder"
    ctest --test-dir "build/$preset/$folder" -j "$jobs" --output-on-failure --no-tests=error
  done
done

#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Everything that has to pass: installs what is missing, checks the sources, builds and runs the tests as they are
# and under the sanitizers.
#   tests/run.sh                    all of it; under a sanitizer, of what reads others' bytes or has threads
#   tests/run.sh --preset NAME      one preset only, release, debug, asan or tsan, and all of its tests but, under a
#                                   sanitizer, those with the label "long"
#   tests/run.sh --tidy             clang-tidy on every source file, 10 to 25 s each (tests/lint/tidy.sh: on those that have changed)
#   tests/run.sh --fuzz SECONDS     every fuzz target for so long, from tests/fuzz/seeds (tests/fuzz/run.sh)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

usage="usage: $0 [--preset release|debug|asan|tsan | --tidy | --fuzz SECONDS]"
presets=(release asan tsan)
is_whole=false
case "${1:-}" in
  "") ;;
  --preset) presets=("${2:?$usage}") && is_whole=true ;;
  --tidy) exec tests/lint/tidy.sh --all ;;
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
  # Without --preset, what is run under a sanitizer is told by the label of the test (evpose_test in CMakeLists.txt).
  target=all
  selection=()
  case $preset in
    asan) label=untrusted_input ;;
    tsan) label=threads ;;
    *) label= ;;
  esac
  if [[ -n $label ]] && ! $is_whole; then
    target=evpose_tests_$label
    selection+=(--label-regex "^$label\$")
  fi
  [[ -z $label ]] || selection+=(--label-exclude '^long$')
  echo "== $SECONDS s  $preset: build"
  cmake --preset "$preset" -DEVPOSE_BUILD_TESTS=ON >/dev/null
  cmake --build --preset "$preset" -j "$jobs" --target "$target"
  echo "== $SECONDS s  $preset: tests"
  ctest --test-dir "build/$preset" -j "$jobs" --output-on-failure --no-tests=error "${selection[@]}"
done
echo "== $SECONDS s  done"

#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# All checks that must pass: installs missing packages, runs the static checks, builds and runs the tests in the release preset
# and under the sanitizers.
#   tests/run.sh                    everything; under a sanitizer, tests that read untrusted bytes or have threads
#   tests/run.sh --preset NAME      one preset (release, debug, asan or tsan) with all of its tests; under a sanitizer without
#                                   those with the label "long"
#   tests/run.sh --tidy             clang-tidy on every source file, 50 minutes on two cores (tests/lint/tidy.sh: on the changed files)
#   tests/run.sh --fuzz SECONDS     every fuzz target for this time, from tests/fuzz/seeds (tests/fuzz/run.sh)
#   tests/run.sh --adversary SECONDS [SEED]   a hostile tenant beside a live camera for this time (tests/adversary/mix.py)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

usage="usage: $0 [--preset release|debug|asan|tsan | --tidy | --fuzz SECONDS | --adversary SECONDS [SEED]]"
presets=(release asan tsan)
is_whole=false
case "${1:-}" in
  "") ;;
  --preset) presets=("${2:?$usage}") && is_whole=true ;;
  --tidy) exec tests/lint/tidy.sh --all ;;
  --fuzz) exec tests/fuzz/run.sh "${2:?$usage}" ;;
  --adversary)
    mix=(tests/adversary/mix.py --bin build/release --seconds "${2:?$usage}" --seed "${3:-$RANDOM}")
    deploy/install-dependencies.sh --test
    cmake --preset release >/dev/null
    cmake --build --preset release -j "$(nproc)" --target evpose evpose-server
    exec "${mix[@]}"
    ;;
  *) echo "$usage" >&2; exit 2 ;;
esac

jobs=$(nproc)
phases=()
begin() {
  phases+=("$(printf '== %5d s  %s' "$SECONDS" "$*")")
  echo "${phases[-1]}"
}
deploy/install-dependencies.sh --test

begin lint
tests/lint/run.sh
tests/lint/tidy.sh

export ASAN_OPTIONS=detect_stack_use_after_return=1:strict_string_checks=1
export UBSAN_OPTIONS=print_stacktrace=1
export LSAN_OPTIONS=suppressions=$PWD/tests/lsan_suppressions.txt:print_suppressions=0
# Debian's libraries are not instrumented, so races inside them would be reported falsely.
export TSAN_OPTIONS=second_deadlock_stack=1:ignore_noninstrumented_modules=1:suppressions=$PWD/tests/tsan_suppressions.txt
for preset in "${presets[@]}"; do
  # Without --preset, the labels of the tests select those for a sanitizer (evpose_test in CMakeLists.txt).
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
  begin "$preset: build"
  # In a folder of another compiler CMake would configure again without the variables of the preset.
  fresh=()
  if [[ $preset == asan && -f build/$preset/CMakeCache.txt ]] &&
    ! grep -q '^CMAKE_CXX_COMPILER:.*clang' "build/$preset/CMakeCache.txt"; then
    fresh=(--fresh)
  fi
  cmake --preset "$preset" "${fresh[@]}" -DEVPOSE_BUILD_TESTS=ON >/dev/null
  cmake --build --preset "$preset" -j "$jobs" --target "$target"
  begin "$preset: tests"
  ctest --test-dir "build/$preset" -j "$jobs" --output-on-failure --no-tests=error "${selection[@]}"
done
# All again, because they are far apart in a log.
begin "done"
printf '%s\n' "${phases[@]}"

#!/usr/bin/env bash
# Everything that has to pass: installs what is missing, checks the sources, builds and runs the tests as they are
# and under the sanitizers.
#   tests/run.sh                    all of it
#   tests/run.sh --preset NAME      one preset only: release, debug, asan or tsan
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

presets=(release asan tsan)
case "${1:-}" in
  "") ;;
  --preset) presets=("${2:?usage: $0 [--preset NAME]}") ;;
  *) echo "usage: $0 [--preset release|debug|asan|tsan]" >&2; exit 2 ;;
esac

jobs=$(nproc)
deploy/install-dependencies.sh --test

echo "== format"
git ls-files -z '*.h' '*.cc' | xargs -0 clang-format --dry-run --Werror

export ASAN_OPTIONS=detect_stack_use_after_return=1:strict_string_checks=1
export UBSAN_OPTIONS=print_stacktrace=1
# Debian's libraries are not instrumented: what they allocate and free by themselves is none of our races.
export TSAN_OPTIONS=second_deadlock_stack=1:ignore_noninstrumented_modules=1
for preset in "${presets[@]}"; do
  # No thread is seen from core: its own tests hold nothing that tsan could find.
  folders=(core server client tests)
  [[ $preset == tsan ]] && folders=(server client tests)
  echo "== $preset: build"
  cmake --preset "$preset" -DEVPOSE_BUILD_TESTS=ON >/dev/null
  cmake --build --preset "$preset" -j "$jobs" --target "${folders[@]/%//all}"
  for folder in "${folders[@]}"; do
    echo "== $preset: tests of $folder"
    ctest --test-dir "build/$preset/$folder" -j "$jobs" --output-on-failure --no-tests=error
  done
done

#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Runs every fuzz target, one after the other, under AddressSanitizer and UndefinedBehaviorSanitizer; stops at
# the first finding.
#   tests/fuzz/run.sh SECONDS [TARGET...]         each for this time
#   tests/fuzz/run.sh --runs COUNT [TARGET...]    each for this number of inputs
# The corpus stays in build/fuzz/corpus/TARGET, from which the next run continues. A finding is a file in
# build/fuzz/findings/TARGET; when it is fixed, copy it to tests/fuzz/findings/TARGET, which ordinary tests read.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

usage="usage: $0 SECONDS|--runs COUNT [TARGET...]"
if [[ ${1:?$usage} == --runs ]]; then
  limit=-runs=${2:?$usage}
  shift 2
else
  limit=-max_total_time=$1
  shift
fi
[[ ${limit#*=} =~ ^[0-9]+$ ]] || { echo "$usage" >&2; exit 2; }
targets=("$@")
if ((${#targets[@]} == 0)); then
  for source in tests/fuzz/*_fuzz.cc; do targets+=("$(basename "$source" _fuzz.cc)"); done
fi

# The maximum length of an input, bytes: enough to reach all code of a target.
longest() {
  case $1 in
    track) echo 256 ;;
    checkpoint | decoder) echo 512 ;;
    *) echo 2048 ;;
  esac
}

# Entropic scheduling, which prefers inputs that reach rare code; off for `track`, where it takes a tenth of the time.
weighs_rare() {
  case $1 in
    track) echo 0 ;;
    *) echo 1 ;;
  esac
}

# AddressSanitizer's quarantine of freed memory, MB. With the default of 256 the heap of text_files grew beyond a gigabyte; with
# this value it stays below 300 MB. An input of `track` uses a tenth of a megabyte; a small quarantine keeps the memory in the
# cache.
quarantine_mb() {
  case $1 in
    track) echo 1 ;;
    *) echo 8 ;;
  esac
}

deploy/install-dependencies.sh --test
export UBSAN_OPTIONS=print_stacktrace=1
export LSAN_OPTIONS=suppressions=$PWD/tests/lsan_suppressions.txt:print_suppressions=0
cmake --preset fuzz >/dev/null
cmake --build --preset fuzz --target "${targets[@]/#/fuzz_}"
for target in "${targets[@]}"; do
  folders=()
  for folder in tests/fuzz/seeds/"$target" tests/fuzz/findings/"$target"; do
    [[ -d $folder ]] && folders+=("$folder")
  done
  mkdir -p "build/fuzz/corpus/$target" "build/fuzz/findings/$target"
  echo "== fuzz $target"
  # Short allocation stacks (malloc_context_size) save time; reproduce a finding without it to see the full stacks.
  ASAN_OPTIONS=quarantine_size_mb=$(quarantine_mb "$target"):malloc_context_size=4
  export ASAN_OPTIONS
  "build/fuzz/tests/fuzz/fuzz_$target" "$limit" -max_len="$(longest "$target")" -timeout=20 -rss_limit_mb=4096 \
    -entropic="$(weighs_rare "$target")" -print_final_stats=1 -print_funcs=0 -verbosity=0 \
    -artifact_prefix="build/fuzz/findings/$target/" \
    "build/fuzz/corpus/$target" "${folders[@]}"
done

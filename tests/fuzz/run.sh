#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Runs every fuzz target, one after the other, under address and undefined sanitizers; stops at the first finding.
#   tests/fuzz/run.sh SECONDS [TARGET...]         each for so long
#   tests/fuzz/run.sh --runs COUNT [TARGET...]    each for so many inputs
# What it learns stays in build/fuzz/corpus/TARGET, where the next run goes on. A finding is a file in
# build/fuzz/findings/TARGET; once mended it belongs into tests/fuzz/findings/TARGET, where ordinary tests look at it.
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

# Bytes of an input, at most: what it takes to reach everything a target has.
longest() {
  case $1 in
    track) echo 256 ;;
    checkpoint | decoder) echo 512 ;;
    *) echo 2048 ;;
  esac
}

# Whether inputs that reach what few others reach are tried more, which takes `track` a tenth of its time.
weighs_rare() {
  case $1 in
    track) echo 0 ;;
    *) echo 1 ;;
  esac
}

# Megabytes of what was freed that are kept from use for a while; by default 256 and a multiple in a heap full of holes:
# text_files grew beyond a gigabyte, and keeps below 300 MB like this. An input of `track` uses a tenth of a megabyte in
# all, and the memory is warm again when it comes back.
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
  # A finding shows where its memory came from when it is run again by itself.
  ASAN_OPTIONS=quarantine_size_mb=$(quarantine_mb "$target"):malloc_context_size=4
  export ASAN_OPTIONS
  "build/fuzz/tests/fuzz/fuzz_$target" "$limit" -max_len="$(longest "$target")" -timeout=20 -rss_limit_mb=4096 \
    -entropic="$(weighs_rare "$target")" -print_final_stats=1 -print_funcs=0 -verbosity=0 \
    -artifact_prefix="build/fuzz/findings/$target/" \
    "build/fuzz/corpus/$target" "${folders[@]}"
done

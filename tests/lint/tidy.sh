#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Runs clang-tidy with the checks of .clang-tidy, on one file per core at a time.
#   tests/lint/tidy.sh               the files that differ from the revision EVPOSE_TIDY_BASE, by default from the merge base with
#                                    origin/main, and files that are not committed yet. Where HEAD is that merge base, or there is no
#                                    origin/main, the files of the latest commit. tests/run.sh does this, too. 10 to 25 s per file
#   tests/lint/tidy.sh --since REV   the files that differ from REV, and files that are not committed yet
#   tests/lint/tidy.sh --all         every source file, 50 minutes on two cores
#   tests/lint/tidy.sh FILE.cc ...   these
# For a header, the source file of the same name is checked, or its test, or else a file that includes it.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

# $1: the preset, which decides about unity builds; $2: the build folder. The headers that protoc generates must exist.
configure() {
  cmake --preset "$1" -B "$2" -DEVPOSE_BUILD_TESTS=ON -DCMAKE_DISABLE_PRECOMPILE_HEADERS=ON >/dev/null
  cmake --build "$2" --target evpose_proto evpose_storage_proto >/dev/null
}

# Unknown options of g++ are not reported.
for option in unknown-warning-option ignored-optimization-argument; do arguments+=("-extra-arg=-Wno-$option"); done

# Most of the time is spent in the headers of libraries: in unity builds they are read once for up to eight files.
check_all() {
  configure release build/tidy_all
  run-clang-tidy -quiet -p build/tidy_all -j "$(nproc)" "${arguments[@]}" -checks=-bugprone-suspicious-include '^(?!.*/(generated|precompiled\.dir)/)'
}

default_base() {
  [[ -z ${EVPOSE_TIDY_BASE:-} ]] || { echo "$EVPOSE_TIDY_BASE"; return; }
  local base
  base=$(git merge-base HEAD origin/main 2>/dev/null || git rev-parse HEAD)
  [[ $base != "$(git rev-parse HEAD)" ]] || base=$(git rev-parse --verify --quiet HEAD^ || echo "$base")
  echo "$base"
}

# The source file by which a header is checked.
source_of() {
  local source=${1%.h}.cc test=${1%.h}_test.cc
  if [[ -f $source ]]; then echo "$source"
  elif [[ -f $test ]]; then echo "$test"
  else git grep -l --fixed-strings "#include \"$1\"" -- '*.cc' | head -n 1; fi
}

files_since() {
  { git diff --name-only --diff-filter=d "$1" -- '*.cc' '*.h'; git ls-files --others --exclude-standard '*.cc' '*.h'; } |
    while read -r file; do case $file in *.h) source_of "$file" ;; *) echo "$file" ;; esac; done | sort -u
}

case "${1:-}" in
  --all) check_all; exit ;;
  "" | --since)
    [[ $# -ne 1 ]] || { echo "usage: $0 [--since REV | --all | FILE.cc ...]" >&2; exit 2; }
    base=${2:-$(default_base)}
    git rev-parse --verify --quiet "$base^{commit}" >/dev/null || { echo "tidy: $base is not a revision" >&2; exit 2; }
    echo "tidy: files that differ from $(git rev-parse --short "$base")"
    mapfile -t files < <(files_since "$base")
    ;;
  -*) echo "usage: $0 [--since REV | --all | FILE.cc ...]" >&2; exit 2 ;;
  *) files=("$@") ;;
esac
((${#files[@]} > 0)) || { echo "tidy: no source file has changed"; exit 0; }

configure debug build/tidy
echo "tidy: ${#files[@]} files"
printf '%s\0' "${files[@]}" | xargs -0 -n 1 -P "$(nproc)" clang-tidy --quiet -p build/tidy "${arguments[@]}"

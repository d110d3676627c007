#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Runs clang-tidy with the checks of .clang-tidy, on one file per core at a time. It compiles each file separately: about 10 to 25 s each.
#   tests/lint/tidy.sh              the files that differ from the merge base with origin/main (without it: from the last commit), and
#                                   files that are not committed yet; for a header, the source file of the same name
#   tests/lint/tidy.sh --all        every source file
#   tests/lint/tidy.sh FILE.cc ...  these
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

case "${1:-}" in
  "")
    base=$(git merge-base HEAD origin/main 2>/dev/null || git rev-parse HEAD)
    echo "tidy: files that differ from $(git rev-parse --short "$base")"
    mapfile -t files < <({ git diff --name-only --diff-filter=d "$base" -- '*.cc' '*.h'; git ls-files --others --exclude-standard '*.cc' '*.h'; } |
      sed 's/\.h$/.cc/' | sort -u | while read -r file; do [[ ! -f $file ]] || echo "$file"; done)
    ;;
  --all) mapfile -t files < <(git ls-files '*.cc') ;;
  -*) sed -n '4,7s/^# //p' "$0" >&2; exit 2 ;;
  *) files=("$@") ;;
esac
((${#files[@]} > 0)) || { echo "tidy: no source file has changed"; exit 0; }

# As in the debug preset, without unity builds and precompiled headers. The headers that protoc generates must exist.
cmake --preset debug -B build/tidy -DEVPOSE_BUILD_TESTS=ON >/dev/null
cmake --build build/tidy --target evpose_proto evpose_storage_proto >/dev/null
echo "tidy: ${#files[@]} files"
# Unknown options of g++ are not reported.
printf '%s\0' "${files[@]}" | xargs -0 -n 1 -P "$(nproc)" clang-tidy --quiet -p build/tidy \
  --extra-arg=-Wno-unknown-warning-option --extra-arg=-Wno-ignored-optimization-argument

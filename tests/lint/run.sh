#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Static checks of the tree, 10 s of processor time: format and order of includes, citations, READMEs, sizes of files and functions,
# layers, style of the API, spelling, shell scripts. Debian has no linter for Dockerfiles.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

# files PATTERN...: the tracked and the new files that exist, each followed by a null byte.
files() {
  git ls-files -z --cached --others --exclude-standard "$@" |
    while IFS= read -rd '' file; do [[ ! -f $file ]] || printf '%s\0' "$file"; done
}

files '*.h' '*.cc' | xargs -0 clang-format --dry-run --Werror
python3 tests/lint/check_tree.py
python3 tests/lint/check_functions.py
python3 tests/lint/check_includes.py
python3 tests/lint/proto_lint.py
# Words that codespell would change: "nees" is a statistic, "fro" is part of "to and fro", PassTime is a function.
files ':!tests/fuzz/seeds' ':!tests/fuzz/findings' ':!tests/data/*/*' ':!*.png' ':!*package-lock.json' ':!LICENSE' |
  xargs -0 codespell --ignore-words-list nees,fro,passtime
# The scripts in tests/container are sourced by its run.sh and are checked together with it.
files '*.sh' .ci/run ':!tests/container' | xargs -0 shellcheck --external-sources --severity warning
(cd tests/container && shellcheck --check-sourced --external-sources --source-path SCRIPTDIR --severity warning run.sh)

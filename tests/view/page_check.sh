#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Checks and builds the page of evpose view in a copy of client/view/page: types, style, bundle, unit tests, size.
#   page_check.sh SOURCE COPY
# Exit status 77, with the reason, if node or npm is missing, or if the registry of npm cannot be reached.
set -euo pipefail

source=$1
copy=$2
command -v node >/dev/null && command -v npm >/dev/null || {
  echo "skipped: node or npm is missing: deploy/install-dependencies.sh --test installs them" >&2
  exit 77
}
if grep -q '"resolved"' "$source/package-lock.json"; then
  echo "$source/package-lock.json contains download addresses: run npm install there, with its .npmrc" >&2
  exit 1
fi

mkdir -p "$copy"
if ! cmp -s "$source/package-lock.json" "$copy/node_modules/.installed-lock"; then
  cp "$source/package.json" "$source/package-lock.json" "$source/.npmrc" "$copy"
  (cd "$copy" && npm ci --ignore-scripts --no-audit --no-fund --prefer-offline --loglevel=error) || {
    npm ping >/dev/null 2>&1 && exit 1
    echo "skipped: the registry of npm cannot be reached" >&2
    exit 77
  }
  cp "$source/package-lock.json" "$copy/node_modules/.installed-lock"
fi
rm -rf "${copy:?}/src" "${copy:?}/test" "${copy:?}/dev"
cp -r "$source/src" "$source/test" "$source/dev" "$copy"
cp "$source/package.json" "$source/build.mjs" "$source/tsconfig.json" "$source/eslint.config.js" "$copy"
cd "$copy"
npm run --silent check
npm run --silent build
npm run --silent test

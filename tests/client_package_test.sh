#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Tests the installed client library: deploy/example builds against it outside the project's tree, and receives poses with
# the same times from a server as evpose replay.
#   tests/client_package_test.sh BUILD_DIRECTORY
set -euo pipefail
build=$(realpath "${1:?usage: $0 BUILD_DIRECTORY}")
source=$(realpath "$(dirname "${BASH_SOURCE[0]}")/..")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

fail() { echo "client_package_test: $*" >&2; exit 1; }

cmake --install "$build" --component dev --prefix "$work/prefix" >"$work/log"
cp -r "$source/deploy/example" "$work/example"
# The prefix is moved, to test that no installed file refers to the build.
mv "$work/prefix" "$work/moved"
! grep -rqF -e "$source" -e "$build" "$work/moved/lib/cmake" || fail "the CMake package names paths of the build"
# The public headers: few, and independent of all but the standard library, Abseil and Eigen.
headers=$(find "$work/moved/include" -type f)
[[ $(wc -l <<<"$headers") -le 8 ]] || fail "more than 8 headers are installed: $headers"
! grep -n '#include' $headers | grep -vE '#include ("evpose/[a-z_]+\.h"|"absl/[a-z_/]+\.h"|<Eigen/[A-Za-z]+>|<[a-z_]+>)$' ||
  fail "a public header includes a header that is not installed with it"
{ cmake -S "$work/example" -B "$work/built" -DCMAKE_BUILD_TYPE=Release -DCMAKE_PREFIX_PATH="$work/moved" &&
  cmake --build "$work/built"; } >"$work/log" 2>&1 || { cat "$work/log" >&2; fail "the example does not build"; }

cd "$work"
evpose=$build/client/cli/evpose
"$evpose" simulate --object cube --camera vga --duration 0.1 --out cube >log 2>&1
"$evpose" replay cube/recording.raw --model cube/model.obj --camera cube/camera.yaml --out expected.csv >log 2>&1
coproc server { exec "$build/server/evpose-server" --store memory --listen 127.0.0.1:0 --log-level off; }
# shellcheck disable=SC2154  # coproc sets server_PID
trap 'kill "$server_PID" 2>/dev/null || true; rm -rf "$work"' EXIT
read -r _ _ address <&"${server[0]}"
built/track_recording cube/recording.raw cube/model.obj cube/camera.yaml "$address" >poses 2>said || { cat said >&2; fail "the example fails"; }
awk -F , 'NR > 1 { print $3, $11 }' expected.csv >expected.states
awk '{ print $1, $NF }' poses >pose.states
[[ -s pose.states ]] || fail "the example got no poses"
cmp pose.states expected.states || fail "the example has poses at other times, or with other states, than evpose replay"
[[ $(cat said) == "$(wc -l <pose.states) poses" ]] || fail "the example prints: $(cat said)"
if built/track_recording no-such.raw cube/model.obj cube/camera.yaml "$address" 2>said; then fail "a missing file is no error"; fi
grep -q 'no-such.raw' said || fail "the example prints for a missing file: $(cat said)"

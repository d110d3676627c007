#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The demonstration, from a bare Debian 12 machine to poses: installs, builds, simulates five seconds of a cube seen by an
# EVK4, replays the recording through a server over the network, which finds the cube without an initial pose and tracks
# it, and compares the poses with the truth.
#   deploy/demo.sh [DIRECTORY]      directory of recording, trajectories and picture; build/demo by default
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
out=${1:-build/demo}
bin=build/release

server_pid=
child_pid=
scratch=$(mktemp -d)
clean_up() {
  # The server is stopped last, so that the client can finish.
  [[ -z $child_pid ]] || kill -TERM "$child_pid" 2>/dev/null || true
  if [[ -n $server_pid ]]; then
    kill -TERM "$server_pid" 2>/dev/null || true
    wait "$server_pid" || true
  fi
  rm -rf "$scratch"
}
trap clean_up EXIT
trap 'exit 130' INT
trap 'exit 143' TERM
# Runs a command in the background and waits, because bash handles a signal only while no foreground program runs.
run() {
  "$@" &
  child_pid=$!
  wait "$child_pid"
  child_pid=
}

run deploy/install-dependencies.sh
run cmake --preset release -DEVPOSE_BUILD_TESTS=OFF >"$scratch/configure.log"
run cmake --build --preset release -j "$(nproc)" --target evpose evpose-server
mkdir -p "$out"

echo "== simulate: a cube seen by an EVK4, 5 s, 10 % noise"
rm -rf "$out/cube"
run "$bin/client/cli/evpose" simulate --object cube --duration 5 --noise 0.1 --seed 1 --out "$out/cube"

echo "== serve"
mkfifo "$scratch/server.out"
"$bin/server/evpose-server" --listen 127.0.0.1:0 --data-dir "$scratch/data" >"$scratch/server.out" 2>"$out/server.log" &
server_pid=$!
read -r _ _ address <"$scratch/server.out" || { cat "$out/server.log" >&2; exit 1; }
echo "evpose-server listens on $address"

inputs=(--model "$out/cube/model.obj" --camera "$out/cube/camera.yaml")
for estimator in mixture static-mm; do
  echo "== replay: $estimator"
  run "$bin/client/cli/evpose" replay "$out/cube/recording.raw" "${inputs[@]}" --server "$address" --rate max \
    --estimator "$estimator" --out "$out/$estimator.tum"
done

# A cube has 24 equivalent orientations: each pose is compared with the nearest of them.
echo "== evaluate"
run "$bin/client/cli/evpose" evaluate --symmetric --truth "$out/cube/truth.tum" "${inputs[@]}" \
  --estimate "evpose=$out/mixture.tum" --estimate "paper's static MM=$out/static-mm.tum"
run "$bin/client/cli/evpose" render "$out/cube/recording.raw" --poses "$out/mixture.tum" "${inputs[@]}" \
  --window-ms 30 -o "$out/picture.png"
echo "trajectory: $out/mixture.tum"
echo "picture:    $out/picture.png"
# The recording with its poses on a page in the browser. A build without node or the registry of npm has no page.
without_page=$(sed -n 's/^-- evpose view: left out: //p' "$scratch/configure.log")
if [[ -z $without_page ]]; then
  echo "to see it:  $bin/client/cli/evpose view $out/cube/recording.raw --poses $out/mixture.tum --truth $out/cube/truth.tum ${inputs[*]} --open"
else
  echo "page:       this build has none, so that evpose view cannot show the result: $without_page"
fi

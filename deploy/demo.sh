#!/usr/bin/env bash
# The main job, from a bare Debian 12 machine to poses: installs, builds, simulates five seconds of a cube seen by an
# EVK4, replays the recording through a server over the network, and compares the poses with the truth.
#   deploy/demo.sh [DIRECTORY]      where recording, trajectories and picture go; build/demo by default
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
out=${1:-build/demo}
bin=build/release

deploy/install-dependencies.sh
cmake --preset release -DEVPOSE_BUILD_TESTS=OFF >/dev/null
cmake --build --preset release -j "$(nproc)" --target evpose evpose-server
mkdir -p "$out"

server_pid=
stop_server() {
  [[ -z $server_pid ]] && return
  kill -TERM "$server_pid" 2>/dev/null || true
  wait "$server_pid" || true
  server_pid=
}
trap stop_server EXIT

echo "== simulate: a cube seen by an EVK4, 5 s, 10 % noise"
rm -rf "$out/cube"
"$bin/client/cli/evpose" simulate --object cube --duration 5 --noise 0.1 --seed 1 --out "$out/cube"

echo "== serve"
mkfifo "$out/server.out.$$"
"$bin/server/evpose-server" --listen 127.0.0.1:0 >"$out/server.out.$$" 2>"$out/server.log" &
server_pid=$!
read -r _ _ address <"$out/server.out.$$" || { cat "$out/server.log" >&2; exit 1; }
rm -f "$out/server.out.$$"
echo "evpose-server listens on $address"

inputs=(--model "$out/cube/model.obj" --camera "$out/cube/camera.yaml")
first_pose=$(head -n 1 "$out/cube/truth.tum" | cut -d ' ' -f 2-)
for estimator in mixture static-mm; do
  echo "== replay: $estimator"
  "$bin/client/cli/evpose" replay "$out/cube/recording.raw" "${inputs[@]}" --server "$address" --rate max \
    --init-pose "$first_pose" --estimator "$estimator" --out "$out/$estimator.tum"
done

echo "== evaluate"
"$bin/client/cli/evpose" evaluate --truth "$out/cube/truth.tum" "${inputs[@]}" \
  --estimate "evpose=$out/mixture.tum" --estimate "paper's static MM=$out/static-mm.tum"
"$bin/client/cli/evpose" render "$out/cube/recording.raw" --poses "$out/mixture.tum" "${inputs[@]}" -o "$out/picture.png"
echo "trajectory: $out/mixture.tum"
echo "picture:    $out/picture.png"

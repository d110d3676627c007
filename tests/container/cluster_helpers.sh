#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Functions of the tests of compose.cluster.yaml. To be sourced by cluster.sh and upgrade.sh.
compose_file=deploy/compose.cluster.yaml
project=evpose-cluster
servers=(evpose-cluster-server-{1,2,3}-1)
clients=(client-{1..6})
reference=$work/long/reference.tum

# Starts six clients through HAProxy, each at the rate of its camera, and the meter that reads their poses.
start_clients() {
  rm -f "$data"/*.tum "$data"/*.copy "$data/counts"
  coproc meter { exec python3 "$here/pose_meter.py" "$data" "${clients[@]}"; }
  # shellcheck disable=SC2154  # coproc sets it
  background=("$meter_PID")
  exec {meter_says}<&"${meter[0]}"  # can be read also after the meter has ended
  read -r _ <&"$meter_says"
  local name start starts=()
  # All clients start at once; otherwise, on a slow machine, the first would be far ahead of the last.
  for name in "${clients[@]}"; do
    docker run --detach --init --read-only --cap-drop ALL --name "$name" --network "${project}_outside" --volume "${project}_demo:/data" \
      "evpose-client:$version" replay /data/long/recording.raw --model /data/long/model.obj --camera /data/long/camera.yaml \
      --server haproxy:50051 --rate 1 --out "/data/$name.tum" >/dev/null &
    starts+=($!)
  done
  for start in "${starts[@]}"; do wait "$start" || fail "not all clients could be started"; done
  await "all six clients to get poses" are_all_above 0
}
counts() { cat "$data/counts" 2>/dev/null || echo 0; }
are_all_above() {
  local count
  for count in $(counts); do ((count > $1)) || return 1; done
}
# Waits until each of the six clients has received this number of further poses.
await_poses_each() {
  local most
  most=$(counts | tr ' ' '\n' | sort -n | tail -n 1)
  await "poses of all six" are_all_above $((most + $1))
}
all_are_streaming() { [[ $(docker inspect --format '{{.State.Running}}' "${clients[@]}" | grep -c true) == "${#clients[@]}" ]]; }
# Makes sure that the next fault occurs in the middle of six streams. On a slow machine a recording may have ended; then the
# clients are started again.
begin_fault() {
  local tries
  for tries in 1 2 3; do
    if all_are_streaming && is_above 0 poses_left; then
      await_poses_each 600
      ! all_are_streaming || return 0
    fi
    finish_clients "$1"
    start_clients
  done
  fail "$1: all $tries times a client ended before the first disturbance"
}
# The number of poses that the client that is furthest has left, less a reserve for the duration of the fault.
poses_left() { echo $(($(wc -l <"$reference") - 6000 - $(counts | tr ' ' '\n' | sort -n | tail -n 1))); }

# check_trajectory CLIENT FAULT: checks that a trajectory is identical to the reference. upgrade.sh has another one.
check_trajectory() { same "$data/$1.copy" "$reference" "$2, client $1"; }
verdict="6 trajectories identical"

# Checks the six trajectories. Prints the longest wait for a pose.
finish_clients() {
  local name longest_ms worst_ms=0
  for name in "${clients[@]}"; do [[ $(docker wait "$name") == 0 ]] || fail "$1: the client $name failed"; done
  while read -r name _ longest_ms; do
    check_trajectory "$name" "$1"
    worst_ms=$((longest_ms > worst_ms ? longest_ms : worst_ms))
  done <&"$meter_says"
  exec {meter_says}<&-
  background=()
  echo "$1: $verdict; outages of clients: $(outages); longest wait for a pose: $worst_ms ms"
  docker rm "${clients[@]}" >/dev/null
}
outages() {
  local name
  for name in "${clients[@]}"; do docker logs "$name" 2>&1 | grep -c ": connected again after" || true; done | paste -sd ' '
}
is_in_rotation() { [[ $(page 8404/metrics | grep "^haproxy_server_status{proxy=\"servers\",server=\"$1\",state=\"UP\"}" | cut -d ' ' -f 2) == 1 ]]; }
await_rotation() { await "HAProxy to send streams to $1" is_in_rotation "$1"; }

start_cluster() {
  local since=$SECONDS number
  compose up --detach --wait --no-build 2>&1 | tail -n 3
  echo "up: $((SECONDS - since)) s"
  docker volume create --label "com.docker.compose.project=$project" --label com.docker.compose.volume=demo "${project}_demo" >/dev/null
  docker run --rm --volume "${project}_demo:/data" --entrypoint true "evpose-client:$version"
  data=$(directory_of_volume "${project}_demo")
  cp -r "$work/long" "$data/"
  for number in 1 2 3; do await_rotation "server-$number"; done
}
stop_cluster() { compose --profile '*' down --volumes --remove-orphans 2>/dev/null; }

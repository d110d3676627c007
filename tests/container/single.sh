#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Tests compose.yaml. To be sourced by run.sh.
compose_file=deploy/compose.yaml
project=evpose
server=evpose-server-1
view=evpose-view-1
reference=$work/cube/reference.tum

# start_replay NAME [RATE]: starts the replay of the demo at this multiple of the rate of the camera, with poses in /data/NAME.tum.
start_replay() {
  compose run --detach --no-deps --name "$1" client replay /data/cube/recording.raw --model /data/cube/model.obj \
    --camera /data/cube/camera.yaml --server haproxy:50051 --rate "${2:-1}" --out "/data/$1.tum" >/dev/null
}
poses() { metric 9464 evpose_poses_total; }
# await_poses NAME COUNT: waits until 800 poses more than COUNT have been received.
await_poses() { await "poses of $1" is_above "$(($2 + 800))" poses; }
finish_replay() {
  [[ $(docker wait "$1") == 0 ]] || fail "$1: the client failed"
  same "$data/$1.tum" "$reference" "$1"
  docker rm "$1" >/dev/null
}
has_said() { [[ $(docker logs "$1" 2>&1) == *"$2"* ]]; }
was_away() { has_said "$1" "no connection for"; }
received() { metric 9464 evpose_received_bytes_total; }

check_images() {
  local target size said
  for target in server client; do
    size=$(docker image inspect --format '{{.Size}}' "evpose-$target:$version")
    echo "image of the $target: $((size / 1000000)) MB"
    [[ $target == client ]] || ((size < 500000000)) || fail "the server's image has $size bytes"
    [[ $(docker image inspect --format '{{.Config.User}}' "evpose-$target:$version") == 10001:10001 ]] || fail "the image of the $target runs as root"
    [[ $(label "$target" version) == "$version" && $(label "$target" revision) == "$revision" && $(label "$target" licenses) == Apache-2.0 ]] ||
      fail "the labels of the $target are wrong"
    [[ $(label "$target" title) == evpose* ]] || fail "the $target has no title"
    said=$(docker run --rm "evpose-$target:$version" --version)
    [[ $said == *"$version"*"$revision"* ]] || fail "the $target prints the version $said, not $version of $revision"
  done
}
label() { docker image inspect --format "{{index .Config.Labels \"org.opencontainers.image.$2\"}}" "evpose-$1:$version"; }

# check_confinement CONTAINER PATH: the container is that of a user without rights, and no file can be made at PATH.
check_confinement() {
  local status
  status=/proc/$(pid_of "$1")/status
  [[ $(awk '/^Uid:/ {print $2 $3 $4 $5}' "$status") == 10001100011000110001 ]] || fail "$1 runs as another user"
  [[ $(awk '/^CapBnd:/ {print $2}' "$status") =~ ^0+$ ]] || fail "$1 may get capabilities"
  [[ $(awk '/^NoNewPrivs:/ {print $2}' "$status") == 1 ]] || fail "$1 may get privileges"
  ! docker exec "$1" touch "$2" 2>/dev/null || fail "the root of $1 can be written to"
}

check_health() {
  # A health check runs every 10 s and must not leave a zombie process.
  docker exec "$server" evpose-health-check || fail "the health check in the image fails"
  [[ -z $(docker top "$server" -o pid,stat | awk '$2 ~ /^Z/') ]] || fail "there are zombies in the server's container"
}

check_bad_starts() {
  local image=evpose-server:$version
  one_line 2 "--insecure" "$image" --listen 0.0.0.0:50051
  one_line 1 "/run/no.crt" "$image" --tls-cert /run/no.crt --tls-key /run/no.key
  one_line 1 "/var/lib/evpose" --volume "$work:/var/lib/evpose:ro" "$image"
  one_line 1 "redis" "$image" --store redis://127.0.0.1:6379
  one_line 1 "in use" --network "container:$server" "$image" --store memory
  one_line 1 "cannot be reached" --entrypoint evpose-health-check "$image"
}

# asked EXPRESSION: prints the sum of an expression in Prometheus, or nothing if it has no value.
asked() {
  page 9090/api/v1/query "query=$1" | python3 -c '
import json, sys
result = json.load(sys.stdin)["data"]["result"]
print("%.0f" % sum(float(sample["value"][1]) for sample in result) if result else "")' 2>/dev/null
}
says() { [[ $(asked "$1") == "$2" ]]; }
has_rules() { [[ $(page 9090/api/v1/rules) == *EvposeServerDown* ]]; }

check_prometheus() {
  await "Prometheus to reach the server" says 'up{job="evpose"}' 1
  await "the poses in Prometheus" says evpose_poses_total "$(wc -l <"$reference")"
  await "the alerts in Prometheus" has_rules
  [[ $(page 9090/api/v1/rules) != *'"health":"err"'* ]] || fail "Prometheus cannot evaluate the alerts"
}

network_cut() {
  local before
  before=$(poses)
  start_replay cut
  await_poses cut "$before"
  docker network disconnect evpose_default "$server"
  await "the client to detect the outage" was_away cut
  docker network connect --alias server evpose_default "$server"
  finish_replay cut
}

is_published() { page_address=$(docker logs "$view" 2>&1 | grep -o 'http://127.0.0.1:8051/#.*' | tail -n 1); [[ -n $page_address ]]; }
# The next line of the browser, which must be this one.
expect_of_browser() {
  local line
  read -r line <&"$browser_says" && [[ $line == "$1" ]] || fail "the page of evpose view: the browser ends before \"$1\""
}
answer_browser() { echo >&"${browser[1]}"; }

# The page in the browser of this machine, during a replay in which the server is killed.
watch_page() {
  local address
  compose --profile view up --detach --wait --no-build view 2>/dev/null || fail "the page's container cannot be started"
  await "the address of the page" is_published
  check_confinement "$view" /var/tmp/written
  [[ $(docker port "$view") == "8051/tcp -> 127.0.0.1:8051" ]] || fail "the page is published at $(docker port "$view")"
  address=$(docker inspect --format '{{range .NetworkSettings.Networks}}{{.Gateway}}{{end}}' "$view")
  ! nsenter "--net=/run/netns/$engine_namespace" bash -c "exec 3<>/dev/tcp/$address/8051" 2>/dev/null || fail "the page is published at $address, too"
  coproc browser { exec nsenter "--net=/run/netns/$engine_namespace" /usr/bin/python3 "$here/page_watch.py" "$page_address" "$reference"; }
  # shellcheck disable=SC2154  # coproc sets it
  background=("$browser_PID")
  exec {browser_says}<&"${browser[0]}"
  expect_of_browser open
  start_replay watched 0.3  # images and poses must follow the restart of the server
  answer_browser
  expect_of_browser shown
  kill_and_await "$server"
  answer_browser
  expect_of_browser again
  finish_replay watched
  answer_browser
  expect_of_browser end
  exec {browser_says}<&-
  background=()
  compose rm --stop --force view >/dev/null 2>&1
}

say "compose.yaml"
since=$SECONDS
compose up --detach --wait --no-build --quiet-pull 2>&1 | tail -n 3
echo "up: $((SECONDS - since)) s"
check_images
check_confinement "$server" /tmp/written
check_health
check_bad_starts

say "the demo, through a client's container"
since=$SECONDS
compose run --rm client >"$work/demo.log" 2>&1 || { cat "$work/demo.log" >&2; fail "the demo fails"; }
echo "demo: $((SECONDS - since)) s, $(grep '^events' "$work/demo.log")"
data=$(directory_of_volume evpose_demo)
cmp "$data/cube/recording.raw" "$work/cube/recording.raw" || fail "the recording made in a container differs"
same "$data/poses.tum" "$reference" "demo"
check_prometheus

say "a flood of resets at the published port, beside calls of a client"
resident_kb() { awk '/^VmHWM:/ {print $2}' "/proc/$(pid_of "$server")/status"; }
before=$(resident_kb)
check_flood 127.0.0.1:50051 compose run --rm --no-deps client sessions list --server haproxy:50051
# Without the proxy, 200 000 such streams take 2 GB.
(($(resident_kb) - before < 300000)) || fail "the flood took $(($(resident_kb) - before)) kB of the server"

say "the server is killed during a replay"
before=$(poses)
start_replay killed
await_poses killed "$before"
kill_and_await "$server"
finish_replay killed

if [[ -z $page_missing ]]; then
  say "the page of evpose view in a browser, while the server is killed"
  since=$SECONDS
  watch_page
  echo "page: $((SECONDS - since)) s"
else
  say "the page of evpose view: SKIPPED: $page_missing"
fi

say "a client drains the server during a replay"
before=$(poses)
start_replay drained
await_poses drained "$before"
restarts=$(docker inspect --format '{{.RestartCount}}' "$server")
compose run --rm --no-deps client sessions drain --server haproxy:50051 >/dev/null 2>&1 || fail "the server could not be drained"
await "the server to be started again" has_started_again "$server" "$restarts"
finish_replay drained

say "the server's network is disconnected during a replay"
network_cut

# The server runs as process 1, for which the default action of signals is disabled, with a client that does not disconnect.
say "the server receives two signals"
before=$(received)
compose run --detach --no-deps --name stubborn client replay /data/cube/recording.raw --model /data/cube/model.obj \
  --camera /data/cube/camera.yaml --server haproxy:50051 --rate 0.01 --max-outage 0 --out /data/stubborn.tum >/dev/null
await "the client to stream" is_above "$before" received
docker kill --signal TERM "$server" >/dev/null
await "the server to begin its shutdown" has_said "$server" "signal 15"
docker kill --signal TERM "$server" >/dev/null
[[ $(docker wait "$server") == 143 ]] || fail "a second SIGTERM did not end the server at once"
[[ $(docker wait stubborn) == 1 ]] || fail "the client that stays connected does not report the loss of the server"
docker rm stubborn >/dev/null
compose up --detach --wait --no-build server 2>/dev/null

say "the end"
since=$SECONDS
compose stop server 2>/dev/null
[[ $(docker inspect --format '{{.State.ExitCode}}' "$server") == 0 ]] || fail "the server did not shut down at SIGTERM"
has_said "$server" "all streams are finished" || fail "the server did not finish"
echo "stop: $((SECONDS - since)) s"
compose --profile '*' down --volumes --remove-orphans 2>/dev/null

#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Replaces the servers of compose.cluster.yaml, one after another, by the next version and then by this one again, under six streams. The
# next version is evpose-server-next of the build outside, in the image of this version, which has the same libraries. To be sourced by
# run.sh.
# shellcheck source=cluster_helpers.sh
source "$here/cluster_helpers.sh"
num_searched=0
verdict="6 trajectories with the poses of the reference up to the change of the version"

# replace_server NUMBER next|this: ends a server with SIGTERM, and starts it in that version.
replace_server() {
  local container=${servers[$1 - 1]} files=(--file "$compose_file") number
  docker compose --file "$compose_file" --project-name "$project" stop "server-$1" 2>/dev/null
  [[ $(docker inspect --format '{{.State.ExitCode}}' "$container") == 0 ]] || fail "server-$1 did not leave at SIGTERM"
  docker logs "$container" >>"$work/server-logs" 2>&1
  versions[$1]=$2
  for number in 1 2 3; do [[ ${versions[number]} == this ]] || files+=(--file "$work/next-$number.yaml"); done
  docker compose "${files[@]}" --project-name "$project" up --detach --no-build --no-deps "server-$1" >/dev/null 2>&1
  await_rotation "server-$1"
}

# A client is told when its session is searched for again. Up to that pose its trajectory is that of the reference; afterwards only the
# poses are missing that the search costs.
check_trajectory() {
  local restarts restarted_at lines
  docker logs "$1" >"$work/log" 2>&1
  restarts=$(grep -c '^tracking: restarted after chunk .*, this server reads version ' "$work/log") || true
  ((restarts <= 1)) || fail "$2: the session of $1 was searched for $restarts times"
  num_searched=$((num_searched + restarts))
  grep -q '; nothing was lost$' "$work/log" || ! grep -q '^connection: ' "$work/log" || fail "$2: $1 has lost poses"
  restarted_at=$(sed -n 's/^tracking: restarted after chunk [0-9]* and pose \([0-9]*\),.*/\1/p' "$work/log")
  restarted_at=${restarted_at:-$(wc -l <"$reference")}
  cmp --silent <(head -n "$restarted_at" "$data/$1.copy") <(head -n "$restarted_at" "$reference") ||
    fail "$2: the first $restarted_at poses of $1 differ from those without containers"
  lines=$(wc -l <"$data/$1.copy")
  # The search takes some hundredths of a second of the 40 s.
  ((lines * 100 > $(wc -l <"$reference") * 98)) || fail "$2: $1 has $lines poses only"
}

say "compose.cluster.yaml, two versions"
cmake -DEVPOSE_NEXT_VERSION=ON "$bin" >/dev/null
cmake --build "$bin" --target evpose-server-next >"$work/log" 2>&1 || fail "evpose-server-next does not build: $(tail -n 5 "$work/log")"
install -m 755 "$bin/server/evpose-server-next" "$work/"
for number in 1 2 3; do
  printf 'services:\n  server-%s:\n    volumes: ["%s:/usr/bin/evpose-server:ro"]\n' "$number" "$work/evpose-server-next" >"$work/next-$number.yaml"
done
versions=([1]=this [2]=this [3]=this)
start_cluster
declare -A names=([next]="the next version" [this]="this version")
for target in next this; do
  say "the servers are replaced one after another by ${names[$target]}, under six streams"
  start_clients
  num_searched=0
  for number in 1 2 3; do
    begin_fault "to ${names[$target]}"
    replace_server "$number" "$target"
  done
  finish_clients "to ${names[$target]}"
  ((num_searched > 0)) || fail "no session was searched for again: the servers have the same version"
  echo "$num_searched sessions were searched for again"
done
for container in "${servers[@]}"; do docker logs "$container" >>"$work/server-logs" 2>&1; done
grep -q tracker_state_unreadable "$work/server-logs" || fail "no server has logged that it cannot read the state of a tracker"
! grep -E 'session_not_resumed|SESSION_DAMAGED' "$work/server-logs" || fail "a version cannot read what the other one has stored"
stop_cluster

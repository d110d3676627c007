#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Tests compose.cluster.yaml. To be sourced by run.sh.
# shellcheck source=cluster_helpers.sh
source "$here/cluster_helpers.sh"

say "compose.cluster.yaml"
start_cluster

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
start_clients
for number in 1 2 3; do
  begin_fault "rolling restart"
  compose stop "server-$number" 2>/dev/null
  [[ $(docker inspect --format '{{.State.ExitCode}}' "${servers[number - 1]}") == 0 ]] || fail "server-$number did not leave at SIGTERM"
  compose start "server-$number" 2>/dev/null
  await_rotation "server-$number"
done
finish_clients "rolling restart"

say "the cluster without its Redis reports it"
one_line 1 redis --network "${project}_inside" "evpose-server:$version" --store redis://nowhere:6379
stop_cluster

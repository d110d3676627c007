#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Starts a Redis server or a Sentinel of a group, from node.conf or sentinel.conf beside this script.
#   start.sh node|sentinel NAME FIRST
# NAME is the name under which all others reach this one, FIRST the server that is the master when the group starts for the first time.
# The configuration is /data/node.conf or /data/sentinel.conf, because Sentinels write there who the master is. The password is not on a
# command line.
set -euo pipefail
kind=${1:?usage: $0 node|sentinel NAME FIRST} name=${2:?usage: $0 node|sentinel NAME FIRST} first=${3:?usage: $0 node|sentinel NAME FIRST}
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
file=/data/$kind.conf
port=6379
umask 077
password=$(</run/secrets/redis.password)

write_node() {
  # A server that has run before keeps the master that the Sentinels gave it.
  local master=""
  if [[ -e $file ]]; then
    master=$(grep '^replicaof ' "$file" || true)
  elif [[ $name != "$first" ]]; then
    master="replicaof $first $port"
  fi
  { cat "$here/node.conf"; printf '%s\n' "replica-announce-ip $name" "masterauth $password" "$master"; } >"$file.new"
  mv "$file.new" "$file"
}

write_sentinel() {
  # The first lines of sentinel.conf must precede `sentinel monitor`, which resolves a name.
  {
    cat "$here/sentinel.conf"
    printf '%s\n' "sentinel announce-ip $name" "sentinel sentinel-pass $password" "sentinel monitor evpose $first $port 2" \
      "sentinel auth-pass evpose $password" "sentinel down-after-milliseconds evpose 5000" "sentinel failover-timeout evpose 3000" \
      "sentinel parallel-syncs evpose 1"
  } >"$file.new"
  mv "$file.new" "$file"
}

case $kind in
  node)
    write_node
    exec redis-server "$file"
    ;;
  sentinel)
    # A Sentinel that has run before knows the current master, the replicas and the other Sentinels.
    [[ -e $file ]] || write_sentinel
    exec redis-server "$file" --sentinel
    ;;
  *)
    echo "start.sh: $kind is neither node nor sentinel" >&2
    exit 2
    ;;
esac

#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Makes the secrets of compose.cluster.yaml: the servers' password for Redis, and the access control list of Redis with the
# digest of that password. Keeps existing files.
#   deploy/make-secrets.sh DIRECTORY
set -euo pipefail
directory=${1:?usage: $0 DIRECTORY}
if [[ -e $directory/redis.password && -e $directory/redis.acl ]]; then
  echo "make-secrets: $directory has both files already"
  exit 0
fi
# Access is limited by the mode of the directory. The files are readable by all, because containers run as other users.
mkdir -p "$directory"
chmod 700 "$directory"
password=$(od -An -N32 -tx1 /dev/urandom | tr -d ' \n')
digest=$(printf %s "$password" | sha256sum | cut -d ' ' -f 1)
printf '%s\n' "$password" >"$directory/redis.password"
# The user of the health check needs no password and may only send PING.
printf 'user default on #%s ~* &* +@all\nuser health on nopass -@all +ping\n' "$digest" >"$directory/redis.acl"
chmod 444 "$directory/redis.password" "$directory/redis.acl"
echo "make-secrets: made redis.password and redis.acl in $directory"

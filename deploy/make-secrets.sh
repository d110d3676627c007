#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What the servers of compose.cluster.yaml and their Redis know of each other: a password for the servers, and for Redis who
# may do what, with the password's digest. Leaves alone what is there.
#   deploy/make-secrets.sh DIRECTORY
set -euo pipefail
directory=${1:?usage: $0 DIRECTORY}
if [[ -e $directory/redis.password && -e $directory/redis.acl ]]; then
  echo "make-secrets: $directory has both files already"
  exit 0
fi
# The directory keeps other users out. The files may be read by whoever gets them: containers have users of their own.
mkdir -p "$directory"
chmod 700 "$directory"
password=$(od -An -N32 -tx1 /dev/urandom | tr -d ' \n')
digest=$(printf %s "$password" | sha256sum | cut -d ' ' -f 1)
printf '%s\n' "$password" >"$directory/redis.password"
# The health check needs no password and can do nothing else.
printf 'user default on #%s ~* &* +@all\nuser health on nopass -@all +ping\n' "$digest" >"$directory/redis.acl"
chmod 444 "$directory/redis.password" "$directory/redis.acl"
echo "make-secrets: made redis.password and redis.acl in $directory"

#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Makes the secrets between evpose servers and Redis, for compose.cluster.yaml, compose.sentinel.yaml and kubernetes/secrets/redis: the
# servers' password, the access control list of Redis with the digest of that password, and the certificate and key of Redis, which the
# servers' HAProxy compares. Keeps existing files. Needs openssl.
#   deploy/make-secrets.sh DIRECTORY
set -euo pipefail
directory=${1:?usage: $0 DIRECTORY}
mkdir -p "$directory"
cd "$directory"
# Access is limited by the mode of the directory. The files are readable by all, because containers run as other users.
chmod 700 .
if [[ -e redis.password && -e redis.acl && -e redis.crt && -e redis.key ]]; then
  echo "make-secrets: $directory has all files already"
  exit 0
fi
if [[ ! -e redis.password || ! -e redis.acl ]]; then
  rm -f redis.password redis.acl
  password=$(openssl rand -hex 32)
  digest=$(printf %s "$password" | sha256sum | cut -d ' ' -f 1)
  printf '%s\n' "$password" >redis.password
  # The user of the health check needs no password and may only send PING.
  printf 'user default on #%s ~* &* +@all\nuser health on nopass -@all +ping\n' "$digest" >redis.acl
fi
if [[ ! -e redis.crt || ! -e redis.key ]]; then
  rm -f redis.crt redis.key
  # Valid for ten years; to renew, delete both files, and restart Redis and the servers' HAProxy.
  openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 3650 -subj "/CN=evpose-redis" \
    -addext "subjectAltName=DNS:evpose-redis" -keyout redis.key -out redis.crt 2>openssl.log || { cat openssl.log >&2; exit 1; }
  rm openssl.log
fi
chmod 444 redis.password redis.acl redis.crt redis.key
echo "make-secrets: made redis.password, redis.acl, redis.crt and redis.key in $directory"

#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Tests the manifests of deploy/kubernetes: each overlay renders, references are valid, and the server starts with the options,
# ConfigMap and Secrets of the pod.
#   tests/kubernetes_test.sh EVPOSE_SERVER [KUBECTL]
set -euo pipefail
server=$(realpath "${1:?usage: $0 EVPOSE_SERVER [KUBECTL]}")
kubectl=${2:-kubectl}
cd "$(dirname "${BASH_SOURCE[0]}")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

fail() { echo "kubernetes_test: $*" >&2; exit 1; }

deploy/kubernetes/monitoring/make-prometheusrule.sh "$work/prometheusrule.yaml"
cmp "$work/prometheusrule.yaml" deploy/kubernetes/monitoring/prometheusrule.yaml ||
  fail "run deploy/kubernetes/monitoring/make-prometheusrule.sh: the alerts have changed"

# The files that an operator provides, made as in server/auth/README.md.
cp -r deploy/kubernetes deploy/haproxy deploy/redis "$work"
secrets=$work/kubernetes/secrets
openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 -subj "/CN=evpose-server" \
  -keyout "$secrets/access/tls.key" -out "$secrets/access/tls.crt" 2>"$work/openssl" || { cat "$work/openssl" >&2; fail "openssl"; }
(umask 077; "$server" --new-token lab --token-file "$secrets/access/tokens" >/dev/null 2>&1)
deploy/make-secrets.sh "$secrets/redis" >/dev/null
chmod 755 "$secrets/redis"
deploy/make-secrets.sh "$secrets/redis" >/dev/null
[[ $(stat -c %a "$secrets/redis") == 700 ]] || fail "make-secrets.sh leaves a directory open that has all files"

python3 tests/kubernetes_test.py "$server" "$kubectl" "$work"

#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Writes prometheusrule.yaml: the alerts of deploy/prometheus/alerts.yml as the Prometheus operator takes them.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
{
  cat <<'HEAD'
# SPDX-License-Identifier: Apache-2.0

# Made by make-prometheusrule.sh of deploy/prometheus/alerts.yml: change that, and run it again.
apiVersion: monitoring.coreos.com/v1
kind: PrometheusRule
metadata:
  name: evpose
spec:
HEAD
  sed -e '/^#/d' -e 's/^./  &/' ../../prometheus/alerts.yml
} >"${1:-prometheusrule.yaml}"

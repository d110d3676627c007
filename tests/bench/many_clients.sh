#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Load test of one server with 64 sessions and 1000 watchers, 200 of them stalled: measures losses, cost and latency.
#   tests/bench/many_clients.sh                   the load test
#   tests/bench/many_clients.sh --minutes 60      creates, streams and deletes for this time: leaks of memory and descriptors
# Further options: --help.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

cmake --preset release -DEVPOSE_BUILD_TESTS=ON >/dev/null
cmake --build --preset release --target many_clients >/dev/null
exec build/release/tests/bench/many_clients "$@"

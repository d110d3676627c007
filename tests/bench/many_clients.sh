#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Many clients on one server: 64 sessions, 1000 watchers, 200 of them stalled; what is lost, what it costs, who waits.
#   tests/bench/many_clients.sh                   the load
#   tests/bench/many_clients.sh --minutes 60      create, stream, delete for so long: memory and descriptors
# Further options: --help.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

cmake --preset release -DEVPOSE_BUILD_TESTS=ON >/dev/null
cmake --build --preset release --target many_clients >/dev/null
exec build/release/tests/bench/many_clients "$@"

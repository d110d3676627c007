#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Survival test: kills the server (SIGKILL) at 50 random moments of a replay, or at as many as the first argument says, on every kind of
# store. It kills as often the master of three Redis servers, which Sentinels replace after 5 s without a reply, or after as many
# milliseconds as the second argument says. Every trajectory must be identical to that of an undisturbed run. Further arguments are those of
# the test program, for example --gtest_filter=SentinelSurvivalTest.*. Needs a release build with tests.
set -eu
cd "$(dirname "$0")/../.."
kills=${1:-50}
down_after_ms=${2:-5000}
shift $(($# < 2 ? $# : 2))
EVPOSE_KILLS=$kills EVPOSE_DOWN_AFTER_MS=$down_after_ms build/release/tests/integration/survival_test "$@"

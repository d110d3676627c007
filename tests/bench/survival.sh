#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Survival test: kills the server (SIGKILL) at 50 random moments of a replay, or at as many as the first argument says, on every
# kind of store. Every trajectory must be identical to that of an undisturbed run. Needs a release build with tests.
set -eu
cd "$(dirname "$0")/../.."
EVPOSE_KILLS=${1:-50} build/release/tests/integration/survival_test

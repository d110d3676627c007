#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# The numbers of "what survives": kill -9 of the server at 50 random moments of a replay (or as many as the first
# argument says), on every kind of store; every trajectory must be that of the undisturbed run, byte for byte. Needs a
# release build with tests.
set -eu
cd "$(dirname "$0")/../.."
EVPOSE_KILLS=${1:-50} build/release/tests/integration/survival_test

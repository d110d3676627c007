# SPDX-License-Identifier: Apache-2.0
"""Checks of the scripts in this folder, and the wait for a condition."""
import pathlib
import sys
import time

# A condition that has not become true after this time is a failure. It is less than the timeout of a test in CTest, and no test depends on
# how much earlier the condition becomes true.
PATIENCE_S = 240.0


def check(condition, *words):
    """A failure ends the script with status 1 and a line that begins with its name."""
    if not condition:
        sys.exit(f"{pathlib.Path(sys.argv[0]).stem}: " + " ".join(str(word) for word in words))


def poll(condition, what):
    """Returns the first value of condition() that is true. Raises AssertionError if there is none within PATIENCE_S."""
    end_s = time.monotonic() + PATIENCE_S
    while not (value := condition()):
        if time.monotonic() > end_s:
            raise AssertionError(f"not reached in {PATIENCE_S:.0f} s: {what}")
        time.sleep(0.01)  # leaves the processors to the processes that it waits for
    return value

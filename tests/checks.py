# SPDX-License-Identifier: Apache-2.0
"""Checks of the scripts in this folder: a failure ends the script with status 1 and a line that begins with its name."""
import pathlib
import sys
import time

PATIENCE_S = 240.0  # less than the timeout of a test in CTest


def check(condition, *words):
    if not condition:
        sys.exit(f"{pathlib.Path(sys.argv[0]).stem}: " + " ".join(str(word) for word in words))


def poll(condition, what):
    """Returns the first value of condition() that is true. It is a failure if there is none within PATIENCE_S."""
    end_s = time.monotonic() + PATIENCE_S
    while not (value := condition()):
        check(time.monotonic() < end_s, f"not reached in {PATIENCE_S:.0f} s:", what)
        time.sleep(0.05)  # leaves the processors to the processes that it waits for
    return value

#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Runs all tests of this folder one after another and prints the figures that they measure, and in how many ways a client's input
has ended a server process or stopped it from accepting connections.

  tests/adversary/figures.py --bin build/release
"""

import pathlib
import sys
import unittest

import server


def main():
    folder = pathlib.Path(__file__).parent
    loader = unittest.TestLoader()
    suite = loader.discover(str(folder), pattern="test_*.py")
    suite.addTest(loader.loadTestsFromName("mix"))
    result = unittest.TextTestRunner(verbosity=1).run(suite)
    for name, text in server.figures.items():
        print(f"{name}: {text}")
    print(f"ways in which a client's input ends the server or stops it from accepting connections: {len(server.Server.defeats)}")
    for defeat in server.Server.defeats:
        print("  " + defeat)
    return 0 if result.wasSuccessful() else 1


if __name__ == "__main__":
    sys.exit(main())

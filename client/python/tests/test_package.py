#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Installs the package with pip from a copy of the checkout, without a network, and checks its types."""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

from testing import ROOT, server

PACKAGE = ROOT / "client/python"


class PackageTest(unittest.TestCase):
    def setUp(self):
        self.directory = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))

    def run_python(self, *arguments, **environment):
        done = subprocess.run([sys.executable, *map(str, arguments)], cwd=self.directory, capture_output=True, text=True, check=False,
                              env={**os.environ, **environment})
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        return done.stdout

    def test_pip_installs_from_the_checkout(self):
        ignore = shutil.ignore_patterns("__pycache__", "build", "*.egg-info")
        shutil.copytree(PACKAGE, self.directory / "tree/client/python", ignore=ignore)
        shutil.copytree(ROOT / "proto", self.directory / "tree/proto")
        site = self.directory / "site"
        self.run_python("-m", "pip", "install", "--no-index", "--no-build-isolation", "--no-deps", "--target", site,
                        self.directory / "tree/client/python", PIP_ROOT_USER_ACTION="ignore")
        output = self.run_python("-c", "import evpose, importlib.metadata; print(evpose.__file__, importlib.metadata.version('evpose'))",
                               PYTHONPATH=str(site))
        self.assertIn(str(site), output)
        version = re.search(r"project\(evpose VERSION (\S+)", (ROOT / "CMakeLists.txt").read_text()).group(1)
        self.assertEqual(output.split()[-1], version)
        # The same files as in the build, and thus in the Debian package.
        built = server.BIN / "client/python/evpose"
        files = {path.relative_to(built) for path in built.rglob("*") if path.is_file() and "__pycache__" not in path.parts}
        installed = {path.relative_to(site / "evpose") for path in (site / "evpose").rglob("*") if "__pycache__" not in path.parts and path.is_file()}
        self.assertEqual(installed, files)
        for path in files:
            self.assertEqual((site / "evpose" / path).read_bytes(), (built / path).read_bytes(), path)

    def test_types(self):
        shutil.copytree(server.BIN / "client/python/evpose", self.directory / "evpose", ignore=shutil.ignore_patterns("__pycache__"))
        self.run_python("-m", "mypy", "--config-file", PACKAGE / "pyproject.toml", "--cache-dir", self.directory / "cache", "evpose")


if __name__ == "__main__":
    unittest.main()

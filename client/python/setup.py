# SPDX-License-Identifier: Apache-2.0
"""Generates the messages of the API into the package while it is built; pyproject.toml has everything else."""
import pathlib
import sys

from setuptools import setup
from setuptools.command.build_py import build_py

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import generate_stubs


class BuildWithStubs(build_py):
    def run(self):
        super().run()
        generate_stubs.generate(pathlib.Path(self.build_lib) / "evpose")


setup(cmdclass={"build_py": BuildWithStubs})

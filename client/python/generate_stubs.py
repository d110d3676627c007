#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Generates the messages of the API from proto/ into a folder of the package: OUT/v1 and OUT/rpc.

usage: generate_stubs.py OUT          such as build/evpose

It runs protoc, or without one the compiler of PyPI's grpcio-tools. Nothing else of gRPC's code generator is used.
"""
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
# Messages of other projects, and the name of their module in evpose.rpc. They get a package of their own, because another package
# of the same process may register the same names, and protobuf accepts a name only once.
FOREIGN = {"google/rpc/status.proto": "status", "google/rpc/error_details.proto": "error_details", "grpc/health/v1/health.proto": "health"}


def protoc():
    if shutil.which("protoc"):
        return ["protoc"]
    try:
        import grpc_tools
    except ImportError:
        sys.exit("generate_stubs: install protoc (Debian: protobuf-compiler), or grpcio-tools from PyPI")
    return [sys.executable, "-m", "grpc_tools.protoc", f"-I{pathlib.Path(grpc_tools.__file__).parent / '_proto'}"]


def generate(out, proto=ROOT / "proto"):
    """Writes OUT/v1/*_pb2.py and OUT/rpc/*_pb2.py with their type stubs."""
    names = sorted(path.relative_to(proto).as_posix() for path in (proto / "evpose/v1").glob("*.proto"))
    if not names:
        sys.exit(f"generate_stubs: {proto} has no evpose/v1/*.proto: install the package from a checkout of evpose")
    with tempfile.TemporaryDirectory() as work:
        work = pathlib.Path(work)
        for path, module in FOREIGN.items():
            text = (proto / path).read_text()
            text = re.sub(r"^package [\w.]+;", "package evpose.rpc;", text, flags=re.M)
            (work / "evpose/rpc").mkdir(parents=True, exist_ok=True)
            (work / f"evpose/rpc/{module}.proto").write_text(text)
            names.append(f"evpose/rpc/{module}.proto")
        made = work / "made"
        made.mkdir()
        subprocess.run([*protoc(), f"-I{proto}", f"-I{work}", f"--python_out={made}", f"--pyi_out={made}", *names], check=True)
        for folder in ("v1", "rpc"):
            target = pathlib.Path(out) / folder
            target.mkdir(parents=True, exist_ok=True)
            (target / "__init__.py").write_text("")
            for file in sorted((made / "evpose" / folder).iterdir()):
                shutil.copyfile(file, target / file.name)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    generate(sys.argv[1])

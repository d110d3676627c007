#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The compose files against each other, without a container engine, which tests/container/run.sh brings."""

import pathlib
import re
import sys

import yaml

ROOT = pathlib.Path(__file__).resolve().parent.parent


def check(condition, *words):
    if not condition:
        sys.exit("compose_test: " + " ".join(str(word) for word in words))


class Loader(yaml.SafeLoader):
    """Knows what Compose adds to YAML."""


Loader.add_constructor("!override", lambda loader, node: loader.construct_sequence(node))


def services(name):
    return yaml.load((ROOT / "deploy" / name).read_text(), Loader)["services"]


def options(command):
    """By name; what has no value, None."""
    found = {}
    for word, following in zip(command, command[1:] + ["--"]):
        if word.startswith("--"):
            found[word] = None if following.startswith("--") else following
    return found


def check_tls(below, on_top):
    """A command on top replaces the whole of that below: what it does not repeat is lost."""
    for name, service in services(on_top).items():
        if not name.startswith("server"):
            continue
        encrypted = options(service["command"])
        for option, value in options(services(below)[name]["command"]).items():
            if option == "--insecure" and "--tls-cert" in encrypted:
                continue
            check(encrypted.get(option, "") == value, name, "of", on_top, "has not", option, value or "", "of", below)


def check_versions():
    """What the images are called, and say they are, when nobody names a version: that of the project."""
    version = re.search(r"^project\(evpose VERSION ([\d.]+)", (ROOT / "CMakeLists.txt").read_text(), re.M)[1]
    for name in ("Dockerfile", "compose.yaml", "compose.cluster.yaml"):
        said = re.findall(r"VERSION(?:=|:-)([^}\s]*)", (ROOT / "deploy" / name).read_text())
        check(said and set(said) == {version}, name, "says", said, "and not", version)


def main():
    check_versions()
    check_tls("compose.yaml", "compose.tls.yaml")
    check_tls("compose.cluster.yaml", "compose.cluster.tls.yaml")


main()

#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks that includes follow the layers. The order of add_subdirectory in each CMakeLists.txt declares them: a file may include from
its own folder and from folders that are added before it. Tests and their helpers are exempt: a test may need a simulation that is
added later. Neither headers nor folders may include each other in a cycle. Prints each finding as `file:line: text`; status 1 if there is one."""

import functools
import os
import re
import subprocess
import sys

INCLUDE = re.compile(r'^#include "([^"]+)"', re.M)
SUBDIRECTORY = re.compile(r"^\s*add_subdirectory\((\S+)\)", re.M)
PUBLIC_HEADERS = "client/lib/include"  # of "evpose/client.h"
IS_TEST = re.compile(r"_(test|testing|fuzz|benchmark)\.(h|cc)$")


@functools.lru_cache(maxsize=None)
def subdirectories(folder):
    path = os.path.join(folder, "CMakeLists.txt")
    if not os.path.exists(path):
        return ()
    with open(path, encoding="utf-8") as file:
        return tuple(SUBDIRECTORY.findall(file.read()))


def rank(file):
    """The positions of the file's folders in their lists, from the root on; a file beside subdirectories comes after them."""
    positions = []
    folder = ""
    parts = os.path.dirname(file).split("/")
    while parts:
        names = subdirectories(folder)
        # The longest name first: a list may have both sessions/types and sessions.
        length = next((n for n in range(len(parts), 0, -1) if "/".join(parts[:n]) in names), 0)
        if length == 0:
            break
        positions.append(names.index("/".join(parts[:length])))
        folder = os.path.join(folder, *parts[:length])
        parts = parts[length:]
    return positions + [len(subdirectories(folder))]


def includes(file):
    with open(file, encoding="utf-8") as stream:
        text = stream.read()
    for match in INCLUDE.finditer(text):
        target = match.group(1)
        if not os.path.exists(target):
            target = os.path.join(os.path.dirname(file), target)
        if target.startswith("evpose/"):
            target = os.path.join(PUBLIC_HEADERS, match.group(1))
        if os.path.exists(target):  # generated headers are not in the tree
            yield text.count("\n", 0, match.start()) + 1, os.path.normpath(target)


def cycles(graph):
    """Each cycle of nodes that a depth-first search meets, as the list of its nodes."""
    done, path, found = set(), [], []

    def visit(node):
        if node in path:
            found.append(path[path.index(node):] + [node])
            return
        if node in done:
            return
        path.append(node)
        for target in graph.get(node, ()):
            visit(target)
        path.pop()
        done.add(node)

    for node in sorted(graph):
        visit(node)
    return found


def main():
    listed = subprocess.run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", "*.h", "*.cc"], check=True, capture_output=True,
                            text=True).stdout
    files = [file for file in listed.split("\0") if file and os.path.exists(file)]
    findings = []
    graph = {}
    folders = {}  # those that the files of each folder include, without tests
    for file in files:
        for line, target in includes(file):
            if file.endswith(".h"):
                graph.setdefault(file, []).append(target)
            if IS_TEST.search(file):
                continue
            own, other = rank(file), rank(target)
            folder, other_folder = os.path.dirname(file), os.path.dirname(target)
            if folder == other_folder:
                continue
            folders.setdefault(folder, set()).add(other_folder)
            if other > own:
                findings.append(f"{file}:{line}: includes {target}, whose folder is added after this one")
    for cycle in cycles(graph):
        findings.append(f"{cycle[0]}:1: headers include each other: {' -> '.join(cycle)}")
    for cycle in cycles({folder: sorted(others) for folder, others in folders.items()}):
        findings.append(f"{cycle[0]}:1: folders include each other: {' -> '.join(cycle)}")
    for finding in findings:
        print(finding)
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Prints for each folder of C++ the number of its files, and the lines of its production code and of its tests without comments and blank
lines; with two revisions, both side by side. A test is a file whose name ends in _test or _testing, or a file below tests/.
  tests/lint/count_lines.py [REV [REV]]    the working tree, or one or two revisions"""

import collections
import os
import re
import subprocess
import sys

COMMENTS = re.compile(r'"(?:\\.|[^"\\\n])*"|//[^\n]*|/\*.*?\*/', re.S)
IS_TEST = re.compile(r"(^tests/)|_(test|testing)\.(h|cc)$")


def git(*arguments):
    return subprocess.run(["git", *arguments], check=True, capture_output=True).stdout.decode(errors="replace")


def files(revision):
    """The paths and texts of all C++ files."""
    if revision is None:
        for path in git("ls-files", "*.cc", "*.h").split():
            with open(path, encoding="utf-8") as file:
                yield path, file.read()
        return
    paths = [path for path in git("ls-tree", "-r", "--name-only", revision).split("\n") if path.endswith((".cc", ".h"))]
    requests = "".join(f"{revision}:{path}\n" for path in paths)
    output = subprocess.run(["git", "cat-file", "--batch"], input=requests.encode(), check=True, capture_output=True).stdout
    for path in paths:
        header, output = output.split(b"\n", 1)
        size = int(header.split()[-1])
        yield path, output[:size].decode(errors="replace")
        output = output[size + 1:]


def count(text):
    code = COMMENTS.sub(lambda match: match.group(0) if match.group(0).startswith('"') else "", text)
    return sum(1 for line in code.split("\n") if line.strip())


def totals(revision):
    """{folder: [files, lines of production code, lines of tests]}"""
    folders = collections.defaultdict(lambda: [0, 0, 0])
    for path, text in files(revision):
        for folder in (os.path.dirname(path), "total"):
            folders[folder][0] += 1
            folders[folder][2 if IS_TEST.search(path) else 1] += count(text)
    return folders


def main():
    revisions = sys.argv[1:] or [None]
    if len(revisions) > 2 or str(revisions[0]).startswith("-"):
        sys.exit(__doc__)
    columns = [totals(revision) for revision in revisions]
    names = [revision or "working tree" for revision in revisions]
    print("| folder | " + " | ".join(f"{name}: files | production | tests" for name in names) + " |")
    print("| --- |" + " ---: | ---: | ---: |" * len(columns))
    folders = sorted(set().union(*columns) - {"total"}) + ["total"]
    for folder in folders:
        print(f"| {folder} | " + " | ".join(" | ".join(map(str, column.get(folder, (0, 0, 0)))) for column in columns) + " |")


if __name__ == "__main__":
    main()

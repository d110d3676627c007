#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks the files of the tree, also new ones that are not ignored: licence lines, sizes of folders, of files and of the README, columns
of documents, the READMEs of the libraries and the headers that those of core/ mention, whether every document, section, heading, equation
and path that is cited exists, whether the history has each commit that a document names, whether the numbers of equations are unique, and
whether each event of the server's log is described. Prints each finding as `file:line: text` and exits with status 1 if there is one."""

import collections
import os
import re
import subprocess
import sys

MAX_FOLDER_FILES = 45
MAX_README_LINES = 150
MAX_FILE_LINES = 500
MAX_COLUMNS = 140  # of prose in documents; tables and links of pictures cannot be broken
SOURCE = re.compile(r"\.(h|cc|proto|sh|py|ts|mjs|css|html|cmake)$")
SHARED_DATA = "../" + "shared"
SHARED_DATA_FILE = "CMakeLists.txt"
LICENCE = "SPDX-License-Identifier: Apache-2.0"
NEEDS_LICENCE = re.compile(r"(\.(h|cc|proto|sh|py|js|ts|mjs|css|html|cmake|yaml|yml|cfg|conf|toml|service|in)|CMakeLists\.txt|Dockerfile|suppressions\.txt|/uncounted\.txt|^\.ci/run)$")
FOREIGN_DATA = re.compile(r"^tests/data/.*\.ya?ml$")  # written by other software, as their SOURCE.txt says
DOCUMENT = re.compile(r"(?<![\w/.-])((?:\.\./|[\w-]+/)*[\w-]+\.md)(?:,?\s+sections?\s+(\d+)(?:\s+and\s+(\d+))?|,?\s+equations?\s+\((\d+[a-z]?)\)(?:\s+(?:and|to)\s+\((\d+[a-z]?)\))?)?")
# "README, section 2", "README, equations (1) and (2)", "equation (3) of the README": the README of the folder or of one above.
NUMBERS = r"(sections?|equations?)\s+\(?(\d+[a-z]?)\)?(?:\s+(?:and|to)\s+\(?(\d+[a-z]?)\)?)?"
README_BEFORE = re.compile(rf"(?<![\w/.-])README,?\s+{NUMBERS}")
README_AFTER = re.compile(rf"\b{NUMBERS}\s+of\s+the\s+README(?![\w.-])", re.I)
PATH = re.compile(r"(?<![\w/.$}{-])((?:core|server|client|proto|deploy|tests)/[\w/.-]*\w\.(?:h|cc|sh|py|proto|yaml|cfg|yml|txt))(?![\w/*])")
# Folders with code that computes poses, and functions of the C library for which IEEE 754 does not prescribe correct rounding.
DETERMINISTIC = re.compile(r"core/(association|contours|detection|estimation|geometry|initialization|mesh|models|numerics|tracking|windows)/")
PLATFORM_FUNCTION = re.compile(r"std::(hypot|exp2?|expm1|log(2|10|1p)?|pow|cbrt|a?(sin|cos|tan)h?|atan2|erfc?|[lt]gamma)\(")
LINK = re.compile(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]+))?\)")
HEADING = re.compile(r"^#{1,6} +(.*?) *#*$", re.M)
# An event of the log: the name in a call, or a constant for it.
LOG_EVENT = re.compile(r"\b(?:Log|Write|WriteEnd)\(LogLevel::k\w+,\s*\"(\w+)\"|\bkEvent\[\] = \"(\w+)\"")
LOG_EVENTS = "deploy/README.md"
# A commit of this repository in a document. After other words than these, hexadecimal digits are digests or commits of other projects.
COMMIT = re.compile(r"\b(?:evpose(?:\s+\d+\.\d+\.\d+)?\s+(?:before\s+)?\(?|(?:commits?|Commits?)\s+|(?:at|At|before|Before|since|Since)\s+(?=\d*[a-f]))([0-9a-f]{7,8})\b")
CODE_BLOCK = re.compile(r"^```.*?^```", re.M | re.S)


def tracked_files():
    out = subprocess.run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], check=True, capture_output=True, text=True).stdout
    return [f for f in out.split("\0") if f and not f.startswith(("tests/fuzz/seeds/", "tests/fuzz/findings/"))]


def resolve(path, from_file):
    for base in ("", os.path.dirname(from_file)):
        candidate = os.path.normpath(os.path.join(base, path))
        if os.path.exists(candidate):
            return candidate
    return None


def nearest_readme(file):
    folder = os.path.dirname(file)
    while folder and not os.path.exists(os.path.join(folder, "README.md")):
        folder = os.path.dirname(folder)
    return os.path.join(folder, "README.md")


def comment_text(text):
    """Joins comment lines, so that a citation that is broken across two lines is found; keeps positions by line."""
    return re.sub(r"\n[ \t]*(//|#)[ \t]?", lambda m: " " * len(m.group(0)), text)


def anchors(document):
    """The anchors of a document's headings, as GitHub makes them: lower case, no punctuation, hyphens for spaces, and a number
    for each repetition."""
    names = set()
    repetitions = collections.Counter()
    for heading in HEADING.findall(CODE_BLOCK.sub("", document)):
        text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        name = re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-")
        names.add(f"{name}-{repetitions[name]}" if repetitions[name] else name)
        repetitions[name] += 1
    return names


def check_links(file, text, findings):
    for match in LINK.finditer(text):
        path, anchor = match.groups()
        line = text.count("\n", 0, match.start()) + 1
        target = resolve(path, file) if path else file
        if target is None:
            findings.append(f"{file}:{line}: the link to {path} leads nowhere")
        elif anchor and target.endswith(".md"):
            with open(target, encoding="utf-8") as f:
                if anchor not in anchors(f.read()):
                    findings.append(f"{file}:{line}: {target} has no heading #{anchor}")


def check_citations(file, text, findings):
    flat = comment_text(text)
    for match in DOCUMENT.finditer(flat):
        line = text.count("\n", 0, match.start()) + 1
        target = resolve(match.group(1), file)
        if target is None:
            findings.append(f"{file}:{line}: {match.group(1)} does not exist")
            continue
        with open(target, encoding="utf-8") as f:
            document = f.read()
        for section in filter(None, match.group(2, 3)):
            if not re.search(rf"^## {section}\.", document, re.M):
                findings.append(f"{file}:{line}: {target} has no section {section}")
        for equation in filter(None, match.group(4, 5)):
            if re.search(rf"\({equation}\)\s*$", document, re.M):
                continue
            findings.append(f"{file}:{line}: {target} has no equation ({equation})")
    check_readme_citations(file, text, flat, findings)
    if file.endswith(".md"):
        check_links(file, text, findings)
        check_equations(file, text, findings)


def check_readme_citations(file, text, flat, findings):
    matches = [*README_BEFORE.finditer(flat), *README_AFTER.finditer(flat)]
    if not matches:
        return
    readme = nearest_readme(file)
    with open(readme, encoding="utf-8") as f:
        document = f.read()
    for match in matches:
        line = text.count("\n", 0, match.start()) + 1
        kind, *numbers = match.groups()
        for number in filter(None, numbers):
            if kind.lower().startswith("section"):
                if not re.search(rf"^## {number}\.", document, re.M):
                    findings.append(f"{file}:{line}: {readme} has no section {number}")
            elif not re.search(rf"\({number}\)\s*$", document, re.M):
                findings.append(f"{file}:{line}: {readme} has no equation ({number})")


def check_equations(file, text, findings):
    """Each number of an equation, at the end of a line of a code block, is used once in a document."""
    numbers = collections.Counter(n for block in CODE_BLOCK.findall(text) for n in re.findall(r" {3,}\((\d+)\)$", block, re.M))
    for number, count in numbers.items():
        if count > 1:
            findings.append(f"{file}: {count} equations have the number ({number})")


def check_paths(file, text, findings):
    for match in PATH.finditer(text):
        if not os.path.exists(match.group(1)) and resolve(match.group(1), file) is None:
            line = text.count("\n", 0, match.start()) + 1
            findings.append(f"{file}:{line}: {match.group(1)} does not exist")


def ancestors():
    """The hashes of HEAD and of the commits before it; None in a clone that lacks some of them."""
    def git(*arguments):
        return subprocess.run(["git", *arguments], check=True, capture_output=True, text=True).stdout
    return None if git("rev-parse", "--is-shallow-repository").strip() == "true" else git("rev-list", "HEAD").split()


def check_commits(file, text, hashes, findings):
    """Each commit that a document names is HEAD or one before it: a reader can check it out. A rebase replaces commits."""
    for match in COMMIT.finditer(text):
        if not any(name.startswith(match.group(1)) for name in hashes):
            line = text.count("\n", 0, match.start(1)) + 1
            findings.append(f"{file}:{line}: the history has no commit {match.group(1)}: measure again, or name the commit that recorded this")


def check_determinism(file, text, findings):
    """Between the decoder and a pose, functions of the C library that differ between processors (core/numerics/README.md)."""
    # Random numbers are drawn by the simulator and by tests only.
    if not DETERMINISTIC.match(file) or re.search(r"_test(ing)?\.|^core/numerics/random\.cc$", file):
        return
    for match in PLATFORM_FUNCTION.finditer(text):
        line = text.count("\n", 0, match.start()) + 1
        findings.append(f"{file}:{line}: {match.group(0)[:-1]} gives other bits on other processors; use core/numerics/math.h")


def check_size(file, text, findings):
    lines = text.count("\n")
    if SOURCE.search(file) and lines > MAX_FILE_LINES:
        findings.append(f"{file}: {lines} lines; at most {MAX_FILE_LINES} are allowed: split the file")


def check_columns(file, text, findings):
    prose = CODE_BLOCK.sub(lambda block: "\n" * block.group(0).count("\n"), text)
    for number, line in enumerate(prose.split("\n"), 1):
        if len(line) > MAX_COLUMNS and not line.lstrip().startswith(("|", "![")):
            findings.append(f"{file}:{number}: {len(line)} columns; at most {MAX_COLUMNS} are allowed")


def check_library_readmes(files, findings):
    """Each folder of a library below core, server and client has a README, which the README above lists."""
    for top in ("core", "server", "client"):
        with open(f"{top}/README.md", encoding="utf-8") as f:
            listed = f.read()
        for folder in sorted({f.split("/")[1] for f in files if f.startswith(f"{top}/") and f.count("/") > 1}):
            if f"{top}/{folder}/README.md" not in files:
                findings.append(f"{top}/{folder}: README.md is missing")
            elif f"({folder}/README.md)" not in listed:
                findings.append(f"{top}/README.md:1: {folder}/README.md is not listed")


def check_log_events(files, findings):
    """Each event of the server's log is described for operators."""
    with open(LOG_EVENTS, encoding="utf-8") as f:
        described = set(re.findall(r"`([a-z_]+)`", f.read()))
    for file in files:
        if not re.match(r"server/.*\.cc$", file) or "_test" in file or not os.path.isfile(file):
            continue
        with open(file, encoding="utf-8") as f:
            text = f.read()
        for match in LOG_EVENT.finditer(text):
            event = match.group(1) or match.group(2)
            if event not in described:
                line = text.count("\n", 0, match.start()) + 1
                findings.append(f"{file}:{line}: {LOG_EVENTS} does not describe the event {event} of the log")


def check_headers_listed(files, findings):
    """The README of a folder of core/, or of the nearest folder above that has one, mentions each header of the folder."""
    for file in files:
        stem, extension = os.path.splitext(os.path.basename(file))
        if not file.startswith("core/") or extension != ".h" or stem.endswith("_testing"):
            continue
        readme = nearest_readme(file)
        with open(readme, encoding="utf-8") as f:
            if not re.search(rf"\b{re.escape(stem)}\b", f.read()):
                findings.append(f"{file}: {readme} does not mention `{stem}`")


def main():
    files = tracked_files()
    findings = []
    hashes = ancestors()
    folders = collections.Counter(os.path.dirname(f) for f in files)
    for folder, count in sorted(folders.items()):
        if count > MAX_FOLDER_FILES:
            findings.append(f"{folder}: {count} files; at most {MAX_FOLDER_FILES} are allowed: split the folder")
    check_library_readmes(files, findings)
    check_log_events(files, findings)
    check_headers_listed([f for f in files if os.path.isfile(f)], findings)
    for file in files:
        if not os.path.isfile(file):
            continue
        try:
            with open(file, encoding="utf-8") as f:
                text = f.read()
        except UnicodeDecodeError:
            continue
        if NEEDS_LICENCE.search(file) and not FOREIGN_DATA.search(file) and LICENCE not in text[:400]:
            findings.append(f"{file}:1: the licence line is missing: {LICENCE}")
        if not file.startswith("tests/lint/"):
            check_citations(file, text, findings)
            check_paths(file, text, findings)
        check_size(file, text, findings)
        if file.endswith(".md"):
            check_columns(file, text, findings)
            if hashes is not None:
                check_commits(file, text, hashes, findings)
        check_determinism(file, text, findings)
        if SHARED_DATA in text and file != SHARED_DATA_FILE:
            findings.append(f"{file}:1: only {SHARED_DATA_FILE} names {SHARED_DATA}: use tests/data/test_data.h")
    with open("README.md", encoding="utf-8") as f:
        lines = sum(1 for _ in f)
    if lines > MAX_README_LINES:
        findings.append(f"README.md: {lines} lines; at most {MAX_README_LINES} are allowed: move details to a folder's README")
    for finding in findings:
        print(finding)
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())

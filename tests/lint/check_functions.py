#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks the length of functions in C++, TypeScript, Python and shell scripts. Prints each finding as `file:line: text` and exits with
status 1 if there is one."""

import ast
import os
import re
import subprocess
import sys

MAX_LINES = 60
# Exceptions, with their own maximum: tests that consist of a table of cases.
LARGE_FUNCTIONS = {("server/rpc/server_test.cc", "NamesTheFieldOfABadConfiguration"): 80,
                   ("server/program/program_test.cc", "ReportsWrongUsage"): 62}
# Comments and literals, in which braces have no meaning. Those of TypeScript may have several lines.
IGNORED = re.compile(r"""//[^\n]*|/\*.*?\*/|R"(\w*)\(.*?\)\1"|"(?:\\.|[^"\\\n])*"|(?<!\w)'(?:\\.|[^'\\\n])*'|`(?:\\.|[^`\\])*`""", re.S)
DIRECTIVE = re.compile(r"^[ \t]*#.*$", re.M)
CONTROL = re.compile(r"\W*(?:if|for|while|switch|do|else|try|catch|namespace|class|struct|enum|union|return|case|default)\b")
NAME = re.compile(r"([\w~]+) *(?:<[^()]*>)? *\(")
TEST = re.compile(r"\bTEST(?:_F|_P)?\((\w+), *(\w+)\)")
SHELL_FUNCTION = re.compile(r"^(\w+)\(\) *[({]\n.*?^[)}]", re.M | re.S)


def blank(match):
    return re.sub(r"[^\n]", " ", match.group(0))


def functions_with_braces(text):
    """Yields name, first line and number of lines of the functions of C++ and TypeScript: blocks behind parameters."""
    code = DIRECTIVE.sub(blank, IGNORED.sub(blank, text))
    blocks = []
    begin = 0  # of the statement to which a brace belongs
    for match in re.finditer(r"[{};]", code):
        if match.group() == "{":
            blocks.append((begin, code[begin:match.start()]))
        elif match.group() == "}" and blocks:
            start, head = blocks.pop()
            name = NAME.search(head)
            if name and not CONTROL.match(head) and "=" not in head.split("(")[0]:
                test = TEST.search(head)
                start += len(head) - len(head.lstrip())
                lines = code.count("\n", start, match.start()) + 1
                yield test.group(2) if test else name.group(1), code.count("\n", 0, start) + 1, lines
        begin = match.end()


def functions_of_python(text):
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            yield node.name, node.lineno, node.end_lineno - node.lineno + 1


def functions_of_shell(text):
    for match in SHELL_FUNCTION.finditer(text):
        yield match.group(1), text.count("\n", 0, match.start()) + 1, match.group().count("\n") + 1


READERS = {".cc": functions_with_braces, ".h": functions_with_braces, ".ts": functions_with_braces, ".mjs": functions_with_braces,
           ".py": functions_of_python, ".sh": functions_of_shell}


def main():
    files = subprocess.run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], check=True, capture_output=True,
                           text=True).stdout.split("\0")
    num_findings = 0
    for file in files:
        read = READERS.get(os.path.splitext(file)[1])
        if read is None or not os.path.isfile(file):
            continue
        with open(file, encoding="utf-8") as f:
            text = f.read()
        for name, line, lines in read(text):
            limit = LARGE_FUNCTIONS.get((file, name), MAX_LINES)
            if lines > limit:
                print(f"{file}:{line}: {name} has {lines} lines; at most {limit} are allowed: divide the function")
                num_findings += 1
    return 1 if num_findings else 0


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks the style of the API's proto files: rules of `buf lint` (DEFAULT and COMMENTS) that apply here.

  proto_lint.py [DIRECTORY]     by default proto/evpose of this repository

Rules: the package is the folder; names are lower_snake_case, PascalCase or UPPER_SNAKE_CASE by kind, and those of booleans have no prefix "is_"; the first value
of an enum is ENUM_NAME_UNSPECIFIED = 0, and the others have the enum's prefix, except for ErrorReason, whose names
are sent as text (AIP-193); the request of a method is MethodRequest and is used once; its response is MethodResponse,
google.protobuf.Empty for Delete, or a resource for Get and Upload; every service, method, message, enum, field and
value has a comment, which for a field in a request or in a Mesh says "Required" or "Optional". Of the records of the
store (evpose/storage) only the names are checked. Exit status 1 when a rule is broken.
"""
import pathlib
import re
import sys

UNPREFIXED_ENUMS = {"ErrorReason"}
RESOURCES = {"GetServerInfo": "ServerInfo"}
UPLOADED = {"Mesh"}  # messages that clients send as the bytes of a file
VALUES = {"Vector3", "Quaternion"}  # all components are required

DECLARATION = re.compile(r"^(message|enum|service|oneof)\s+(\w+)\s*\{(\})?")
FIELD = re.compile(r"^(?:repeated\s+|optional\s+)?(map<[^>]+>|[\w.]+)\s+(\w+)\s*=\s*(\d+)")
VALUE = re.compile(r"^(\w+)\s*=\s*(\d+)")
RPC = re.compile(r"^rpc\s+(\w+)\(\s*(?:stream\s+)?([\w.]+)\)\s+returns\s+\(\s*(?:stream\s+)?([\w.]+)\)")


def snake(name):
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name).upper()


def expected_response(method):
    if method.startswith("Delete"):
        return {"google.protobuf.Empty"}
    if method.startswith(("Get", "Upload")):
        return {RESOURCES.get(method, re.sub("^(Get|Upload)", "", method))}
    return {method + "Response"}


class File:
    def __init__(self, path, root):
        self.path = path
        self.root = root
        self.has_comments = "storage" not in path.parts
        self.findings = []
        self.requests = []
        self.scopes = []  # (kind, name, number of members)
        self.fields = []  # (message, name, type, comment, line)

    def report(self, number, text):
        self.findings.append(f"{self.path}:{number}: {text}")

    def check(self):
        lines = self.path.read_text().splitlines()
        self.check_package(lines)
        above = ""
        for number, line in enumerate(lines, 1):
            if len(line) > 120:
                self.report(number, "the line is longer than 120 characters")
            code, mark, comment = line.partition("//")
            code = code.strip()
            if code == "":
                above = above + comment if mark else ""
                continue
            self.check_line(number, code, above + comment)
            above = ""
        return self

    def check_package(self, lines):
        package = next((line.split()[1].rstrip(";") for line in lines if line.startswith("package ")), "")
        folder = ".".join(self.path.parent.relative_to(self.root).parts)
        if package != folder:
            self.report(1, f"package {package} is in the folder of {folder}")
        if not re.fullmatch(r"[a-z][a-z0-9_]*\.proto", self.path.name):
            self.report(1, "the file's name is not lower_snake_case")

    def check_line(self, number, code, comment):
        if declared := DECLARATION.match(code):
            self.check_declaration(number, *declared.group(1, 2), comment)
            if not declared.group(3):
                self.scopes.append([declared.group(1), declared.group(2), 0])
        elif code.startswith("}"):
            if self.scopes:
                self.scopes.pop()
        elif self.scopes:
            self.check_member(number, code, comment)

    def check_declaration(self, number, kind, name, comment):
        if self.has_comments and not comment:
            self.report(number, f"{kind} {name} has no comment")
        if kind == "oneof":
            self.fields.append((self.scopes[-1][1], name, "", comment, number))
        pattern = r"[a-z][a-z0-9_]*" if kind == "oneof" else r"[A-Z][A-Za-z0-9]*"
        if not re.fullmatch(pattern, name):
            self.report(number, f"{kind} {name} is not {'lower_snake_case' if kind == 'oneof' else 'PascalCase'}")
        if kind == "service" and not name.endswith("Service"):
            self.report(number, f"service {name} does not end in Service")

    def check_member(self, number, code, comment):
        kind, owner, count = self.scopes[-1]
        name = None
        if kind == "enum" and (value := VALUE.match(code)):
            name = value.group(1)
            self.check_value(number, owner, name, int(value.group(2)), count)
        elif kind == "service" and (rpc := RPC.match(code)):
            name = rpc.group(1)
            self.check_rpc(number, *rpc.groups())
        elif kind in ("message", "oneof") and (field := FIELD.match(code)):
            name = field.group(2)
            message = owner if kind == "message" else self.scopes[-2][1]
            # One member of a oneof is given; the comment of the oneof states whether it is required.
            self.fields.append((message, name, field.group(1), comment if kind == "message" else None, number))
            if not re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", name):
                self.report(number, f"field {name} is not lower_snake_case")
            if self.has_comments and field.group(1) == "bool" and name.startswith("is_"):
                self.report(number, f"field {name} has the prefix is_ (AIP-140)")
        if name is None:
            return
        self.scopes[-1][2] += 1
        if self.has_comments and not comment:
            self.report(number, f"{owner}.{name} has no comment")

    def check_value(self, number, enum, name, value, count):
        prefix = snake(enum) + "_"
        if count == 0 and (value != 0 or name != prefix + "UNSPECIFIED"):
            self.report(number, f"the first value of {enum} is not {prefix}UNSPECIFIED = 0")
        if enum not in UNPREFIXED_ENUMS and not name.startswith(prefix):
            self.report(number, f"{name} does not have the prefix {prefix}")
        if not re.fullmatch(r"[A-Z][A-Z0-9]*(_[A-Z0-9]+)*", name):
            self.report(number, f"{name} is not UPPER_SNAKE_CASE")

    def check_rpc(self, number, method, request, response):
        if request != method + "Request":
            self.report(number, f"the request of {method} is {request}, not {method}Request")
        if response not in expected_response(method):
            self.report(number, f"the response of {method} is {response}, not {' or '.join(expected_response(method))}")
        self.requests.append((number, request))


def check_presence(files):
    """Reports the fields of requests, and of the messages in them, whose comments say neither Required nor Optional."""
    of_message = {}
    for file in files:
        for message, *field in file.fields:
            of_message.setdefault(message, []).append((file, *field))
    waiting = [request for file in files for _, request in file.requests] + sorted(UPLOADED)
    checked = set(VALUES)
    while waiting:
        message = waiting.pop()
        if message in checked:
            continue
        checked.add(message)
        for file, name, kind, comment, number in of_message.get(message, []):
            waiting.append(kind.rpartition(".")[2])
            if comment is not None and not re.search(r"\b(Required|Optional)\b", comment):
                file.report(number, f"the comment of {message}.{name}, in a request, says neither Required nor Optional")


def main(arguments):
    repository = pathlib.Path(__file__).resolve().parents[2]
    start = pathlib.Path(arguments[0]).resolve() if arguments else repository / "proto" / "evpose"
    paths = sorted(start.rglob("*.proto"))
    if not paths:
        print(f"proto_lint: no proto files in {start}", file=sys.stderr)
        return 1
    files = [File(path, start.parent).check() for path in paths]
    check_presence([file for file in files if file.has_comments])
    findings = [finding for file in files for finding in file.findings]
    users = {}
    for file in files:
        for number, request in file.requests:
            if request in users:
                findings.append(f"{file.path}:{number}: {request} is the request of two methods ({users[request]})")
            users[request] = f"{file.path}:{number}"
    for finding in findings:
        print(finding)
    print(f"proto_lint: {len(findings)} findings in {len(files)} files", file=sys.stderr)
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

# SPDX-License-Identifier: Apache-2.0
"""The server that the tests attack, and their base class."""

import argparse
import hashlib
import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest

import http2

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests"))
import processes  # noqa: E402
from checks import PATIENCE_S, poll  # noqa: E402
from processes import Redis, connect, read_line  # noqa: E402, F401


def _build_directory():
    """Removes --bin DIR, the directory of the build, from the command line and returns it."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build/release")
    known, sys.argv[1:] = parser.parse_known_args()
    return known.bin.resolve()


BIN = _build_directory()
SERVER = BIN / "server/evpose-server"
EVPOSE = BIN / "client/cli/evpose"


def write_tokens(path, tenants, operator=None):
    """Writes the token file of these tenants. A tenant's token is token(tenant)."""
    lines = [
        f"{name} {hashlib.sha256(token(name).encode()).hexdigest()}{' operator' if name == operator else ''}\n"
        for name in tenants
    ]
    temporary = path.with_suffix(".new")
    temporary.write_text("# tokens\n" + "".join(lines))
    temporary.chmod(0o600)
    temporary.rename(path)
    return path


def token(tenant):
    return "evpose_" + hashlib.sha256(f"token of {tenant}".encode()).hexdigest()


def mounted(path, size_bytes):
    """Returns the beginning of a command that runs a program with a file system of this size, in memory, at `path`. The program has the
    process id of the command, and only it sees the file system."""
    script = 'mount -t tmpfs -o size="$0" none "$1" && shift && exec "$@"'
    return ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", script, str(size_bytes), str(path)]


CAN_MOUNT = subprocess.run([*mounted("/mnt", 1 << 20), "true"], capture_output=True, check=False).returncode == 0


class Server(processes.Server):
    """A running evpose-server, which is attacked. `prlimit` has options of prlimit(1), such as --as=BYTES. With `disk_bytes`, its data are
    on a file system of this size (CAN_MOUNT)."""

    # One line for each server of this process that ended, or stopped accepting connections, because of a client's input.
    defeats = []

    def __init__(self, *options, directory, prlimit=(), store="memory", disk_bytes=None):
        prefix = ["prlimit", *prlimit, "--"] if prlimit else []
        if disk_bytes is not None:
            (directory / "data").mkdir()
            prefix = [*mounted(directory / "data", disk_bytes), *prefix]
        super().__init__(SERVER, *options, directory=directory, store=store, prefix=prefix)

    def answers(self, timeout=PATIENCE_S):
        """Returns whether the server answers the preface of HTTP/2 on a new connection."""
        try:
            with self.connect() as connection:
                connection.settimeout(timeout)
                connection.sendall(http2.PREFACE + http2.EMPTY_SETTINGS)
                return len(connection.recv(9)) > 0
        except OSError:
            return False

    def defeat(self):
        """Returns how a client has ended the server or stopped it from accepting connections; empty if it works."""
        if self.process.poll() is not None:
            return f"ended with status {self.process.returncode}: {self.log()[-500:]}"
        if not self.answers():
            return "accepts no connection"
        try:  # after a start or an attack it may take a moment
            poll(lambda: self.page("/readyz")[0] == 200, "readiness")
            return ""
        except (AssertionError, OSError):
            return "is not ready"


class AdversaryTest(unittest.TestCase):
    """A test that attacks servers. Each server must survive it: it still accepts connections, is ready, and ends at SIGTERM."""

    def setUp(self):
        self.directory = pathlib.Path(tempfile.mkdtemp(prefix="evpose_adversary_"))
        self.addCleanup(shutil.rmtree, self.directory)

    def serve(self, *options, tenants=(), operator=None, **settings):
        """Starts a server; with tenants, it has a token for each of them."""
        if tenants:
            tokens = write_tokens(self.directory / "tokens", tenants, operator)
            options = (*options, "--token-file", str(tokens))
        server = Server("--shutdown-timeout", "1", *options, directory=self.directory, **settings)
        self.addCleanup(self._end, server)
        return server

    def _end(self, server):
        if server.is_ended:
            return
        defeat = server.defeat()
        if defeat:
            Server.defeats.append(f"{self.id()}: {defeat}")
            server.kill()
            self.fail(defeat)
        self.assertEqual(server.terminate(), 0, server.log()[-2000:])

    def assert_not_started(self, *options, prlimit=(), status):
        """Checks that the server ends at its start with this status and one line that gives the reason. Returns the line."""
        command = [*(["prlimit", *prlimit, "--"] if prlimit else []), str(SERVER)]
        command += ["--listen", "127.0.0.1:0", "--store", "memory", *options]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        try:
            self.assertEqual(read_line(process.stdout), "", f"{options} were accepted")
            line = process.stderr.read().decode()
            self.assertEqual((process.wait(), line.count("\n")), (status, 1), line)
            return line
        finally:
            process.kill()
            process.communicate()


# Figures that tests have measured: {name: text}. They are printed by figures.py.
figures = {}

# SPDX-License-Identifier: Apache-2.0
"""The processes that the tests attack: evpose-server and redis-server, their start, observation and end."""

import argparse
import contextlib
import hashlib
import http.client
import os
import pathlib
import re
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import unittest

import http2

ROOT = pathlib.Path(__file__).resolve().parents[2]
# A condition that has not become true after this time is a failure. No test depends on how much earlier it becomes true.
PATIENCE_S = 120.0


def _build_directory():
    """Removes --bin DIR, the directory of the build, from the command line and returns it."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build/release")
    known, sys.argv[1:] = parser.parse_known_args()
    return known.bin.resolve()


BIN = _build_directory()
SERVER = BIN / "server/evpose-server"
EVPOSE = BIN / "client/cli/evpose"


def poll(condition, what):
    """Returns the first value of condition() that is true."""
    end = time.monotonic() + PATIENCE_S
    while not (value := condition()):
        if time.monotonic() > end:
            raise AssertionError(f"not reached in {PATIENCE_S:.0f} s: {what}")
        time.sleep(0.01)
    return value


def read_line(stream):
    """Returns the next line of a pipe, or an empty string at its end."""
    if not select.select([stream], [], [], PATIENCE_S)[0]:
        raise AssertionError(f"no line in {PATIENCE_S:.0f} s")
    line = b""
    while not line.endswith(b"\n") and (byte := os.read(stream.fileno(), 1)):
        line += byte
    return line.decode()


def connect(address, source=None):
    """Returns a TCP connection to HOST:PORT, from this address of the machine if one is given."""
    host, port = address.rsplit(":", 1)
    return socket.create_connection((host, int(port)), timeout=PATIENCE_S, source_address=source and (source, 0))


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


class Server:
    """A running evpose-server. `prlimit` has options of prlimit(1), such as --as=BYTES. With `disk_bytes`, its data are on a file
    system of this size (CAN_MOUNT)."""

    # One line for each server of this process that ended, or stopped accepting connections, because of a client's input.
    defeats = []

    def __init__(self, *options, directory, prlimit=(), store="memory", disk_bytes=None):
        self.command = [*(["prlimit", *prlimit, "--"] if prlimit else []), str(SERVER)]
        if disk_bytes is not None:
            (directory / "data").mkdir()
            self.command = [*mounted(directory / "data", disk_bytes), *self.command]
        self.command += ["--listen", "127.0.0.1:0", "--metrics-listen", "127.0.0.1:0", "--store", store, *options]
        if store == "sqlite":
            self.command += ["--data-dir", str(directory / "data")]
        self.log_path = directory / "log"
        self.start()

    def start(self):
        with open(self.log_path, "ab") as log:
            self.process = subprocess.Popen(self.command, stdout=subprocess.PIPE, stderr=log)
        self.is_ended = False
        self.address, self.metrics_address = (self._announced(words) for words in ("listening on ", "metrics on "))

    def _announced(self, words):
        try:
            line = read_line(self.process.stdout)
            if not line.startswith(words):
                raise AssertionError(f"evpose-server does not say '{words}' but '{line}': {self.log()[-2000:]}")
            return line[len(words):].strip()
        except BaseException:
            self.process.kill()
            self.process.wait()
            raise

    def connect(self):
        """Returns a TCP connection to --listen."""
        return connect(self.address)

    def log(self):
        return self.log_path.read_text(errors="replace")

    def page(self, path, timeout=PATIENCE_S, accept="*/*"):
        """Returns the status and the text of a page of --metrics-listen."""
        connection = http.client.HTTPConnection(self.metrics_address, timeout=timeout)
        try:
            connection.request("GET", path, headers={"Accept": accept})
            response = connection.getresponse()
            return response.status, response.read().decode()
        finally:
            connection.close()

    def metric(self, name, *labels):
        """Returns the sum of the series of a metric that have all of these labels, written as in the text format."""
        return self.metrics((name, *labels))[0]

    def metrics(self, *selections):
        """Returns one sum for each selection (name, *labels) as metric() does, all of one point in time."""
        series = [line.rsplit(" ", 1) for line in self.page("/metrics")[1].splitlines() if not line.startswith("#")]
        return [
            sum(float(value) for key, value in series if key.split("{")[0] == name and all(label in key for label in labels))
            for name, *labels in selections
        ]

    def _status(self, field):
        text = pathlib.Path(f"/proc/{self.process.pid}/status").read_text()
        return next(int(line.split()[1]) for line in text.splitlines() if line.startswith(field + ":"))

    def resident_bytes(self):
        return self._status("VmRSS") * 1024

    def peak_bytes(self):
        return self._status("VmHWM") * 1024

    def cpu_s(self):
        """Returns the processor time of the server and of the processes that it has started, so far."""
        ticks = 0
        for path in pathlib.Path("/proc").glob("[0-9]*/stat"):
            with contextlib.suppress(OSError):  # a process that has ended
                fields = path.read_text().rsplit(")", 1)[1].split()
                if path.parent.name == str(self.process.pid):
                    ticks += sum(map(int, fields[11:15]))  # with those of children that have ended
                elif fields[1] == str(self.process.pid):
                    ticks += sum(map(int, fields[11:13]))
        return ticks / os.sysconf("SC_CLK_TCK")

    def answers(self, timeout=PATIENCE_S):
        """Returns whether the server answers the preface of HTTP/2 on a new connection."""
        try:
            with self.connect() as connection:
                connection.settimeout(timeout)
                connection.sendall(http2.PREFACE + http2.EMPTY_SETTINGS)
                return len(connection.recv(9)) > 0
        except OSError:
            return False

    def wait(self):
        """Waits for the end. Returns the exit status, or minus the number of the signal that ended the process."""
        try:
            return self.process.wait(timeout=PATIENCE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            raise AssertionError("the server did not end") from None
        finally:
            self.is_ended = True
            self.process.stdout.close()

    def terminate(self):
        """Sends SIGTERM. Returns the exit status."""
        self.process.send_signal(signal.SIGTERM)
        return self.wait()

    def kill(self):
        self.process.kill()
        self.wait()

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


class Redis:
    """A running redis-server in `directory`."""

    def __init__(self, directory):
        self.socket_path = directory / "redis.socket"
        command = ["redis-server", "--port", "0", "--unixsocket", str(self.socket_path), "--dir", str(directory)]
        self.process = subprocess.Popen([*command, "--save", ""], stdout=subprocess.DEVNULL)
        self.url = f"redis+unix://{self.socket_path}"
        poll(self.socket_path.exists, "the socket of redis-server")

    def reads(self):
        """Returns how often Redis has read from a client: the round trips of all clients so far."""
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(PATIENCE_S)
            connection.connect(str(self.socket_path))
            connection.sendall(b"INFO stats\r\n")
            text = b""
            while not (count := re.search(rb"total_reads_processed:(\d+)\r\n", text)):
                data = connection.recv(65536)
                if not data:
                    raise AssertionError(f"redis-server closed the connection after {text!r}")
                text += data
        return int(count[1])

    def stop(self):
        self.process.kill()
        self.process.wait()


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

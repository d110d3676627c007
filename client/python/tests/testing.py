# SPDX-License-Identifier: Apache-2.0
"""What the tests of the package share: the built package, and a relay that cuts connections. The option --bin DIR of each test is the
directory of the build."""

import itertools
import pathlib
import socket
import subprocess
import sys
import threading

ROOT = pathlib.Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "tests/adversary"))
import server  # reads --bin

sys.path.insert(0, str(server.BIN / "client/python"))
import evpose

# Retries without long delays, and without an end.
PATIENT = evpose.RetryOptions(max_outage_s=server.PATIENCE_S, first_delay_s=0.01, max_delay_s=0.1)


def run_evpose(*arguments, cwd=None):
    """Runs the command evpose, which must succeed."""
    done = subprocess.run([server.EVPOSE, *map(str, arguments)], cwd=cwd, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise AssertionError(f"evpose {arguments}: {done.stderr}")
    return done.stdout


def message_of(error, function, *arguments):
    """Calls function(*arguments), which must raise an error of this class. Returns its message."""
    try:
        function(*arguments)
    except error as raised:
        return str(raised)
    raise AssertionError(f"{error.__name__} was not raised")


class Relay:
    """Forwards TCP connections to `target`, HOST:PORT, or refuses them while there is none. cut() ends those that are open."""

    def __init__(self, target):
        self.target = target
        self._connections = []
        self._lock = threading.Lock()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = "127.0.0.1:%d" % self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            try:
                target = self._choose()
                far = server.connect(target) if target else None
            except OSError:
                far = None
            if far is None:
                near.close()
                continue
            far.settimeout(None)
            with self._lock:
                self._connections += [near, far]
            for source, sink in ((near, far), (far, near)):
                threading.Thread(target=self._forward, args=(source, sink), daemon=True).start()

    def _choose(self):
        return self.target

    @staticmethod
    def _forward(source, sink):
        try:
            while data := source.recv(65536):
                sink.sendall(data)
        except OSError:
            pass
        for each in (source, sink):
            try:
                each.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass

    def cut(self):
        with self._lock:
            for connection in self._connections:
                try:
                    connection.shutdown(socket.SHUT_RDWR)
                except OSError:
                    pass
                connection.close()
            self._connections.clear()

    def close(self):
        self._listener.close()
        self.cut()


class Balancer(Relay):
    """Forwards TCP connections to the targets in turn, as a Service of Kubernetes may do, until refuse() is called."""

    def __init__(self, *targets):
        self._targets = itertools.cycle(targets)
        super().__init__(None)

    def _choose(self):
        return next(self._targets)

    def refuse(self):
        self._targets = itertools.repeat(None)

# SPDX-License-Identifier: Apache-2.0
"""The processes that the tests and benches in Python start: evpose-server, redis-server, HAProxy and evpose, with what they need: scenes,
models and the messages of the API."""
import contextlib
import http.client
import importlib
import os
import pathlib
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time

from checks import PATIENCE_S, poll

ROOT = pathlib.Path(__file__).resolve().parents[1]
PROTO = ROOT / "proto"
HAPROXY = shutil.which("haproxy", path=os.environ["PATH"] + ":/usr/sbin")


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


def free_ports(count):
    """Returns ports that are free at all addresses of the machine at this moment."""
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for each in sockets:
            each.bind(("", 0))
        return [each.getsockname()[1] for each in sockets]


def get_page(address, path, timeout=PATIENCE_S, accept="*/*"):
    """Returns the status and the text of a page of HOST:PORT."""
    connection = http.client.HTTPConnection(address, timeout=timeout)
    try:
        connection.request("GET", path, headers={"Accept": accept})
        response = connection.getresponse()
        return response.status, response.read().decode()
    finally:
        connection.close()


def metric_sums(text, *selections):
    """Returns for each selection (name, *labels) the sum of the series of this metric that have all of these labels, written as in the text
    format of Prometheus."""
    series = [line.rsplit(" ", 1) for line in text.splitlines() if not line.startswith("#")]
    return [
        sum(float(value) for key, value in series if key.split("{")[0] == name and all(label in key for label in labels))
        for name, *labels in selections
    ]


class Server:
    """A running evpose-server, `program`. Its log, and its data with the store "sqlite", are in `directory`, by default a temporary one.
    `store` None: `options` name one. `prefix` is the beginning of a command that runs the server, such as prlimit(1). A context manager,
    which kills a server that has not ended."""

    def __init__(self, program, *options, directory=None, store="memory", prefix=()):
        self._temporary = tempfile.TemporaryDirectory() if directory is None else None
        directory = pathlib.Path(self._temporary.name if directory is None else directory)
        self.command = [*map(str, prefix), str(program), "--listen", "127.0.0.1:0", "--metrics-listen", "127.0.0.1:0"]
        self.command += ["--store", store] if store is not None else []
        self.command += map(str, options)
        if store == "sqlite":
            self.command += ["--data-dir", str(directory / "data")]
        self.log_path = directory / "log"
        self.start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if not self.is_ended:
            self.kill()

    def start(self):
        self.started_s = time.monotonic()
        with open(self.log_path, "ab") as log:
            self.process = subprocess.Popen(self.command, stdout=subprocess.PIPE, stderr=log)
        self.is_ended = False
        self.address, self.metrics_address = (self._announced(words) for words in ("listening on ", "metrics on "))
        self.load_address = self._announced("load on ") if "--load-listen" in self.command else None

    def _announced(self, words):
        try:
            line = read_line(self.process.stdout)
            if not line.startswith(words):
                raise AssertionError(f"evpose-server does not say '{words}' but '{line}': {self.log()[-2000:]}")
            return line[len(words):].strip()
        except BaseException:
            self.kill()
            raise

    def connect(self):
        """Returns a TCP connection to --listen."""
        return connect(self.address)

    def log(self):
        return self.log_path.read_text(errors="replace")

    def page(self, path, timeout=PATIENCE_S, accept="*/*"):
        """Returns the status and the text of a page of --metrics-listen."""
        return get_page(self.metrics_address, path, timeout, accept)

    def metric(self, name, *labels):
        """Returns the sum of the series of a metric that have all of these labels, written as in the text format."""
        return self.metrics((name, *labels))[0]

    def metrics(self, *selections):
        """Returns one sum for each selection (name, *labels) as metric() does, all of one point in time."""
        return metric_sums(self.page("/metrics")[1], *selections)

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


class Redis:
    """A running redis-server in `directory`; `options` are added to its command line. A context manager, which stops it."""

    def __init__(self, directory, *options):
        self.socket_path = pathlib.Path(directory, "redis.socket")
        command = ["redis-server", "--port", "0", "--unixsocket", str(self.socket_path), "--dir", str(directory), "--save", ""]
        self.process = subprocess.Popen([*command, *options], stdout=subprocess.DEVNULL)
        self.url = f"redis+unix://{self.socket_path}"
        try:
            poll(lambda: self.socket_path.exists() or self.process.poll() is not None, "the socket of redis-server")
            if self.process.poll() is not None:
                raise AssertionError(f"redis-server ended with status {self.process.returncode}")
        except BaseException:
            self.stop()
            raise

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()

    def info(self):
        """Returns the fields of INFO."""
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(PATIENCE_S)
            connection.connect(str(self.socket_path))
            connection.sendall(b"INFO\r\n")
            with connection.makefile("rb") as answer:
                head = answer.readline()
                if not head.startswith(b"$"):
                    raise AssertionError(f"redis-server answers INFO with {head!r}")
                text = answer.read(int(head[1:])).decode()
        return dict(line.split(":", 1) for line in text.splitlines() if ":" in line)

    def reads(self):
        """Returns how often Redis has read from a client: the round trips of all clients so far."""
        return int(self.info()["total_reads_processed"])

    def stop(self):
        self.process.kill()
        self.process.wait()


def haproxy_files(command, folder, changes):
    """Copies the files of deploy/haproxy that a command of HAProxy names to a folder, with other paths and addresses: pairs of texts.
    Returns the options of HAProxy for the copies."""
    options = []
    for name in [word for word in command if word.endswith(".cfg")]:
        text = (ROOT / "deploy/haproxy" / pathlib.Path(name).name).read_text()
        for old, new in [("init-addr last,libc,none", "init-addr none"), *changes]:
            text = text.replace(old, new)
        path = pathlib.Path(folder, pathlib.Path(name).name)
        path.write_text(text)
        options += ["-f", str(path)]
    return options


def cluster_changes(front, counts, servers):
    """Returns the changes of cluster.cfg for HAProxy in front of at most three servers, each with its addresses: that for clients, that of
    its metrics and that of its load. HAProxy inherits the sockets `front`, for clients, and `counts`, for its own metrics."""
    changes = [(":50051 proto", f"fd@{front.fileno()} proto"), ("bind :8404", f"bind fd@{counts.fileno()}"),
               ("init-addr none", "init-addr last")]
    for i in range(1, 4):
        if i > len(servers):
            changes.append((f"  server server-{i} server-{i}:50051 check-proto h1\n", ""))
            continue
        address, metrics, load = servers[i - 1]
        changes.append((f"server server-{i} server-{i}:50051",
                        f"server server-{i} {address} port {metrics.rpartition(':')[2]} agent-port {load.rpartition(':')[2]}"))
    return changes


class ClusterProxy:
    """HAProxy of compose.cluster.yaml in front of at most three servers, which have --load-listen; its files are in `directory`. A context
    manager, which kills it."""

    def __init__(self, directory, servers):
        with contextlib.ExitStack() as stack:
            front, counts = (stack.enter_context(socket.create_server(("127.0.0.1", 0), backlog=1024)) for _ in range(2))
            addresses = [(server.address, server.metrics_address, server.load_address) for server in servers]
            options = haproxy_files(["common.cfg", "cluster.cfg"], directory, cluster_changes(front, counts, addresses))
            self.process = subprocess.Popen([HAPROXY, "-db", *options], pass_fds=[front.fileno(), counts.fileno()], stdout=subprocess.DEVNULL,
                                            stderr=subprocess.DEVNULL)
            self.address, self.metrics_address = (f"127.0.0.1:{each.getsockname()[1]}" for each in (front, counts))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()


def run_evpose(evpose, *arguments):
    """Runs the program `evpose`, which must succeed. Returns its output."""
    done = subprocess.run([evpose, *map(str, arguments)], check=False, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"evpose {arguments[0]}: {done.stderr.strip()}")
    return done.stdout


def simulate(evpose, scene, *options):
    """Simulates a recording into the folder `scene`, with its truth, model and camera. Returns what the program prints."""
    return run_evpose(evpose, "simulate", *options, "--out", scene)


def first_pose(scene):
    """Returns the first pose of the truth of a simulated scene, as --init-pose takes it."""
    with open(pathlib.Path(scene, "truth.tum"), encoding="ascii") as file:
        return next(line.partition(" ")[2].strip() for line in file if not line.startswith("#"))


def cube_obj(low=0, high=1):
    """Returns an OBJ file of a cube with these coordinates of its sides, in metres."""
    corners = [(low, low), (high, low), (high, high), (low, high)]
    vertices = "".join(f"v {x} {y} {z}\n" for z in (low, high) for x, y in corners)
    return (vertices + "f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n").encode()


def load_api(folder):
    """Generates the messages of the API in a folder and returns the modules of sessions, the service of sessions and that of models."""
    protos = [str(path.relative_to(PROTO)) for path in PROTO.glob("evpose/v1/*.proto")]
    subprocess.run(["protoc", "-I", str(PROTO), f"--python_out={folder}", *protos], check=True)
    sys.path.insert(0, str(folder))
    return tuple(importlib.import_module(f"evpose.v1.{name}_pb2") for name in ("session", "session_service", "model_service"))

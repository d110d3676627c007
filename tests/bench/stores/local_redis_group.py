# SPDX-License-Identifier: Apache-2.0
"""Three Redis servers with the settings of deploy/redis/node.conf, behind a Sentinel."""
import contextlib
import pathlib
import shlex
import subprocess
import sys

sys.path.append(str(pathlib.Path(__file__).resolve().parents[2]))
from checks import poll  # noqa: E402
from processes import ROOT, Redis, connect, free_ports  # noqa: E402

NAME = "evpose"
# Not those of the encryption, of users and of paths: the group is on the loopback interface, without passwords.
LEFT_OUT = ("port", "tls-", "aclfile", "dir")
# A busy machine must cause no failover.
DOWN_AFTER_MS = 600_000
TRIES = 5


def node_options():
    """Returns the settings of node.conf as options of redis-server."""
    lines = (ROOT / "deploy/redis/node.conf").read_text().splitlines()
    settings = [shlex.split(line) for line in lines if line and not line.startswith(("#", *LEFT_OUT))]
    return [word for name, *values in settings for word in (f"--{name}", *values)]


class RedisGroup:
    """A master with two replicas, each in its own folder below `directory`, and one Sentinel. `options` are added to the command lines of
    the Redis servers. A context manager, which stops all."""

    def __init__(self, directory, *options):
        self.directory = pathlib.Path(directory)
        self.options = options
        with contextlib.ExitStack() as stack:
            for last in [False] * (TRIES - 1) + [True]:
                try:
                    self._start(stack)
                    break
                except AssertionError:  # another program has taken a port
                    stack.close()
                    if last:
                        raise
            poll(lambda: sum("state=online" in value for value in self.info().values()) == 2, "two replicas follow the master")
            self.stack = stack.pop_all()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stack.close()

    def _start(self, stack):
        *ports, sentinel_port = free_ports(4)
        self.nodes = []
        for port in ports:
            folder = self.directory / f"redis-{port}"
            folder.mkdir()
            master = ["--replicaof", "127.0.0.1", str(ports[0])] if port != ports[0] else []
            command = ["--port", str(port), "--bind", "127.0.0.1", *node_options(), *master, *self.options]
            self.nodes.append(stack.enter_context(Redis(folder, *command)))
        folder = self.directory / f"sentinel-{sentinel_port}"
        folder.mkdir()
        (folder / "sentinel.conf").write_text(
            f"port {sentinel_port}\nbind 127.0.0.1\ndir {folder}\nsentinel monitor {NAME} 127.0.0.1 {ports[0]} 1\n"
            f"sentinel down-after-milliseconds {NAME} {DOWN_AFTER_MS}\n")
        sentinel = subprocess.Popen(["redis-server", str(folder / "sentinel.conf"), "--sentinel"], stdout=subprocess.DEVNULL)
        stack.callback(sentinel.wait)
        stack.callback(sentinel.kill)
        poll(lambda: sentinel.poll() is not None or self._accepts(sentinel_port), "the port of the Sentinel")
        if sentinel.poll() is not None:
            raise AssertionError(f"the Sentinel ended with status {sentinel.returncode}")
        self.url = f"redis+sentinel://127.0.0.1:{sentinel_port}/{NAME}"

    @staticmethod
    def _accepts(port):
        with contextlib.suppress(OSError), connect(f"127.0.0.1:{port}"):
            return True
        return False

    def info(self):
        """Returns the fields of INFO of the master."""
        return self.nodes[0].info()

    def cpu_s(self):
        """Returns the processor time of the master."""
        fields = self.info()
        return float(fields["used_cpu_user"]) + float(fields["used_cpu_sys"])

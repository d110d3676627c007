# SPDX-License-Identifier: Apache-2.0
"""The three Redis servers, three Sentinels, tunnels and servers of compose.sentinel.yaml, or of the overlay sentinel for Kubernetes, as
processes, with the files that they mount. Needs root, because each process has a mount namespace with a hosts file of its own."""
import dataclasses
import os
import pathlib
import re
import signal
import subprocess

import yaml

from checks import check, poll

ROOT = pathlib.Path(__file__).resolve().parent.parent
NAMES = ("redis-1", "redis-2", "redis-3")
SENTINELS = ("sentinel-1", "sentinel-2", "sentinel-3")


@dataclasses.dataclass
class Layout:
    """What compose.sentinel.yaml or the overlay says of the group. Nodes have the names of NAMES and SENTINELS here."""

    hosts: dict[str, str]  # the name by which others reach a node, by node
    commands: dict[str, list[str]]  # of a node: start.sh with its arguments
    probes: dict[str, list[str]]  # of a node: the command that ends with status 0 when it is ready
    files: dict[str, str]  # those beside start.sh
    aliases: dict[str, str]  # of servers: loopback address by name
    tunnel: list[str]  # the command of HAProxy
    tunnel_environment: dict[str, str]
    server: list[str]  # options
    proxy: list[str] | None = None  # the command of the HAProxy in front of the servers of compose


def compose_layout():
    services = yaml.safe_load((ROOT / "deploy/compose.sentinel.yaml").read_text())["services"]
    nodes = (*NAMES, *SENTINELS)
    return Layout(
        hosts={name: name for name in nodes},
        commands={name: services[name]["command"] for name in nodes},
        probes={name: services[name]["healthcheck"]["test"][1:] for name in nodes},
        files={path.name: path.read_text() for path in (ROOT / "deploy/redis").iterdir()},
        aliases=dict(entry.split(":") for entry in services["store-1"]["extra_hosts"]),
        tunnel=services["store-1"]["command"],
        tunnel_environment={},
        server=services["server-1"]["command"],
        proxy=services["haproxy"]["command"])


class Group:
    """Processes of a layout. Secrets, data, logs and changed files are in the folder `work`. Others reach a node at its address in
    `addresses` and at these ports, by default those of the files. `enter` is the beginning of a command that runs in the network of a
    process, by the name of a node or server."""

    def __init__(self, work, stack, layout, addresses, ports=(6379, 26379), enter=lambda name: ()):
        self.work, self.stack, self.layout, self.addresses, self.enter, self.processes = work, stack, layout, addresses, enter, {}
        self.secrets = work / "secrets"
        subprocess.run([ROOT / "deploy/make-secrets.sh", self.secrets], check=True, capture_output=True)
        self.password = (self.secrets / "redis.password").read_text().strip()
        self.redis_port, self.sentinel_port = ports
        self.names = {host: name for name, host in layout.hosts.items()}
        self.write_hosts("nodes", {host: self.addresses[name] for name, host in layout.hosts.items()})
        self.write_hosts("server", layout.aliases)

    def write_hosts(self, name, addresses):
        lines = [f"{address} {host}\n" for host, address in addresses.items()]
        (self.work / f"{name}.hosts").write_text("".join(["127.0.0.1 localhost\n", *lines]))

    def changed(self, text, data):
        text = re.sub(r"\b26379\b", str(self.sentinel_port), re.sub(r"\b6379\b", str(self.redis_port), text))
        return re.sub(r"(?<![\w/])/data\b", str(data), text.replace("/run/secrets", str(self.secrets)))

    def start(self, name, place, hosts, command, **options):
        """Starts a process in the network of `place`, with the hosts file `hosts`. The end of this program kills it."""
        mount = f"mount --bind {self.work}/{hosts}.hosts /etc/hosts && exec \"$@\""
        process = subprocess.Popen([*self.enter(place), "unshare", "--mount", "setpriv", "--pdeathsig", "KILL", "sh", "-c", mount, "sh",
                                    *command], text=True, **options)
        self.processes[name] = process

        def end():
            process.kill()
            process.communicate()

        self.stack.callback(end)
        return process

    def start_node(self, name):
        """Starts a Redis server or a Sentinel with the command of its service, and waits until it listens."""
        folder, data = self.work / name, self.work / name / "data"
        data.mkdir(parents=True, exist_ok=True)
        for file, text in self.layout.files.items():
            # Beside the others of this machine.
            bind = f"bind {self.addresses[name]}\n" if file.endswith(".conf") else ""
            (folder / file).write_text(bind + self.changed(text, data))
        script, *words = self.layout.commands[name]
        check(script == "/etc/redis-group/start.sh", name, "starts", script)
        log = self.work / f"{name}.log"
        with open(log, "w", encoding="utf-8") as out:
            process = self.start(name, name, "nodes", ["bash", folder / "start.sh", *words], stdout=out, stderr=out)

        def listens():
            text = log.read_text()
            check(process.poll() is None, name, "does not start:", text)
            return re.search("eady to accept connections|[+]monitor master|Sentinel ID is", text)

        poll(listens, f"{name} listens")

    def kill(self, *names):
        for name in names:
            self.processes[name].send_signal(signal.SIGKILL)
            self.processes[name].wait()

    def cli(self, name, *words):
        port = self.sentinel_port if name in SENTINELS else self.redis_port
        run = subprocess.run(["redis-cli", "--tls", "--cacert", self.secrets / "redis.crt", "-h", self.addresses[name], "-p", str(port), *words],
                             capture_output=True, text=True, env={**os.environ, "REDISCLI_AUTH": self.password})
        return run.stdout.strip()

    def roles(self):
        return {name: (self.cli(name, "role").splitlines() or ["away"])[0] for name in NAMES}

    def masters(self):
        """The master by each Sentinel."""
        replies = [self.cli(name, "sentinel", "get-master-addr-by-name", "evpose").splitlines() for name in SENTINELS]
        return [self.names.get(reply[0], "") if reply else "" for reply in replies]

    def is_ready(self, name):
        """Runs the health check of a node, at its address."""
        at = f"redis-cli -h {self.addresses[name]}" + ("" if name in SENTINELS else f" -p {self.redis_port}")
        command = [word for part in self.layout.probes[name] for word in (at.split() if part == "redis-cli" else [part])]
        command = [self.changed(word, "/").replace("redis-cli --tls", f"{at} --tls") for word in command]
        return subprocess.run(command, capture_output=True).returncode == 0

    def agreed_master(self):
        """The master, if all Sentinels name the same one and it accepts the role."""
        names = set(self.masters())
        name = names.pop()
        return name if not names and name and self.roles()[name] == "master" else None

    def know_all(self):
        fields = [re.search(r"slaves=(\d+),sentinels=(\d+)", self.cli(name, "info", "sentinel")) for name in SENTINELS]
        return all(found and found.groups() == ("2", "3") for found in fields)

    def replicas(self, master):
        return len(re.findall("state=online", self.cli(master, "info", "replication")))

    def await_master(self, num_replicas):
        """Waits for a master with this number of replicas, and returns its name. On a busy machine it need not be the first one."""
        def find():
            master = self.agreed_master()
            return master if master and self.replicas(master) == num_replicas and self.know_all() else None

        return poll(find, f"a master with {num_replicas} replicas")

    def start_haproxy(self, name, place, hosts, words, changes=(), **environment):
        """Starts HAProxy with the files of deploy/haproxy that `words` name, after these changes of their text."""
        folder = self.work / name
        folder.mkdir(exist_ok=True)
        command = []
        for word in words:
            if word.endswith(".cfg"):
                text = (ROOT / "deploy/haproxy" / pathlib.Path(word).name).read_text()
                # The hosts file is the DNS of this test.
                text = re.sub(r"resolvers dns init-addr \S+", "init-addr libc", self.changed(text, folder))
                for old, new in changes:
                    text = text.replace(old, new)
                word = folder / pathlib.Path(word).name
                word.write_text(text)
            command.append(word)
        environment = {**os.environ, **environment, "PATH": os.environ["PATH"] + ":/usr/sbin"}
        with open(self.work / f"{name}.log", "w", encoding="utf-8") as out:
            self.start(name, place, hosts, command, env=environment, stdout=out, stderr=out)

    def await_listener(self, name, place, address, port):
        """Waits until the process `name` accepts connections, as others in the network of `place` see it."""
        def listens():
            check(self.processes[name].poll() is None, name, "ends:", (self.work / f"{name}.log").read_text())
            probe = ["bash", "-c", f"exec 3<>/dev/tcp/{address}/{port}"]
            return subprocess.run([*self.enter(place), *probe], capture_output=True).returncode == 0

        poll(listens, f"{name} listens")

    def start_tunnel(self, place):
        """Starts the HAProxy between the server `place` and the nodes."""
        name = f"tunnel-{place}"
        self.start_haproxy(name, place, "nodes", self.layout.tunnel, **self.layout.tunnel_environment)
        self.await_listener(name, place, "127.0.1.1", self.redis_port)

    def start_server(self, program, place, options, is_restarted=False):
        """Starts a server, whose tunnel has been started, and returns the lines with its addresses. `is_restarted`: starts it again when
        it ends because its store is not ready, as compose does."""
        def start():
            with open(self.work / f"{place}.log", "w", encoding="utf-8") as out:
                process = self.start(place, place, "server", [program, *options], stdout=subprocess.PIPE, stderr=out)
            lines = [process.stdout.readline() for _ in range(2)]
            is_started = lines[1].startswith("metrics on ")
            check(is_started or is_restarted, "the server does not start:", (self.work / f"{place}.log").read_text())
            return lines if is_started else None

        return poll(start, f"the start of {place}")

    def server_options(self):
        return [self.changed(word, self.work) for word in self.layout.server]

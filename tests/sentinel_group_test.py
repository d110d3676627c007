#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs the three Redis servers, three Sentinels and the tunnels of compose.sentinel.yaml, or those of the overlay sentinel for
Kubernetes, as processes, with the files that they mount.

usage: sentinel_group_test.py EVPOSE_SERVER compose|kubernetes

Kills the master: the Sentinels must agree on one of the replicas, which accepts writes and has the data, the killed node must follow it
when it starts again, and evpose-server must be ready again without a restart. Nodes that restart keep their roles. A master that has
lost both replicas must reject writes. Names are resolved as in the containers: each process has a mount namespace with a hosts file of its
own, so the test needs root, and is skipped without (status 77). Ports are free ones instead of 6379 and 26379.
"""
import contextlib
import dataclasses
import os
import pathlib
import re
import signal
import socket
import subprocess
import sys
import tempfile
import urllib.request

import yaml

import manifests
from checks import check, poll
from processes import free_ports

SERVER = os.path.realpath(sys.argv[1])
ROOT = pathlib.Path(__file__).resolve().parent.parent
NAMES = ("redis-1", "redis-2", "redis-3")
SENTINELS = ("sentinel-1", "sentinel-2", "sentinel-3")


def accepts(address, port):
    with socket.socket() as probe:
        return probe.connect_ex((address, port)) == 0


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
        server=services["server-1"]["command"])


def kubernetes_layout(work):
    objects = manifests.Renderer(manifests.copy(work / "manifests")).render("overlays/sentinel")
    hosts, commands, probes, files = {}, {}, {}, {}
    for kind, nodes in (("redis", NAMES), ("sentinel", SENTINELS)):
        stateful = objects["StatefulSet", f"evpose-{kind}"]
        spec = stateful["spec"]["template"]["spec"]
        container = spec["containers"][0]
        check(stateful["spec"]["replicas"] == len(nodes), kind, "has another number of nodes")
        check(container["env"] == [{"name": "POD", "valueFrom": {"fieldRef": {"fieldPath": "metadata.name"}}}], container["env"])
        # The names that a StatefulSet with a headless Service has in the DNS.
        for i, node in enumerate(nodes):
            pod = f"{stateful['metadata']['name']}-{i}"
            hosts[node] = f"{pod}.{stateful['spec']['serviceName']}.evpose.svc.cluster.local"
            commands[node] = [*container["command"], *(word.replace("$(POD)", pod) for word in container["args"])][1:]
            probes[node] = container["readinessProbe"]["exec"]["command"]
        volumes = {volume["name"]: volume for volume in spec["volumes"]}
        paths = {mount["mountPath"]: mount["name"] for mount in container["volumeMounts"]}
        files.update(objects["ConfigMap", volumes[paths["/etc/redis-group"]]["configMap"]["name"]]["data"])
    server = objects["Deployment", "evpose-server"]["spec"]["template"]["spec"]
    (tunnel,) = (container for container in server["initContainers"] if container["name"] == "store")
    config = objects["ConfigMap", server["containers"][0]["envFrom"][0]["configMapRef"]["name"]]["data"]
    return Layout(
        hosts=hosts, commands=commands, probes=probes, files=files,
        aliases={name: alias["ip"] for alias in server["hostAliases"] for name in alias["hostnames"]},
        tunnel=tunnel["args"],
        tunnel_environment={entry["name"]: entry["value"] for entry in tunnel["env"]},
        # The other options of the pod are those of kubernetes_test.py.
        server=["--listen", "0.0.0.0:0", "--insecure", "--metrics-listen", "0.0.0.0:0", "--store", config["EVPOSE_STORE"],
                "--store-password-file", "/run/secrets/redis.password"])


class Group:
    def __init__(self, work, stack, layout):
        self.work, self.stack, self.layout, self.processes = work, stack, layout, {}
        self.secrets = work / "secrets"
        subprocess.run([ROOT / "deploy/make-secrets.sh", self.secrets], check=True, capture_output=True)
        self.password = (self.secrets / "redis.password").read_text().strip()
        self.redis_port, self.sentinel_port = free_ports(2)
        self.names = {host: name for name, host in layout.hosts.items()}
        self.addresses = {name: f"127.0.2.{name[-1]}" for name in layout.hosts}
        self.write_hosts("nodes", {host: self.addresses[name] for name, host in layout.hosts.items()})
        self.write_hosts("server", layout.aliases)

    def write_hosts(self, name, addresses):
        lines = [f"{address} {host}\n" for host, address in addresses.items()]
        (self.work / f"{name}.hosts").write_text("".join(["127.0.0.1 localhost\n", *lines]))

    def changed(self, text, data):
        text = re.sub(r"\b26379\b", str(self.sentinel_port), re.sub(r"\b6379\b", str(self.redis_port), text))
        return re.sub(r"(?<![\w/])/data\b", str(data), text.replace("/run/secrets", str(self.secrets)))

    def start(self, name, hosts, command, **options):
        mount = f"mount --bind {self.work}/{hosts}.hosts /etc/hosts && exec \"$@\""
        process = subprocess.Popen(["unshare", "--mount", "setpriv", "--pdeathsig", "KILL", "sh", "-c", mount, "sh", *command], text=True, **options)
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
            process = self.start(name, "nodes", ["bash", folder / "start.sh", *words], stdout=out, stderr=out)

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

    def start_server(self):
        """Starts HAProxy and the server as server-1 and store-1; returns the address of the metrics."""
        folder = self.work / "haproxy"
        folder.mkdir()
        words = []
        for word in self.layout.tunnel:
            if word.endswith(".cfg"):
                text = (ROOT / "deploy/haproxy" / pathlib.Path(word).name).read_text()
                # The hosts file of the nodes is the DNS of this test.
                word = folder / pathlib.Path(word).name
                word.write_text(self.changed(text, folder).replace("init-addr none", "init-addr libc"))
            words.append(word)
        environment = {**os.environ, **self.layout.tunnel_environment, "PATH": os.environ["PATH"] + ":/usr/sbin"}
        with open(self.work / "haproxy.log", "w", encoding="utf-8") as out:
            self.start("haproxy", "nodes", words, env=environment, stdout=out, stderr=out)

        def listens():
            check(self.processes["haproxy"].poll() is None, "haproxy:", (self.work / "haproxy.log").read_text())
            return accepts("127.0.1.1", self.redis_port)

        poll(listens, "HAProxy listens")
        command = [re.sub(r"^0\.0\.0\.0:\d+$", "127.0.0.1:0", self.changed(word, folder)) for word in self.layout.server]
        with open(self.work / "server.log", "w", encoding="utf-8") as out:
            process = self.start("server", "server", [SERVER, *command], stdout=subprocess.PIPE, stderr=out)
        lines = [process.stdout.readline() for _ in range(2)]
        check(lines[1].startswith("metrics on "), "the server does not start:", (self.work / "server.log").read_text())
        return re.search(r"127\.0\.0\.1:\d+", lines[1])[0]


def is_ready(address):
    try:
        with urllib.request.urlopen(f"http://{address}/readyz", timeout=5) as page:
            return page.status == 200
    except OSError:  # not ready, or not reachable
        return False


def await_master(group, num_replicas):
    """Waits for a master with this number of replicas, and returns its name. On a busy machine it need not be the first one."""
    def find():
        master = group.agreed_master()
        return master if master and group.replicas(master) == num_replicas and group.know_all() else None

    return poll(find, f"a master with {num_replicas} replicas")


def check_failover(group, address):
    poll(lambda: is_ready(address), "the server is ready")
    first = await_master(group, 2)
    poll(lambda: group.cli(first, "set", "evpose-test", "kept") == "OK", "the first master accepts a write")
    poll(lambda: group.cli(first, "wait", "2", "1000") == "2", "both replicas have the write")
    poll(lambda: all(group.is_ready(name) for name in (*NAMES, *SENTINELS)), "all nodes and Sentinels are healthy")
    other = next(name for name in NAMES if name != first)
    check("READONLY" in group.cli(other, "set", "evpose-test", "wrong"), "a replica accepts a write")
    group.kill(first)
    check(not group.is_ready(first), "a node that was killed is healthy")
    master = await_master(group, 1)
    check(group.cli(master, "get", "evpose-test") == "kept", "the new master lacks a write that both replicas had")
    poll(lambda: group.cli(master, "set", "evpose-test", "new") == "OK", "the new master accepts a write")
    poll(lambda: is_ready(address), "the server is ready again")
    check(group.processes["server"].poll() is None, "the server has ended")
    group.start_node(first)
    poll(lambda: group.replicas(master) == 2, "the node that was killed follows the new master")
    poll(lambda: group.cli(first, "get", "evpose-test") == "new", "the node that was killed has the new value")
    roles = group.roles()
    check(sorted(roles.values()) == ["master", "slave", "slave"] and roles[master] == "master", "after the return the roles are", roles)
    return master


def check_restart(group, master):
    """A node that restarts keeps the role that the Sentinels gave it, also without them."""
    group.kill(*NAMES, *SENTINELS)
    for name in NAMES:
        group.start_node(name)
    roles = group.roles()
    check(sorted(roles.values()) == ["master", "slave", "slave"] and roles[master] == "master", "after a restart of all the roles are", roles)
    check(group.cli(master, "get", "evpose-test") == "new", "a restart of all loses writes")


def check_loss_of_two(group, master):
    """A master without replicas rejects writes, and accepts them when one has returned."""
    others = [name for name in NAMES if name != master]
    group.kill(*others)
    poll(lambda: "NOREPLICAS" in group.cli(master, "set", "evpose-test", "lost"), "a master without replicas rejects writes")
    # The health check of compose only tells whether a node responds.
    check(group.is_ready(master) == (sys.argv[2] == "compose"), "the health of a master without replicas is", group.is_ready(master))
    group.start_node(others[0])
    poll(lambda: group.cli(master, "set", "evpose-test", "back") == "OK", "the master accepts writes again")
    poll(lambda: group.cli(others[0], "get", "evpose-test") == "back", "the replica has the value")


def main():
    if os.geteuid() != 0 or subprocess.run(["unshare", "--mount", "true"], capture_output=True).returncode != 0:
        print("sentinel_group_test: SKIPPED: needs root, for mount namespaces")
        sys.exit(77)
    with tempfile.TemporaryDirectory() as work, contextlib.ExitStack() as stack:
        work = pathlib.Path(work)
        group = Group(work, stack, compose_layout() if sys.argv[2] == "compose" else kubernetes_layout(work))
        for name in (*NAMES, *SENTINELS):
            group.start_node(name)
        await_master(group, 2)
        with socket.create_connection((group.addresses["redis-1"], group.redis_port)) as plain, contextlib.suppress(ConnectionResetError):
            plain.sendall(b"PING\r\n")
            check(not plain.recv(100).startswith((b"+", b"-")), "Redis responds without encryption")
        address = group.start_server()
        master = check_failover(group, address)
        check_restart(group, master)
        check_loss_of_two(group, master)
        print("a killed master was replaced by", master, "and follows it; roles and writes outlast a restart of all three")


main()

# SPDX-License-Identifier: Apache-2.0
"""The parts of a cluster in network namespaces of their own, behind a router that can drop the packets between any two of them without
telling either. The program that uses them is started by isolated(), so that nothing remains of it and several do not meet."""
import contextlib
import dataclasses
import os
import pathlib
import shutil
import subprocess
import sys

from checks import check, poll
from processes import get_page, metric_sums
from redis_group import NAMES, SENTINELS, Group, compose_layout

ROUTER = "10.58.0.254"
POSTGRES = "/usr/lib/postgresql/15/bin/"
# Its own processes end with it, its names of networks and of files below /run are its own, and its network becomes the router.
ISOLATION = ("unshare", "--mount", "--net", "--pid", "--fork", "--kill-child", "--mount-proc", "sh", "-c",
             "mount -t tmpfs tmpfs /run && mkdir /run/netns && exec \"$@\"", "sh")


def isolated(command):
    return [*ISOLATION, *command]


def obstacle():
    """The reason for which this user or kernel cannot make networks; empty if there is none."""
    if os.geteuid() != 0:
        return "needs root, for network namespaces"
    for program, package in (("ip", "iproute2"), ("haproxy", "haproxy"), ("redis-server", "redis-server"), (POSTGRES + "initdb", "postgresql")):
        if shutil.which(program, path=os.environ["PATH"] + ":/usr/sbin") is None:
            return f"{program} is missing: deploy/install-dependencies.sh --test installs {package}"
    trial = "Network(['a', 'b']).cut([('a', 'b')]).__enter__()"
    script = f"import sys; sys.path.insert(0, {str(pathlib.Path(__file__).parent)!r}); from network_parts import Network; {trial}"
    probe = subprocess.run(isolated([sys.executable, "-c", script]), capture_output=True, text=True)
    return "" if probe.returncode == 0 else "no networks can be made here: " + (probe.stderr.strip().splitlines() or ["?"])[-1]


def ip(lines):
    """Runs commands of ip(8)."""
    subprocess.run(["ip", "-batch", "-"], input="".join(line + "\n" for line in lines), text=True, check=True)


class Network:
    """One network namespace for each name, with one address, behind this process as the router."""

    def __init__(self, names):
        self.addresses = {name: f"10.58.0.{i}" for i, name in enumerate(names, 1)}
        pathlib.Path("/proc/sys/net/ipv4/ip_forward").write_text("1")
        ip(["link set lo up", f"address add {ROUTER}/32 dev lo"])
        for i, (name, address) in enumerate(self.addresses.items(), 1):
            subprocess.run(["ip", "netns", "add", name], check=True)
            ip([f"link add part{i} type veth peer name eth0 netns {name}", f"link set part{i} up", f"route add {address} dev part{i}"])
            inside = ["link set lo up", f"address add {address}/32 dev eth0", "link set eth0 up", f"route add {ROUTER} dev eth0",
                      f"route add default via {ROUTER}"]
            subprocess.run([*self.enter(name), "ip", "-batch", "-"], input="\n".join(inside) + "\n", text=True, check=True)

    def enter(self, name):
        """The beginning of a command that runs in the network of a part."""
        return ("nsenter", f"--net=/run/netns/{name}")

    @contextlib.contextmanager
    def cut(self, pairs):
        """Drops the packets between the parts of each pair, in both directions, and sends no ICMP message about it."""
        rules = [f"from {self.addresses[one]} to {self.addresses[other]} blackhole" for a, b in pairs for one, other in ((a, b), (b, a))]
        ip([f"rule add {rule}" for rule in rules])
        try:
            yield
        finally:
            ip([f"rule del {rule}" for rule in rules])

    def retransmissions(self, names):
        """How many segments of TCP these parts have sent again so far."""
        total = 0
        for name in names:
            text = subprocess.run([*self.enter(name), "cat", "/proc/self/net/snmp"], capture_output=True, text=True, check=True).stdout
            head, values = (line.split() for line in text.splitlines() if line.startswith("Tcp:"))
            total += int(values[head.index("RetransSegs")])
        return total


class Cluster:
    """A client's network, HAProxy and two servers with the commands of compose.sentinel.yaml. Derived classes add the store."""

    SERVERS = ("server-1", "server-2")

    def __init__(self, work, stack, program, layout, stores):
        self.network = Network(("client", "proxy", *self.SERVERS, *stores))
        self.program = program
        self.group = Group(work, stack, layout, self.network.addresses, enter=self.network.enter)
        self.group.write_hosts("proxy", {name: self.network.addresses[name] for name in self.SERVERS})

    @property
    def address(self):
        return self.network.addresses["proxy"] + ":50051"

    def start_servers(self, options):
        self.options = options
        for name in self.SERVERS:
            self.group.start_server(self.program, name, options)
        changes = [("  server server-3 server-3:50051 check-proto h1\n", "")]
        self.group.start_haproxy("proxy", "proxy", "proxy", self.group.layout.proxy, changes)
        self.group.await_listener("proxy", "client", *self.address.split(":"))

    def in_rotation(self):
        text = get_page(self.network.addresses["proxy"] + ":8404", "/metrics")[1]
        return all(metric_sums(text, ("haproxy_server_status", 'proxy="servers"', f'server="{name}"', 'state="UP"')) == [1.0]
                   for name in self.SERVERS)

    def await_whole(self):
        """Waits until all parts work as at the start."""
        poll(self.in_rotation, "HAProxy sends streams to both servers")

    def poses_by_server(self):
        pages = {name: get_page(self.network.addresses[name] + ":9464", "/metrics")[1] for name in self.SERVERS}
        return {name: metric_sums(text, ("evpose_poses_total",))[0] for name, text in pages.items()}


class RedisCluster(Cluster):
    def __init__(self, work, stack, program):
        super().__init__(work, stack, program, compose_layout(), (*NAMES, *SENTINELS))
        for name in (*NAMES, *SENTINELS):
            self.group.start_node(name)
        self.group.await_master(2)
        for name in self.SERVERS:
            self.group.start_tunnel(name)
        self.start_servers(self.group.server_options())

    def await_whole(self):
        self.group.await_master(2)
        super().await_whole()

    def master(self):
        return self.group.await_master(2)

    def kill(self, names):
        """Kills servers, each with its tunnel, Redis servers and Sentinels."""
        self.group.kill(*names, *(f"tunnel-{name}" for name in names if name in self.SERVERS))

    def start(self, names):
        """Starts parts that were killed, with their data."""
        for name in names:
            if name in self.SERVERS:
                self.group.start_tunnel(name)
                self.group.start_server(self.program, name, self.options, is_restarted=True)
            else:
                self.group.start_node(name)

    def close_store_connections(self):
        """Ends the connections of the servers to the master, so that they ask the Sentinels."""
        self.group.cli(self.group.agreed_master(), "client", "kill", "type", "normal")


class PostgresCluster(Cluster):
    """A primary that waits for its only standby, with the settings of deploy/README.md."""

    NODES = ("db-1", "db-2")
    SETTINGS = ("tcp_keepalives_idle=10", "tcp_keepalives_interval=5", "tcp_keepalives_count=3")
    USER = ("setpriv", "--reuid", "nobody", "--regid", "nogroup", "--clear-groups")  # PostgreSQL rejects root

    def __init__(self, work, stack, program):
        super().__init__(work, stack, program, dataclasses.replace(compose_layout(), hosts={}), self.NODES)
        self.work = work
        self.initialize()
        self.start_node("db-1")
        hosts = ",".join(self.network.addresses[name] for name in self.NODES)
        self.as_user("db-2", "pg_basebackup", "-D", work / "db-2/data", "-R", "-X", "stream", "-c", "fast", "-d",
                     f"host={self.network.addresses['db-1']} user=evpose application_name=db_2")
        self.start_node("db-2")
        self.sql("ALTER SYSTEM SET synchronous_standby_names = 'ANY 1 (db_2)'")
        self.sql("SELECT pg_reload_conf()")
        poll(self.follows, "the standby follows the primary")
        options = self.group.server_options()
        options[options.index("--store") + 1] = f"postgresql://evpose@{hosts}/postgres"
        password = options.index("--store-password-file")
        self.start_servers(options[:password] + options[password + 2:])

    def as_user(self, name, program, *words):
        run = subprocess.run([*self.network.enter(name), *self.USER, POSTGRES + program, *words], cwd="/", capture_output=True, text=True)
        check(run.returncode == 0, program, "fails:", run.stderr)

    def initialize(self):
        for name in self.NODES:
            (self.work / name).mkdir()
            shutil.chown(self.work / name, "nobody", "nogroup")
        data = self.work / "db-1/data"
        self.as_user("db-1", "initdb", "-D", data, "-U", "evpose", "-A", "trust", "-E", "UTF8", "--locale=C")
        with open(data / "pg_hba.conf", "a", encoding="ascii") as rules:
            rules.write("host all evpose 10.58.0.0/24 trust\nhost replication evpose 10.58.0.0/24 trust\n")

    def start_node(self, name):
        folder, log = self.work / name, self.work / f"{name}.log"
        settings = [word for setting in self.SETTINGS for word in ("-c", setting)]
        with open(log, "w", encoding="utf-8") as out:
            process = self.group.start(name, name, "nodes", [
                *self.USER, POSTGRES + "postgres", "-D", folder / "data", "-c", "listen_addresses=" + self.network.addresses[name], "-c",
                f"unix_socket_directories={folder}", *settings], cwd="/", stdout=out, stderr=out)

        def listens():
            check(process.poll() is None, name, "does not start:", log.read_text())
            return "ready to accept" in log.read_text()

        poll(listens, f"{name} listens")

    def sql(self, statement):
        return subprocess.run(["psql", "-h", self.network.addresses["db-1"], "-U", "evpose", "-d", "postgres", "-Atc", statement],
                              capture_output=True, text=True, check=True).stdout.strip()

    def master(self):
        return "db-1"

    def follows(self):
        return self.sql("SELECT count(*) FROM pg_stat_replication WHERE state = 'streaming' AND sync_state = 'quorum'") == "1"

    def await_whole(self):
        poll(self.follows, "the standby follows the primary")
        super().await_whole()


#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs HAProxy with the files of deploy/haproxy in front of evpose-server, and between it and a Redis with TLS.

usage: proxy_test.py EVPOSE_SERVER EVPOSE

Every HAProxy of the compose files and of Kubernetes accepts its files. A server reaches Redis through HAProxy, and only if Redis has the
right certificate. Tokens and client certificates work through HAProxy. New sessions go to the server with the lowest load. A flood of
resets is cut or absorbed, while the calls of another client succeed, and a header without end is cut. Of a flood of pings the server sees
nothing, and the calls of another client are not delayed. HAProxy inherits its sockets, so
there are no fixed ports; its files are used with other paths and addresses.
"""
import contextlib
import json
import os
import pathlib
import re
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time

import yaml

from checks import check, poll
from processes import HAPROXY, ROOT, cluster_changes, free_ports, get_page, haproxy_files, metric_sums

SERVER, CLIENT = (os.path.realpath(path) for path in sys.argv[1:3])
STREAMS = 100_000
CONTINUATIONS = 10_000  # 160 MB
PINGS = 500_000
MAX_DELAY = 20  # of a call beside a flood of pings, relative to one without it


def services(name):
    return yaml.safe_load((ROOT / "deploy" / name).read_text())["services"]


def pod_command():
    deployment = yaml.safe_load((ROOT / "deploy/kubernetes/base/deployment.yaml").read_text())
    return deployment["spec"]["template"]["spec"]["initContainers"][0]["args"]


def store_command():
    patches = yaml.safe_load((ROOT / "deploy/kubernetes/overlays/cluster/store.yaml").read_text())
    return next(patch["value"]["args"] for patch in patches if patch["path"].endswith("/initContainers/-"))


class Fixture:
    def __init__(self, work, stack):
        self.work = work
        self.stack = stack
        self.secrets = work / "secrets"
        self.count = 0
        run = {"check": True, "capture_output": True, "cwd": work}
        subprocess.run([ROOT / "deploy/make-secrets.sh", self.secrets], **run)
        for name in ("server", "clients"):
            subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2",
                            "-subj", "/CN=lab", "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", self.secrets / f"{name}.key",
                            "-out", self.secrets / f"{name}.crt"], **run)
        shutil.copy(self.secrets / "server.key", self.secrets / "server.crt.key")
        made = subprocess.run([SERVER, "--new-token", "lab", "--token-file", self.secrets / "tokens"], **run)
        (work / "lab.token").touch(mode=0o600)
        (work / "lab.token").write_bytes(made.stdout)

    def files(self, command, changes):
        """Copies the files that a command of HAProxy names, with other paths and addresses; returns its options."""
        self.count += 1
        folder = self.work / f"haproxy-{self.count}"
        folder.mkdir()
        return haproxy_files(command, folder, [*changes, ("/run/secrets", str(self.secrets))])

    def listener(self, path=None):
        listener = socket.socket(socket.AF_UNIX if path else socket.AF_INET)
        listener.bind(path or ("127.0.0.1", 0))
        listener.listen(1024)
        return self.stack.enter_context(listener)

    def start(self, command, **options):
        process = subprocess.Popen(command, **options)

        def end():
            process.kill()
            process.communicate()

        self.stack.callback(end)
        return process

    def haproxy(self, command, changes, listeners, more="", **environment):
        options = self.files(command, changes)
        if more:
            path = self.work / f"more-{self.count}.cfg"
            path.write_text(more)
            options += ["-f", str(path)]
        self.start([HAPROXY, "-db", *options], pass_fds=[listener.fileno() for listener in listeners],
                   env={**os.environ, **environment}, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def server(self, *options, log=subprocess.DEVNULL):
        """Starts a server; returns its address, that of its metrics and that of its load, or its process if it does not start."""
        addresses = [word for name in ("", "metrics-", "load-") for word in (f"--{name}listen", "127.0.0.1:0")]
        process = self.start([SERVER, *addresses, *options], stdout=subprocess.PIPE, stderr=log, text=True)
        lines = [process.stdout.readline() for _ in range(3)]
        if not lines[0].startswith("listening on "):
            return process
        return tuple(re.search(r"127\.0\.0\.1:\d+", line)[0] for line in lines)

    def call(self, listener, *options):
        return subprocess.run([CLIENT, "sessions", "list", "--server", f"127.0.0.1:{listener.getsockname()[1]}", "--tls-ca",
                               self.secrets / "server.crt", *options], capture_output=True, text=True)


def check_files(fixture):
    cluster = services("compose.cluster.yaml")["haproxy"]["command"]
    commands = {"pod": pod_command(), "store of a pod": store_command(), "passthrough": cluster + ["passthrough.cfg"]}
    for name in ("compose.yaml", "compose.tls.yaml", "compose.cluster.yaml", "compose.cluster.tls.yaml", "compose.sentinel.yaml",
                 "compose.sentinel.tls.yaml"):
        for service, document in services(name).items():
            if document.get("command", [""])[0] == "haproxy":
                commands[f"{service} of {name}"] = document["command"]
    for who, command in commands.items():
        check("common.cfg" in " ".join(command), who, "has no limits")
        environment = {**os.environ, "STORE_BIND": "127.0.0.1:6379", "STORE_REDIS": "evpose-redis:6379"}
        run = subprocess.run([HAPROXY, "-c", *fixture.files(command, [])], env=environment, capture_output=True, text=True)
        check(run.returncode == 0 and "WARNING" not in run.stderr, "haproxy rejects the files of", who, run.stderr)


def start_redis(fixture):
    """Starts Redis as in compose.cluster.yaml, on a free port; returns the port."""
    data = fixture.work / "redis"
    data.mkdir()
    for _ in range(5):
        port = free_ports(1)[0]
        changes = {"/data": str(data), "6379": str(port)}
        words = [changes.get(word, word).replace("/run/secrets", str(fixture.secrets))
                 for word in services("compose.cluster.yaml")["redis"]["command"]]
        process = fixture.start(words + ["--bind", "127.0.0.1"], stdout=subprocess.PIPE, text=True)
        # Without it, another program has taken the port.
        if any("eady to accept connections" in line for line in process.stdout):
            return port
    sys.exit("proxy_test: redis-server does not start")


def check_store(fixture, port):
    """Returns the options of a server for the store, after it was refused to one that expects another certificate."""
    with socket.create_connection(("127.0.0.1", port)) as plain, contextlib.suppress(ConnectionResetError):
        plain.sendall(b"PING\r\n")
        check(not plain.recv(100).startswith((b"+", b"-")), "Redis answers without encryption")
    stores = {}
    command = services("compose.cluster.yaml")["store"]["command"]
    for name, certificate in (("right", "redis.crt"), ("wrong", "clients.crt")):
        path = str(fixture.work / name)
        listener = fixture.listener(path)
        fixture.haproxy(command, [("redis.crt", certificate), ("init-addr none", "init-addr last")], [listener],
                        STORE_BIND=f"fd@{listener.fileno()}", STORE_REDIS=f"127.0.0.1:{port}")
        stores[name] = ["--store", f"redis+unix://{path}", "--store-password-file", str(fixture.secrets / "redis.password")]
    refused = fixture.server(*stores["wrong"])
    check(not isinstance(refused, tuple), "a server uses a Redis with another certificate")
    check(refused.wait() == 1, "without Redis the server ended with", refused.returncode)
    return stores["right"]


def check_flood(fixture, front, counts, token):
    """Floods from another address than that of the calls."""
    address = f"127.0.0.1:{front.getsockname()[1]}"
    flood = [sys.executable, ROOT / "tests/http2_flood.py", address, "2", str(STREAMS), "--tls", "--source"]
    for source, apart in (("127.0.0.2", ["--apart"]), ("127.0.0.3", [])):
        process = fixture.start([*flood, source, *apart], stdout=subprocess.PIPE, text=True)
        calls = 0
        # Far fewer than what the proxy allows the address of these calls.
        while calls < 5 or (process.poll() is None and calls < 100):
            call = fixture.call(front, *token)
            check(call.returncode == 0, "a call during the flood fails:", call.stderr)
            calls += 1
        first, second = process.stdout.read().split()
        check(process.wait() == 0, "http2_flood.py ended with", process.returncode)
        check(first == "all" or (first.isdigit() and int(first) > 0), "no stream of the flood was sent:", first)
        if apart:
            check(first != "all", "the flood is not cut")
        check(second.isdigit() and int(second) < STREAMS / 2, "the next connection of the flood is accepted:", second)
        reached = int(metric(counts.getsockname()[1], "haproxy_server_sessions_total", 'proxy="servers"', 'server="server"'))
        check(0 < reached < STREAMS / 5, reached, "calls of the flood have reached the server")
        print(f"flood from {source}: sent {first} and {second}, reached the server with all others: {reached}; {calls} calls of another client")


def check_header(front):
    flood = [sys.executable, ROOT / "tests/http2_flood.py", f"127.0.0.1:{front.getsockname()[1]}", "1", str(CONTINUATIONS), "--tls", "--source",
             "127.0.0.4", "--header"]
    sent = subprocess.run(flood, stdout=subprocess.PIPE, text=True, check=True).stdout.strip()
    check(sent != "all", "a header without end is not cut")
    check(sent.isdigit() and int(sent) > 0, "no header was sent:", sent)
    print(f"a header without end: cut after {sent} of {CONTINUATIONS} continuations of 16 kB")


def check_pings(fixture, front, token):
    """gRPC would answer pings in the threads that read from all connections, and cut these connections."""
    def call_s():
        start = time.monotonic()
        call = fixture.call(front, *token)
        check(call.returncode == 0, "a call beside a flood of pings fails:", call.stderr)
        return time.monotonic() - start

    alone_s = statistics.median(call_s() for _ in range(9))
    address = f"127.0.0.1:{front.getsockname()[1]}"
    flood = [sys.executable, ROOT / "tests/http2_flood.py", address, "1", str(PINGS), "--tls", "--pings", "--source"]
    floods = [fixture.start([*flood, source], stdout=subprocess.PIPE, text=True) for source in ("127.0.0.5", "127.0.0.6")]
    beside_s = []
    while len(beside_s) < 5 or any(process.poll() is None for process in floods):
        beside_s.append(call_s())
    sent = [process.stdout.read().strip() for process in floods]
    check(sent == ["all", "all"], "a flood of pings has reached a server, which cuts it:", sent)
    ratio = statistics.median(beside_s) / alone_s
    print(f"{PINGS} pings on each of two connections: {len(beside_s)} calls of another client take {ratio:.1f} times as long (median)")
    check(ratio < MAX_DELAY, "a flood of pings delays the calls of another client", ratio, "times")


def check_passthrough(fixture, certificate):
    secrets = fixture.secrets
    server = fixture.server("--store", "memory", "--tls-cert", str(secrets / "server.crt"), "--tls-key", str(secrets / "server.key"),
                            "--tls-client-ca", str(secrets / "clients.crt"))
    front = fixture.listener()
    changes = [(":50443", f"fd@{front.fileno()}"), ("init-addr none", "init-addr last"), ("server-1:50051", server[0]),
               ("check port 9464", "check port " + server[1].rpartition(":")[2]),
               ("agent-port 9465", "agent-port " + server[2].rpartition(":")[2]), ("  server server-2 server-2:50051\n", ""),
               ("  server server-3 server-3:50051\n", "")]
    fixture.haproxy(["common.cfg", "passthrough.cfg"], changes, [front])
    check(fixture.call(front, *certificate).returncode == 0, "a certificate does not pass through")
    check(fixture.call(front).returncode != 0, "the server accepts a client without a certificate")


def metric(port, name, *labels):
    """The value of a metric of HAProxy; 0 while there is none."""
    return metric_sums(get_page(f"127.0.0.1:{port}", "/metrics")[1], (name, *labels))[0]


def load(fixture, address, *options):
    command = [CLIENT, "bench", "load", "--server", address, "--chunk-ms", "20", "--rate", "1000", "--json", *options]
    return fixture.start(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def check_balance(fixture, store):
    """Two servers behind the HAProxy of the cluster, one of which has 18 of its 20 sessions."""
    logs = [open(fixture.work / f"server-{i}.log", "w+") for i in (1, 2)]
    servers = [fixture.server(*store, "--max-sessions", limit, log=log) for limit, log in zip(("20", "400"), logs)]
    front, counts = fixture.listener(), fixture.listener()
    fixture.haproxy(["common.cfg", "cluster.cfg"], cluster_changes(front, counts, servers), [front, counts])
    load(fixture, servers[0][0], "--sessions", "18", "--minutes", "1000")
    port = counts.getsockname()[1]
    poll(lambda: [metric(port, "haproxy_server_weight", 'proxy="servers"', f'server="server-{i}"') for i in (1, 2)] == [10.0, 100.0],
         "weights 10 and 100 of the servers")
    before = pathlib.Path(logs[0].name).read_text().count("session_created ")
    check(before == 18, "the loaded server has", before, "sessions")
    run = load(fixture, f"127.0.0.1:{front.getsockname()[1]}", "--sessions", "40", "--minutes", "0.001")
    result = json.loads(run.stdout.read())
    created = [pathlib.Path(log.name).read_text().count("session_created ") for log in logs]
    # The loaded server has two places left, and refuses others.
    at_loaded = created[0] - before + result["refused"].get("TOO_MANY_SESSIONS", 0)
    print(f"of 40 new sessions, {at_loaded} came to the server at 90 % and {created[1]} to the other; weights 10 and 100")
    # By the weights, the loaded server is one of the two that are drawn for 17 % of the streams.
    check(at_loaded <= 16 and created[1] >= 24, "new sessions go to the loaded server:", at_loaded, created)


def main():
    check(HAPROXY, "there is no haproxy: deploy/install-dependencies.sh --test")
    with tempfile.TemporaryDirectory() as work, contextlib.ExitStack() as stack:
        fixture = Fixture(pathlib.Path(work), stack)
        check_files(fixture)
        store = check_store(fixture, start_redis(fixture))
        check_balance(fixture, store)
        server = fixture.server(*store, "--token-file", str(fixture.secrets / "tokens"))
        check(isinstance(server, tuple), "the server does not reach Redis through HAProxy")

        token = ["--token-file", fixture.work / "lab.token"]
        certificate = ["--tls-cert", fixture.secrets / "clients.crt", "--tls-key", fixture.secrets / "clients.key"]
        front, strict, counts = fixture.listener(), fixture.listener(), fixture.listener()
        for listener, more in ((front, ""), (strict, " verify required ca-file /run/secrets/clients.crt")):
            changes = [("127.0.0.1:50052", server[0]), (":50443", f"fd@{listener.fileno()}"), (" alpn h2 ", f" alpn h2{more} ")]
            exporter = f"frontend counts from base\n  bind fd@{counts.fileno()}\n  http-request use-service prometheus-exporter\n"
            is_front = listener is front
            fixture.haproxy(pod_command(), changes, [listener, counts] if is_front else [listener], exporter if is_front else "")
        check(fixture.call(front, *token).returncode == 0, "a token does not pass through:", fixture.call(front, *token).stderr)
        check(fixture.call(front).returncode != 0, "a call without a token is accepted")
        check(fixture.call(strict, *token, *certificate).returncode == 0, "a certificate is refused")
        check(fixture.call(strict, *token).returncode != 0, "a call without a certificate is accepted")
        check_passthrough(fixture, certificate)
        check_header(front)
        check_pings(fixture, front, token)
        check_flood(fixture, front, counts, token)


main()

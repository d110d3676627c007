#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Replaces the servers of a cluster, one after another, by the next version and then by this one again, under streams.

usage: rolling_upgrade_test.py EVPOSE_SERVER EVPOSE_SERVER_NEXT EVPOSE

The same as tests/container/upgrade.sh with processes instead of containers: Redis, three servers, and HAProxy with the files of
compose.cluster.yaml. Each server is ended by SIGTERM, started in the other version at the same addresses, and waited for until HAProxy sends
streams to it. While a server is replaced, each client receives a part of its recording. No pose may be lost. A trajectory must be that of
a replay without a server, to the byte, up to the pose at which the client is told that its session is searched for again, which happens
at most once for each change of the version; afterwards it must reach the end of the recording. Needs redis-server and haproxy.
"""
import argparse
import contextlib
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import threading

from checks import check, poll
from event_blocks import BlockPipe
from processes import ClusterProxy, Redis, Server, get_page, metric_sums, run_evpose, simulate

SERVERS = 3
CLIENTS = 4
DURATION_US = 2_000_000
RECORDING = ("--object", "cube", "--duration", str(DURATION_US / 1e6), "--seed", "1")
RESTARTED = re.compile(r"^tracking: restarted after chunk \d+(?: and pose (\d+))?, .*, this server reads version ", re.M)


class Cluster:
    """Three servers of one version; replace() changes the version of one."""

    def __init__(self, stack, work, program):
        redis = stack.enter_context(Redis(work))
        self.servers = []
        for i in range(1, SERVERS + 1):
            folder = work / f"server-{i}"
            folder.mkdir()
            options = ("--load-listen", "127.0.0.1:0", "--shutdown-notice", "2", "--log-format", "json", "--store", redis.url)
            server = stack.enter_context(Server(program, *options, directory=folder, store=None))
            # It has the same addresses after a restart.
            for option, address in (("--listen", server.address), ("--metrics-listen", server.metrics_address),
                                    ("--load-listen", server.load_address)):
                server.command[server.command.index(option) + 1] = address
            self.servers.append(server)
        self.proxy = stack.enter_context(ClusterProxy(work, self.servers))
        for number in range(1, SERVERS + 1):
            self.await_rotation(number)

    def is_in_rotation(self, number):
        text = get_page(self.proxy.metrics_address, "/metrics")[1]
        return metric_sums(text, ("haproxy_server_status", 'proxy="servers"', f'server="server-{number}"', 'state="UP"')) == [1.0]

    def await_rotation(self, number):
        poll(lambda: self.is_in_rotation(number), f"HAProxy sends streams to server-{number}")

    def replace(self, number, program):
        server = self.servers[number - 1]
        status = server.terminate()
        check(status == 0, f"server-{number} ended with status {status} at SIGTERM:", server.log()[-2000:])
        poll(lambda: not self.is_in_rotation(number), f"HAProxy notices the end of server-{number}")
        server.command[0] = str(program)
        server.start()
        self.await_rotation(number)

    def total(self, metric, *labels):
        return sum(server.metric(metric, *labels) for server in self.servers)

    def logs(self):
        return "".join(server.log() for server in self.servers)


class Client:
    """`evpose stream`, which receives the parts of a recording when the test sends them."""

    def __init__(self, evpose, scene, address, folder):
        folder.mkdir()
        self.folder = folder
        command = [evpose, "stream", "-", "--model", scene / "model.obj", "--camera", scene / "camera.yaml", "--server", address, "--out",
                   folder / "poses.tum"]
        with open(folder / "log", "wb") as log:
            self.pipe = BlockPipe(scene / "recording.raw", lambda end: subprocess.Popen(command, stdin=end, stdout=log, stderr=log))
        self.process = self.pipe.reader

    def log(self):
        return (self.folder / "log").read_text()

    def finish(self):
        self.pipe.send_rest()
        poll(lambda: self.process.poll() is not None, f"the end of {self.folder.name}")
        check(self.process.returncode == 0, self.folder.name, "failed:", self.log())

    def kill(self):
        self.pipe.close()
        self.process.kill()
        self.process.wait()


def check_trajectory(client, reference):
    """Returns how often the session was searched for again."""
    log = client.log()
    check("\nconnection: " not in log or "; nothing was lost\n" in log, client.folder.name, "has lost poses:", log)
    restarts = RESTARTED.findall(log)
    check(len(restarts) <= 1, "the session of", client.folder.name, "was searched for", len(restarts), "times:", log)
    poses = (client.folder / "poses.tum").read_text().splitlines()
    num_same = int(restarts[0] or 0) if restarts else len(reference)
    check(poses[:num_same] == reference[:num_same], f"the first {num_same} poses of {client.folder.name} differ from the reference")
    last, end = (float(lines[-1].split()[0]) for lines in (poses, reference))
    check(abs(last - end) < 1e-3, f"the poses of {client.folder.name} end at {last} s instead of {end} s")
    return len(restarts)


def change_version(arguments, cluster, program, name, work, reference):
    """Replaces all servers under streams. Returns the number of sessions that were searched for again."""
    with contextlib.ExitStack() as stack:
        clients = []
        for i in range(CLIENTS):
            clients.append(Client(arguments.evpose, arguments.scene, cluster.proxy.address, work / f"{name}-{i}"))
            stack.callback(clients[-1].kill)
        begin_us = clients[0].pipe.next_end_us
        ends_us = [begin_us + DURATION_US * i // (SERVERS + 2) for i in range(1, SERVERS + 2)]
        for client in clients:
            client.pipe.send_until(ends_us[0])
        poll(lambda: cluster.total("evpose_objects", 'state="tracking"') == CLIENTS, "all objects are tracked")
        for number in range(1, SERVERS + 1):
            # Events are under way in each of the streams when the server ends.
            sending = [threading.Thread(target=client.pipe.send_until, args=(ends_us[number],)) for client in clients]
            for thread in sending:
                thread.start()
            cluster.replace(number, program)
            for thread in sending:
                thread.join()
            poll(lambda: cluster.total("evpose_sessions", 'state="attached"') == CLIENTS, "all streams are attached again")
        for client in clients:
            client.finish()
        return sum(check_trajectory(client, reference) for client in clients)


def main():
    arguments = argparse.Namespace(**dict(zip(("server", "next", "evpose"), map(os.path.realpath, sys.argv[1:]))))
    with tempfile.TemporaryDirectory() as work, contextlib.ExitStack() as stack:
        work = pathlib.Path(work)
        arguments.scene = work / "scene"
        simulate(arguments.evpose, arguments.scene, *RECORDING)
        run_evpose(arguments.evpose, "replay", arguments.scene / "recording.raw", "--model", arguments.scene / "model.obj", "--camera",
                   arguments.scene / "camera.yaml", "--out", arguments.scene / "poses.tum")
        reference = (arguments.scene / "poses.tum").read_text().splitlines()
        cluster = Cluster(stack, work, arguments.server)
        for name, program in (("next", arguments.next), ("this", arguments.server)):
            num_searched = change_version(arguments, cluster, program, name, work, reference)
            check(num_searched > 0, "no session was searched for again: the servers have the same version")
            print(f"to {name} version: {CLIENTS} trajectories, {num_searched} sessions were searched for again")
        logs = cluster.logs()
        check("tracker_state_unreadable" in logs, "no server has logged that it cannot read the state of a tracker")
        check(not re.search("session_not_resumed|SESSION_DAMAGED", logs), "a version cannot read what the other one has stored")


main()

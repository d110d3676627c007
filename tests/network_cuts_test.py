#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Cuts the network between two parts of a cluster, or around a zone, while `evpose replay` streams, and compares the poses with those of an
undisturbed run.

usage: network_cuts_test.py EVPOSE_SERVER EVPOSE [--cuts N] [--kinds KIND ...] [--seed N] [--jobs N] [--work DIR]

The clusters are HAProxy, two servers, and three Redis servers with three Sentinels with the files of compose.sentinel.yaml, or a PostgreSQL
primary that waits for its standby. Each part has a network namespace of its own. A cut drops all packets between two parts, or between
all parts of two kinds, and tells neither; it begins after a random pose and lasts 2 to 10 s. The kind "zone" cuts the server with the
stream, a Redis server and a Sentinel from all other parts; "killed-zone" also kills these three, and starts them again at the end of the
cut. The client must end with status 0, its poses must be those of the undisturbed run to the byte, and its report must name no loss. For
each kind, the test prints the number of cuts and of identical trajectories, the longest time between two poses, how often clients had to
connect again, and how often the master was replaced. Each kind has its own cluster; they run at once. Needs root, and is skipped without
(status 77).
"""
import argparse
import concurrent.futures
import contextlib
import dataclasses
import filecmp
import json
import os
import pathlib
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable

from checks import check, poll
from container.pose_meter import Stream
from network_parts import PostgresCluster, RedisCluster, isolated, obstacle
from processes import run_evpose, simulate
from redis_group import NAMES, SENTINELS

SHORTEST_S, LONGEST_S = 2.0, 10.0
# 2 s of a simulated sensor take 10 s, so that a stream lasts about as long as the longest cut. The load of all kinds at once is small.
RECORDING = ("--object", "cube", "--duration", "2", "--seed", "1")
RATE = 0.2


@dataclasses.dataclass
class Cut:
    """What a kind of pair chooses from: a cluster with a stream, before a cut."""

    cluster: RedisCluster | PostgresCluster
    random: random.Random
    is_wide: bool  # all parts of both kinds, not only one of each
    serving: str  # the server with the stream

    def some(self, parts):
        return list(parts) if self.is_wide else [self.random.choice(list(parts))]

    def servers(self):
        return list(self.cluster.SERVERS) if self.is_wide else [self.serving]

    def replicas(self):
        master = self.cluster.master()
        return self.some(name for name in NAMES if name != master)


def product(first, second):
    return [(a, b) for a in first for b in second]


def sentinel_pairs(cut):
    pairs = [(a, b) for a in SENTINELS for b in SENTINELS if a < b]
    return pairs if cut.is_wide else [cut.random.choice(pairs)]


def zone_pairs(cut):
    """Pairs of a part in the zone and one outside. In every second cut the Redis server in the zone is the master, else a replica."""
    redis = [cut.cluster.master()] if cut.is_wide else cut.replicas()
    zone = [cut.serving, *redis, cut.random.choice(SENTINELS)]
    return product(zone, [part for part in cut.cluster.network.addresses if part not in zone])


@dataclasses.dataclass
class Kind:
    cluster: type
    pairs: Callable[[Cut], list[tuple[str, str]]]
    closes_store_connections: bool = False  # else no part would notice the cut
    kills: bool = False  # the first part of each pair


KINDS = {
    "client-proxy": Kind(RedisCluster, lambda cut: [("client", "proxy")]),
    "proxy-server": Kind(RedisCluster, lambda cut: product(["proxy"], cut.servers())),
    "server-master": Kind(RedisCluster, lambda cut: product(cut.servers(), [cut.cluster.master()])),
    "server-sentinel": Kind(RedisCluster, lambda cut: product(cut.servers(), SENTINELS), closes_store_connections=True),
    "master-replica": Kind(RedisCluster, lambda cut: product([cut.cluster.master()], cut.replicas())),
    # With all Sentinels, they replace a master that works.
    "sentinel-redis": Kind(RedisCluster, lambda cut: product(cut.some(SENTINELS), [cut.cluster.master()])),
    "sentinel-replica": Kind(RedisCluster, lambda cut: product(cut.some(SENTINELS), cut.replicas())),
    "sentinel-sentinel": Kind(RedisCluster, sentinel_pairs),
    "zone": Kind(RedisCluster, zone_pairs),
    "killed-zone": Kind(RedisCluster, zone_pairs, kills=True),
    "server-primary": Kind(PostgresCluster, lambda cut: product(cut.servers(), ["db-1"])),
    "primary-standby": Kind(PostgresCluster, lambda cut: [("db-1", "db-2")]),
}


@dataclasses.dataclass
class Result:
    cuts: int = 0
    identical: int = 0
    longest_s: float = 0.0
    outages: int = 0
    failovers: int = 0


class Run:
    """A client that streams through a cluster."""

    def __init__(self, arguments, cluster, folder):
        self.folder, self.scene, self.cluster = folder, arguments.scene, cluster
        folder.mkdir()
        self.poses = Stream(folder, "poses")
        # Ends with this program also if no client opens the pipe.
        self.reading = threading.Thread(target=self.poses.read, daemon=True)
        self.reading.start()
        self.poses_before = cluster.poses_by_server()
        command = [*cluster.network.enter("client"), arguments.evpose, "replay", self.scene / "recording.raw", "--model",
                   self.scene / "model.obj", "--camera", self.scene / "camera.yaml", "--server", cluster.address, "--rate", str(RATE),
                   "--out", self.poses.path, "--json"]
        with open(folder / "report.json", "w") as report, open(folder / "client.log", "w") as log:
            self.client = subprocess.Popen(command, stdout=report, stderr=log)

    def log(self):
        return (self.folder / "client.log").read_text()

    def await_poses(self, count):
        poll(lambda: self.poses.poses >= count or self.client.poll() is not None, f"{count} poses")
        check(self.client.poll() is None, self.folder, "the client ended before the cut:", self.log())

    def serving(self):
        """The server that has computed most of the poses so far."""
        after = self.cluster.poses_by_server()
        return max(after, key=lambda name: after[name] - self.poses_before[name])

    def finish(self, result):
        poll(lambda: self.client.poll() is not None, f"the end of the client of {self.folder}")
        check(self.client.returncode == 0, self.folder, "the client failed:", self.log())
        self.reading.join()
        report = json.loads((self.folder / "report.json").read_text())
        undisturbed = json.loads((self.scene / "report.json").read_text())
        for field in ("lost_poses", "skipped_events", "tracking_restarts"):
            check(report[field] == 0, self.folder, field, report[field])
        for field in ("sent_bytes", "dropped_events", "poses"):
            check(report[field] == undisturbed[field], self.folder, field, report[field], "instead of", undisturbed[field])
        result.cuts += 1
        result.identical += filecmp.cmp(self.poses.copy, self.scene / "poses.tum", shallow=False)
        result.longest_s = max(result.longest_s, self.poses.longest_s)
        result.outages += report["outages"]


def run_cut(arguments, cluster, kind, name, index, result):
    """One stream with one cut, from a state in which all parts work until they work again."""
    chooser = random.Random(f"{arguments.seed} {name} {index}")
    begin = chooser.randint(1, arguments.num_poses * 6 // 10)
    duration_s = chooser.uniform(SHORTEST_S, LONGEST_S)
    run = Run(arguments, cluster, arguments.work / f"cut-{index}")
    run.await_poses(begin)
    cut = Cut(cluster, chooser, index % 2 == 1, run.serving())
    pairs = kind.pairs(cut)
    ends = sorted({part for pair in pairs for part in pair})
    first_parts = sorted({pair[0] for pair in pairs})
    master = cluster.master()
    before = cluster.network.retransmissions(ends)
    with cluster.network.cut(pairs):
        if kind.kills:
            cluster.kill(first_parts)
        if kind.closes_store_connections:
            cluster.close_store_connections()
        time.sleep(duration_s)  # the duration of the cut; nothing waits for it
        dropped = cluster.network.retransmissions(ends) - before
    if kind.kills:
        cluster.start(first_parts)
    run.finish(result)
    cluster.await_whole()
    check(dropped > 0, run.folder, "no segment was sent again: the cut has dropped nothing")
    result.failovers += cluster.master() != master
    print(f"{name} {index}: {duration_s:.1f} s after pose {begin}, {len(pairs)} pairs, {dropped} segments sent again; longest pause "
          f"{run.poses.longest_s:.1f} s", file=sys.stderr, flush=True)


def run_kind(arguments, name):
    """Runs in namespaces of its own, and prints a result."""
    result = Result()
    kind = KINDS[name]
    with contextlib.ExitStack() as stack:
        cluster = kind.cluster(arguments.work, stack, arguments.server)
        cluster.await_whole()
        for index in range(arguments.cuts):
            run_cut(arguments, cluster, kind, name, index, result)
    print(json.dumps(dataclasses.asdict(result)))


def start_kind(arguments, name):
    work = arguments.work / name
    work.mkdir()
    command = [sys.executable, __file__, arguments.server, arguments.evpose, "--cuts", str(arguments.cuts), "--seed", str(arguments.seed),
               "--work", work, "--kinds", name, "--scene", arguments.work / "scene"]
    run = subprocess.run(isolated(command), stdout=subprocess.PIPE, text=True)
    return Result(**json.loads(run.stdout)) if run.returncode == 0 else None


def parse():
    parser = argparse.ArgumentParser()
    parser.add_argument("server", type=os.path.realpath)
    parser.add_argument("evpose", type=os.path.realpath)
    parser.add_argument("--cuts", type=int, default=2)
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=len(KINDS), help="kinds at a time")
    parser.add_argument("--work", type=pathlib.Path, help="an empty folder for all files, which are then kept")
    parser.add_argument("--scene", type=pathlib.Path, help=argparse.SUPPRESS)  # of the run of one kind
    return parser.parse_args()


def make_scene(arguments):
    scene = arguments.work / "scene"
    simulate(arguments.evpose, scene, *RECORDING)
    report = run_evpose(arguments.evpose, "replay", scene / "recording.raw", "--model", scene / "model.obj", "--camera",
                        scene / "camera.yaml", "--out", scene / "poses.tum", "--json")
    (scene / "report.json").write_text(report)


def main():
    arguments = parse()
    if arguments.scene:
        arguments.num_poses = (arguments.scene / "poses.tum").read_bytes().count(b"\n")
        run_kind(arguments, arguments.kinds[0])
        return
    reason = obstacle()
    if reason:
        print("network_cuts_test: SKIPPED:", reason)
        sys.exit(77)
    with contextlib.ExitStack() as stack:
        arguments.work = arguments.work or pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        arguments.work.chmod(0o711)  # PostgreSQL runs as another user
        make_scene(arguments)
        with concurrent.futures.ThreadPoolExecutor(arguments.jobs) as pool:
            results = dict(zip(arguments.kinds, pool.map(lambda name: start_kind(arguments, name), arguments.kinds)))
    print(f"{'cut between':<18} {'cuts':>5} {'identical':>10} {'longest pause':>14} {'reconnections':>14} {'failovers':>10}")
    for name, result in results.items():
        if result:
            print(f"{name:<18} {result.cuts:>5} {result.identical:>10} {result.longest_s:>12.1f} s {result.outages:>14} {result.failovers:>10}")
    failed = [name for name, result in results.items() if not result or not result.cuts == result.identical == arguments.cuts]
    check(not failed, "failed:", *failed)


main()

#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""How many cameras a cell of servers takes, and how many cells a number of cameras needs: a simulation, no measurement.

A cell has servers in three zones and one Redis group; it shares nothing with other cells. Each camera has a rate of events that changes
between given values at random times, and a session of random duration, after which another one follows. New sessions and those of lost
servers are distributed as by deploy/haproxy/cluster.cfg: of two servers that are drawn by their weights (100 less the load in percent), the
one with fewer streams relative to its weight gets the session; with --balance uniform, as by a Service of Kubernetes, any server gets it. A
server refuses the session if it is full or its load has been above --max-load for 5 s, and the client tries again 5 s later, when a server
is drawn anew. In the middle of the run, servers are lost for the rest of it.

Two assumptions differ from a real cell. A Service chooses a server for each connection of a client (deploy/README.md, Kubernetes), not for
each session, so that --balance uniform may give more cameras than clients with several sessions allow. And a real server with room accepts
the sessions of lost servers at any load.

A server has a backlog when its sessions need more processor time than its cores have. A session is *delayed* in each second that ends
with a backlog of its server, and it *waits* in each second in which it has no server. The capacity of a cell is the largest number of
cameras for which delayed and waiting sessions together, in the mean of all runs, take at most the share --delayed of the time of all
sessions before the loss, and at most the share --delayed-after after the loss of a zone.

The costs are those of deploy/sizing.md. Each one is an option.
"""
import argparse
import dataclasses
import math

import numpy

RETRY_S = 5  # that a refusal states (server/runtime/errors.h)
TIME_CONSTANT_S = 5  # of the load that a server states, and of its hold before it refuses (server/scheduling/load_monitor.h)
ZONES = 3
REDIS_NODES = 3  # of a cell; a Sentinel runs beside each of them


@dataclasses.dataclass
class Camera:
    """Rates in Mev/s with their shares of the time, for `dwell_s` at a time. A share `common` of the cameras changes at the same times."""

    rates: list[float]
    shares: list[float]
    dwell_s: float
    common: float
    costs: list[tuple[float, float]]  # pairs of Mev/s and cores, between which the cost is linear, as below the first one

    def cores(self):
        """Returns the cores that the camera needs at each of its rates."""
        rates, cores = zip((0, 0), *self.costs)
        return numpy.interp(self.rates, rates, cores)

    def mean_cores(self):
        return float(numpy.dot(self.cores(), self.shares))

    def demands(self, random, num_cameras, duration_s):
        """Returns the cores that each camera needs in each second, of shape (duration_s, num_cameras)."""
        def states(columns):
            changes = random.random((duration_s, columns)) < 1 / self.dwell_s
            changes[0] = True
            drawn = random.choice(len(self.rates), size=(duration_s, columns), p=self.shares)
            last_change = numpy.maximum.accumulate(numpy.where(changes, numpy.arange(duration_s)[:, None], 0), axis=0)
            return numpy.take_along_axis(drawn, last_change, axis=0)

        own, shared = states(num_cameras), states(1)
        num_common = round(self.common * num_cameras)
        own[:, :num_common] = shared
        return self.cores()[own]


@dataclasses.dataclass
class Servers:
    count: int
    cores: int
    max_sessions: int
    max_load: float
    has_weights: bool = True


@dataclasses.dataclass
class Times:
    """Shares of the time of all sessions."""

    delayed: float
    waiting: float

    @property
    def bad(self):
        return self.delayed + self.waiting


class Cell:
    def __init__(self, random, servers, demands, session_s):
        self._random, self._servers, self._demands, self._session_s = random, servers, demands, session_s
        self._server_of = numpy.full(demands.shape[1], -1)
        self._load = numpy.zeros(servers.count)
        self._above_s = numpy.zeros(servers.count)
        self._backlog = numpy.zeros(servers.count)  # core-seconds
        self._tries_at = numpy.zeros(demands.shape[1], int)
        self._is_alive = numpy.ones(servers.count, bool)

    def lose(self, servers):
        self._is_alive[servers] = False
        self._server_of[numpy.isin(self._server_of, servers)] = -1

    def step(self, second):
        """Advances by one second. Returns the numbers of delayed and of waiting sessions."""
        ended = self._random.random(self._server_of.size) < 1 / self._session_s
        self._server_of[ended] = -1
        self._place(numpy.flatnonzero((self._server_of < 0) & (self._tries_at <= second)), second)
        is_placed = self._server_of >= 0
        cores = numpy.bincount(self._server_of[is_placed], self._demands[second, is_placed], self._servers.count)
        used = numpy.minimum((cores + self._backlog) / self._servers.cores, 1)
        self._backlog = numpy.maximum(self._backlog + cores - self._servers.cores, 0)
        self._load += (used - self._load) / TIME_CONSTANT_S
        self._above_s = numpy.where(self._load > self._servers.max_load, self._above_s + 1, 0)
        is_delayed = self._backlog > 0
        return numpy.count_nonzero(is_delayed[self._server_of[is_placed]]), numpy.count_nonzero(~is_placed)

    def _place(self, cameras, second):
        counts = numpy.bincount(self._server_of[self._server_of >= 0], minlength=self._servers.count)
        # A server states the largest part that is in use.
        stated = numpy.maximum(self._load, counts / self._servers.max_sessions)
        weights = numpy.maximum(1, 100 - numpy.round(100 * stated)) if self._servers.has_weights else numpy.ones(self._servers.count)
        weights = numpy.where(self._is_alive, weights, 0)
        for camera in cameras:
            drawn = self._random.choice(self._servers.count, size=2 if self._servers.has_weights else 1, p=weights / weights.sum())
            server = min(drawn, key=lambda each: counts[each] / weights[each])
            if counts[server] < self._servers.max_sessions and self._above_s[server] <= TIME_CONSTANT_S:
                self._server_of[camera] = server
                counts[server] += 1
            else:
                self._tries_at[camera] = second + RETRY_S


def simulate(seed, servers, camera, num_cameras, options, lost):
    """Runs a cell that loses its first `lost` servers in the middle. Returns the Times before and after."""
    random = numpy.random.default_rng(seed)
    half_s = options.half_s
    cell = Cell(random, servers, camera.demands(random, num_cameras, 2 * half_s), options.session_s)
    counts = numpy.zeros((2 * half_s, 2))
    for second in range(2 * half_s):
        if second == half_s:
            cell.lose(numpy.arange(lost))
        counts[second] = cell.step(second)
    # The first seconds fill an empty cell.
    parts = counts[4 * TIME_CONSTANT_S:half_s], counts[half_s:]
    return [Times(*(part.mean(axis=0) / num_cameras)) for part in parts]


def bad_shares(servers, camera, num_cameras, options, lost):
    """Returns the shares of the time that are delayed or waiting, of shape (seeds, 2): before and after the loss."""
    runs = [simulate(seed, servers, camera, num_cameras, options, lost) for seed in range(1, options.seeds + 1)]
    return numpy.array([[part.bad for part in run] for run in runs])


def num_lost(servers):
    """Servers of the largest zone."""
    return math.ceil(servers.count / ZONES)


def is_enough(servers, camera, num_cameras, options):
    before, after = bad_shares(servers, camera, num_cameras, options, num_lost(servers)).mean(axis=0)
    return before <= options.delayed and after <= options.delayed_after


def most_cameras(servers, camera, options):
    """Returns the largest number of cameras, by bisection; 0 if not even one has room."""
    low, high = 0, servers.count * servers.max_sessions
    while low < high:
        middle = (low + high + 1) // 2
        if is_enough(servers, camera, middle, options):
            low = middle
        else:
            high = middle - 1
    return low


def redis_limits(options):
    """Returns the sessions for which a Redis group has room, by reason."""
    return {
        "memory": int(options.redis_gb * 1e9 / (options.session_mb * 1e6)),
        "processor": int(options.redis_load / options.redis_core),
        # The master receives what is written once, and sends it to two replicas.
        "network": int(options.network_gbit_s * 1e9 / 8 / (2 * options.written_mb_s * 1e6)),
    }


def print_cells(camera, options):
    """Prints what cells of each size take. Returns cameras and servers of the cell with the most cameras for each machine, with those of Redis."""
    limits = redis_limits(options)
    print(f"A camera needs {camera.mean_cores():.2f} cores on average, at most {max(camera.cores()):.2f}.")
    print("A Redis group has room for " + ", ".join(f"{count} sessions by its {reason}" for reason, count in limits.items()) + ".\n")
    print("Delayed or waiting: mean / worst of the runs.\n")
    print("| servers | cameras | for each server | for each core | load | delayed or waiting | after the loss of one server | after the loss of "
          "a zone |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    best = 0, 1
    for count in options.servers:
        servers = Servers(count, options.cores, options.max_sessions, options.max_load, options.balance == "haproxy")
        cameras = min(most_cameras(servers, camera, options), *limits.values())
        if cameras == 0:
            print(f"| {count} | 0 | | | | | | |")
            continue
        before, after_zone = bad_shares(servers, camera, cameras, options, num_lost(servers)).T
        _, after_one = bad_shares(servers, camera, cameras, options, 1).T
        parts = " | ".join(f"{part.mean():.2%} / {part.max():.1%}" for part in (before, after_one, after_zone))
        load = cameras * camera.mean_cores() / (count * options.cores)
        print(f"| {count} | {cameras} | {cameras / count:.1f} | {cameras / (count * options.cores):.2f} | {load:.0%} | {parts} |")
        best = max(best, (cameras, count), key=lambda cell: cell[0] / (cell[1] + REDIS_NODES))
    return best


def print_totals(cameras_of_cell, servers_of_cell, options):
    """Prints what numbers of cameras need, and how many cameras a loss affects."""
    print("\n| cameras | cells | servers | Redis nodes | loss of a server | of a Redis master | of a cell |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for cameras in options.cameras:
        cells = math.ceil(cameras / cameras_of_cell)
        per_cell = cameras / cells
        print(f"| {cameras} | {cells} | {cells * servers_of_cell} | {cells * REDIS_NODES} | {per_cell / servers_of_cell:.0f} cameras pause for "
              f"{options.server_pause_s:g} s | {per_cell:.0f} pause for {options.redis_pause_s:g} s | {per_cell:.0f} stop, {per_cell / cameras:.1%} |")


def cost(text):
    rate, cores = text.split(":")
    return float(rate), float(cores)


def parse(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    camera = parser.add_argument_group("cameras")
    camera.add_argument("--cameras", type=int, nargs="+", default=[1000, 100_000], help="total numbers (default: 1000 100000)")
    camera.add_argument("--rates", type=float, nargs="+", default=[0.05, 1, 3], help="Mev/s (default: 0.05 1 3)")
    camera.add_argument("--shares", type=float, nargs="+", default=[0.5, 0.4, 0.1], help="of the time, for each rate (default: 0.5 0.4 0.1)")
    camera.add_argument("--dwell-s", type=float, default=10, help="mean time between changes of the rate (default: 10)")
    camera.add_argument("--common", type=float, default=0, help="share of the cameras that change together, such as those of one scene (default: 0)")
    camera.add_argument("--session-s", type=float, default=3600, help="mean duration of a session (default: 3600)")
    camera.add_argument("--costs", type=cost, nargs="+", default=[(1, 0.36), (10, 0.91)], metavar="MEV_S:CORES",
                        help="cores at rates of events, between which the cost is linear (default: 1:0.36 10:0.91)")
    servers = parser.add_argument_group("servers")
    servers.add_argument("--servers", type=int, nargs="+", default=[3, 6, 12, 24, 48], help="of a cell (default: 3 6 12 24 48)")
    servers.add_argument("--cores", type=int, default=4, help="of a server (default: 4)")
    servers.add_argument("--max-sessions", type=int, default=12, help="of a server (default: 12, that of deploy/kubernetes)")
    servers.add_argument("--max-load", type=float, default=0.9, help="above which a server refuses sessions (default: 0.9)")
    servers.add_argument("--balance", choices=["haproxy", "uniform"], default="haproxy", help="who chooses the server (default: haproxy)")
    servers.add_argument("--server-pause-s", type=float, default=3.9, help="of a session whose server is lost (default: 3.9)")
    redis = parser.add_argument_group("Redis")
    redis.add_argument("--redis-gb", type=float, default=1.88, help="of a node for sessions (default: 1.88, 2 GiB less the backlog)")
    redis.add_argument("--session-mb", type=float, default=3.2, help="of a session with a full log of poses (default: 3.2)")
    redis.add_argument("--redis-core", type=float, default=0.0015, help="of the core of Redis, for each session (default: 0.0015)")
    redis.add_argument("--redis-load", type=float, default=0.7, help="of that core, at most (default: 0.7)")
    redis.add_argument("--written-mb-s", type=float, default=0.15, help="by a session at 1000 poses per second (default: 0.15)")
    redis.add_argument("--network-gbit-s", type=float, default=10, help="that the master can send (default: 10)")
    redis.add_argument("--redis-pause-s", type=float, default=12.3, help="of sessions whose Redis master is lost (default: 12.3)")
    run = parser.add_argument_group("simulation")
    run.add_argument("--delayed", type=float, default=0.001, help="bound of the share of the time before the loss (default: 0.001)")
    run.add_argument("--delayed-after", type=float, default=0.01, help="bound after the loss of a zone (default: 0.01)")
    run.add_argument("--half-s", type=int, default=900, help="seconds before and after the loss (default: 900)")
    run.add_argument("--seeds", type=int, default=20, help="number of runs (default: 20)")
    options = parser.parse_args(arguments)
    if len(options.rates) != len(options.shares) or not math.isclose(sum(options.shares), 1):
        parser.error("--shares needs a share for each of --rates, and their sum must be 1")
    if min(options.servers) < ZONES:
        parser.error(f"--servers: a cell needs a server in each of {ZONES} zones")
    if options.costs != sorted(options.costs) or options.costs[0][0] <= 0 or max(options.rates) > options.costs[-1][0]:
        parser.error("--costs must have increasing rates above 0, up to the highest of --rates")
    if options.half_s <= 4 * TIME_CONSTANT_S or options.dwell_s < 1 or options.session_s < 1 or not 0 <= options.common <= 1:
        parser.error(f"--half-s must be above {4 * TIME_CONSTANT_S}, --dwell-s and --session-s at least 1, --common between 0 and 1")
    return options


def camera_of(options):
    return Camera(options.rates, options.shares, options.dwell_s, options.common, options.costs)


def main():
    options = parse()
    cameras, servers = print_cells(camera_of(options), options)
    if cameras > 0:
        print_totals(cameras, servers, options)


if __name__ == "__main__":
    main()

#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Measures how many sessions a group of three Redis servers has room for.

  tests/bench/stores/store_load.py --bin build/release [--sessions 100 300 1000] [--maxmemory 3gb] [--rate 250000] [--seconds 60]

Starts three Redis servers with the settings of deploy/redis/node.conf (without encryption) and a Sentinel. Runs one real session for
--seconds at the pace of its sensor and records what it commits; then writes these commits at their times under N names, for each N of
--sessions, without tracking anything. The sessions begin within --spread seconds; in the --warm-up seconds after that their logs of poses
fill. Prints for the rest of the time, for each N: the latency from the time at which a commit is due until a replica has it, the processor
time of the master less its idle one, and its memory. The program and the three servers share the processors of this machine, so that
latencies are those of servers of their own only while it is not busy. Status 1 if a session failed. Needs redis-server.
"""
import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import threading

from local_redis_group import RedisGroup


class LargestMemory:
    """Asks Redis for its memory several times a second, in a thread, and keeps the largest amount."""

    def __init__(self, redis):
        self.redis = redis
        self.data_bytes = self.all_bytes = 0
        self.is_over = threading.Event()
        self.thread = threading.Thread(target=self._read)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.is_over.set()
        self.thread.join()

    def _read(self):
        while not self.is_over.wait(0.5):
            fields = self.redis.info()
            self.data_bytes = max(self.data_bytes, int(fields["used_memory_dataset"]))
            self.all_bytes = max(self.all_bytes, int(fields["used_memory"]))

    def take(self):
        """Returns the largest amounts since the last call: that of the data, and that which counts for maxmemory."""
        taken = self.data_bytes, self.all_bytes
        self.data_bytes = self.all_bytes = 0
        return taken


def print_recording(recorded):
    commits, poses = recorded["recorded_commits"], recorded["recorded_poses"]
    rest = recorded["lifecycle_bytes"]
    all_bytes = recorded["checkpoint_bytes"] + recorded["pose_bytes"] + rest
    print(f"recorded {recorded['recorded_s']:.1f} s: {commits / recorded['recorded_s']:.2f} commits/s, {poses / recorded['recorded_s']:.0f} poses/s, "
          f"{1e-6 * all_bytes / recorded['recorded_s']:.3f} MB/s; for each commit {1e-3 * recorded['checkpoint_bytes'] / commits:.1f} kB of the "
          f"checkpoint and {1e-3 * recorded['pose_bytes'] / commits:.1f} kB of poses", flush=True)


def print_run(run, data_bytes, all_bytes):
    sessions, seconds = run["sessions"], run["seconds"]
    cores = run["cores"] - run["idle_cores"]
    print(f"{sessions} sessions: {run['written'] / seconds:.0f} commits/s, {1e-6 * run['bytes'] / seconds:.1f} MB/s; latency p50 "
          f"{run['latency_p50_ms']:.1f}, p99 {run['latency_p99_ms']:.1f}, max {run['latency_max_ms']:.0f} ms; "
          f"{run['unwritten']} commits too late, {run['repeated']} repeated, sessions that failed: {run['errors'] or 0}; "
          f"master {100 * cores:.1f} % of a core, {100 * cores / sessions:.3f} % for each session (idle {100 * run['idle_cores']:.2f} %); "
          f"memory {1e-6 * all_bytes:.0f} MB, of these data {1e-6 * data_bytes:.0f} MB, {1e-6 * data_bytes / sessions:.2f} MB for each session; "
          f"load of the machine {os.getloadavg()[0]:.1f}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, required=True, help="build directory with store_load")
    parser.add_argument("--sessions", type=int, nargs="+", default=[100, 300, 1000], help="numbers of names")
    parser.add_argument("--maxmemory", default="3gb", help="of each Redis server (default: 3gb)")
    parser.add_argument("--rate", type=float, default=250_000, help="events per second of the session")
    parser.add_argument("--seconds", type=float, default=60, help="length of the recording")
    parser.add_argument("--spread", type=float, default=20, help="time within which the sessions begin")
    parser.add_argument("--warm-up", type=float, default=20, help="time after that before the measurement")
    parser.add_argument("--idle", type=float, default=5, help="time for the measurement of the idle processor time")
    options = parser.parse_args()
    command = [options.bin / "tests/bench/stores/store_load", "--sessions", *map(str, options.sessions)]
    for name in ("rate", "seconds", "spread", "warm_up", "idle"):
        command += ["--" + name.replace("_", "-"), str(getattr(options, name))]
    is_good = True
    with tempfile.TemporaryDirectory() as folder, RedisGroup(folder, "--maxmemory", options.maxmemory) as redis, \
            subprocess.Popen([*command, "--store", redis.url], stdout=subprocess.PIPE, text=True) as load, LargestMemory(redis) as memory:
        for line in load.stdout:
            result = json.loads(line)
            largest = memory.take()
            if "sessions" not in result:
                print_recording(result)
                continue
            print_run(result, *largest)
            is_good = is_good and not result["errors"] and result["written"] > 0
    sys.exit(0 if is_good and load.returncode == 0 else 1)


if __name__ == "__main__":
    main()

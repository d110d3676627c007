#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Measures what sessions write to Redis, and the memory that Redis needs for them.

  tests/bench/stores/store_traffic.py --bin build/release [--sessions 4] [--rate 1000000] [--minutes 0.7] [--idle 10]

Starts three Redis servers with the settings of deploy/redis/node.conf (without encryption) and a Sentinel, an evpose-server on them and
`evpose bench load`. Prints, for each session: poses per second, bytes that the master receives per second and per pose, commits per second
with the bytes of their parts, the share of a core that the master uses, and its largest memory. The processor time that the master uses
with an idle server, measured for --idle seconds before, is subtracted. After 16,384 poses the log of a session is full and its memory no
longer grows. From that it calculates how many such sessions a Redis of 3 GB has room for, at 70 % of its memory. Needs redis-server.
"""
import argparse
import contextlib
import os
import pathlib
import subprocess
import sys
import tempfile
import time

from local_redis_group import RedisGroup

sys.path.append(str(pathlib.Path(__file__).resolve().parents[2]))
from processes import Server  # noqa: E402

REDIS_BYTES = 3e9
USABLE = 0.7
LOG_CAPACITY = 16384


def redis_state(redis):
    fields = redis.info()
    return {"received": float(fields["total_net_input_bytes"]), "memory": float(fields["used_memory_dataset"]), "cpu_s": redis.cpu_s(),
            "time_s": time.monotonic()}


def largest_memory(redis, is_over):
    """Asks Redis for its memory twice a second until is_over(), and returns the largest one. This takes processor time of Redis."""
    memory = 0
    while not is_over():
        memory = max(memory, redis_state(redis)["memory"])
        time.sleep(0.5)
    return memory


def idle_cores(redis, idle_s):
    before = redis_state(redis)
    largest_memory(redis, lambda: time.monotonic() > before["time_s"] + idle_s)
    after = redis_state(redis)
    return (after["cpu_s"] - before["cpu_s"]) / (after["time_s"] - before["time_s"])


def measure(options):
    with contextlib.ExitStack() as cleanup:
        redis = cleanup.enter_context(RedisGroup(cleanup.enter_context(tempfile.TemporaryDirectory())))
        server = cleanup.enter_context(Server(options.bin / "server/evpose-server", "--log-level", "warning", store=redis.url))
        idle = idle_cores(redis, options.idle)
        before = redis_state(redis)
        load = subprocess.Popen([options.bin / "client/cli/evpose", "bench", "load", "--server", server.address, "--json",
                                 "--sessions", str(options.sessions), "--rate", str(options.rate), "--minutes", str(options.minutes)],
                                stdout=subprocess.PIPE, text=True)
        cleanup.callback(load.wait)
        cleanup.callback(load.kill)
        memory = largest_memory(redis, lambda: load.poll() is not None)  # before the sessions are deleted
        if load.returncode:
            sys.exit("evpose bench load has lost poses or sessions: " + load.stdout.read())
        poses, commits, checkpoint_bytes, pose_bytes = server.metrics(
            ("evpose_poses_total",), ("evpose_checkpoint_duration_seconds_count",), ("evpose_commit_bytes_total", 'part="checkpoint"'),
            ("evpose_commit_bytes_total", 'part="poses"'))
        after = redis_state(redis)
        server.terminate()
    seconds = 60 * options.minutes * options.sessions
    used = {key: after[key] - before[key] for key in before}
    return {"poses_per_s": poses / seconds, "bytes_per_s": used["received"] / seconds, "bytes_per_pose": used["received"] / poses,
            "commits_per_s": commits / seconds, "checkpoint_bytes": checkpoint_bytes / commits, "pose_bytes": pose_bytes / commits,
            "idle_core": idle, "redis_core": (used["cpu_s"] - idle * used["time_s"]) / seconds,
            "memory_bytes": (memory - before["memory"]) / options.sessions, "poses_in_log": min(LOG_CAPACITY, poses / options.sessions)}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, required=True, help="build directory with evpose and evpose-server")
    parser.add_argument("--sessions", type=int, default=4)
    parser.add_argument("--rate", type=int, default=1_000_000, help="events per second of each session")
    parser.add_argument("--minutes", type=float, default=0.7)
    parser.add_argument("--idle", type=float, default=10, help="seconds for the measurement of the idle processor time")
    result = measure(parser.parse_args())
    print(f"per session: {result['poses_per_s']:.0f} poses/s, {result['bytes_per_s'] / 1e6:.3f} MB/s to Redis "
          f"({result['bytes_per_pose']:.0f} bytes for each pose), {result['commits_per_s']:.2f} commits/s with "
          f"{result['checkpoint_bytes'] / 1e3:.1f} kB of the checkpoint and {result['pose_bytes'] / 1e3:.1f} kB of poses each, "
          f"{100 * result['redis_core']:.2f} % of a core of the master (idle, not included: {100 * result['idle_core']:.2f} %)")
    print(f"memory of Redis per session: {result['memory_bytes'] / 1e6:.2f} MB with {result['poses_in_log']:.0f} poses")
    print(f"a Redis of 3 GB, {100 * USABLE:.0f} % of it in use, has room for {REDIS_BYTES * USABLE / result['memory_bytes']:.0f} such sessions; "
          f"load of the machine {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()

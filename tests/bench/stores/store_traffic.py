#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Measures what sessions write to Redis, and the memory that Redis needs for them.

  tests/bench/stores/store_traffic.py --bin build/release [--sessions 4] [--rate 1000000] [--minutes 0.7]

Starts redis-server, an evpose-server on it and `evpose bench load`, and prints, for each session: poses per second, bytes that Redis
receives per second and per pose, commits per second, the share of a core that Redis uses, and the largest memory of Redis. After
16,384 poses the log of a session is full and its memory no longer grows. From that it calculates how many such sessions a Redis of
3 GB has room for, at 70 % of its memory. Needs redis-server.
"""
import argparse
import contextlib
import pathlib
import subprocess
import sys
import tempfile
import time

sys.path.append(str(pathlib.Path(__file__).resolve().parents[2]))
from processes import Redis, Server  # noqa: E402

REDIS_BYTES = 3e9
USABLE = 0.7
LOG_CAPACITY = 16384


def redis_state(redis):
    fields = redis.info()
    return {"received": float(fields["total_net_input_bytes"]), "memory": float(fields["used_memory_dataset"]),
            "cpu_s": float(fields["used_cpu_user"]) + float(fields["used_cpu_sys"])}


def measure(options):
    with contextlib.ExitStack() as cleanup:
        redis = cleanup.enter_context(Redis(cleanup.enter_context(tempfile.TemporaryDirectory())))
        server = cleanup.enter_context(Server(options.bin / "server/evpose-server", "--log-level", "warning", store=redis.url))
        before = redis_state(redis)
        load = subprocess.Popen([options.bin / "client/cli/evpose", "bench", "load", "--server", server.address, "--json",
                                 "--sessions", str(options.sessions), "--rate", str(options.rate), "--minutes", str(options.minutes)],
                                stdout=subprocess.PIPE, text=True)
        cleanup.callback(load.wait)
        cleanup.callback(load.kill)
        memory = 0  # the largest one: the sessions are deleted at the end
        while load.poll() is None:
            memory = max(memory, redis_state(redis)["memory"])
            time.sleep(0.5)
        if load.returncode:
            sys.exit("evpose bench load has lost poses or sessions: " + load.stdout.read())
        poses, commits = server.metrics(("evpose_poses_total",), ("evpose_checkpoint_duration_seconds_count",))
        after = redis_state(redis)
        server.terminate()
    seconds = 60 * options.minutes * options.sessions
    used = {key: after[key] - before[key] for key in before}
    return {"poses_per_s": poses / seconds, "bytes_per_s": used["received"] / seconds, "bytes_per_pose": used["received"] / poses,
            "commits_per_s": commits / seconds, "redis_core": used["cpu_s"] / seconds, "memory_bytes": (memory - before["memory"]) / options.sessions,
            "poses_in_log": min(LOG_CAPACITY, poses / options.sessions)}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, required=True, help="build directory with evpose and evpose-server")
    parser.add_argument("--sessions", type=int, default=4)
    parser.add_argument("--rate", type=int, default=1_000_000, help="events per second of each session")
    parser.add_argument("--minutes", type=float, default=0.7)
    result = measure(parser.parse_args())
    print(f"per session: {result['poses_per_s']:.0f} poses/s, {result['bytes_per_s'] / 1e6:.3f} MB/s to Redis "
          f"({result['bytes_per_pose']:.0f} bytes for each pose), {result['commits_per_s']:.2f} commits/s, "
          f"{100 * result['redis_core']:.2f} % of a core of Redis")
    print(f"memory of Redis per session: {result['memory_bytes'] / 1e6:.2f} MB with {result['poses_in_log']:.0f} poses")
    print(f"a Redis of 3 GB, {100 * USABLE:.0f} % of it in use, has room for {REDIS_BYTES * USABLE / result['memory_bytes']:.0f} such sessions")


if __name__ == "__main__":
    main()

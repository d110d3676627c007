#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Measures a server on a store that has many sessions: the start, its memory, CreateSession and ListSessions.

  tests/bench/stores/stored_sessions.py --bin build/release [--stores sqlite redis postgresql] [--sessions 100000] [--calls 200] [--check]

For each kind of store it stores a session without events (about 2 kB), copies it under other names with copy_sessions, starts
evpose-server, and prints: the time and the processor time until the first call has been answered, the resident memory then, and the
latency of CreateSession with a request_id and of ListSessions with pages of 50, at random places of the list. With --check, status 1 if
a goal is missed: 1 s, 50 MB more than with an empty store, and 50 ms for 99 % of the calls. Needs the target copy_sessions,
redis-server, postgresql-15, python3-grpcio and python3-protobuf.
"""
import argparse
import contextlib
import os
import pathlib
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time

sys.path += [str(pathlib.Path(__file__).resolve().parents[level]) for level in (1, 2)]
from processes import Redis  # noqa: E402
from start_stop import CUBE, Server, create_request, load_api, percentile  # noqa: E402

GOAL_START_S = 1
GOAL_MEMORY_MB = 50
GOAL_CALL_MS = 50
PAGE_SIZE = 50


class Postgres:
    """A PostgreSQL server on a socket in a folder of its own; it does not run as root."""

    def __init__(self):
        self.folder = tempfile.TemporaryDirectory()
        self.user = {}
        if os.geteuid() == 0:
            shutil.chown(self.folder.name, "nobody", "nogroup")
            self.user = {"user": "nobody", "group": "nogroup", "extra_groups": []}
        programs = "/usr/lib/postgresql/15/bin/"
        data = self.folder.name + "/data"
        subprocess.run([programs + "initdb", "-D", data, "-U", "evpose", "-A", "trust", "-E", "UTF8", "--locale=C"], check=True,
                       stdout=subprocess.DEVNULL, cwd="/", **self.user)
        self.process = subprocess.Popen([programs + "postgres", "-D", data, "-c", "listen_addresses=", "-c",
                                         "unix_socket_directories=" + self.folder.name],
                                        stderr=subprocess.PIPE, text=True, cwd="/", **self.user)
        if not any("ready to accept connections" in line for line in self.process.stderr):
            sys.exit("postgres does not start")
        self.address = f"postgresql://evpose@/postgres?host={self.folder.name}"

    def close(self):
        self.process.send_signal(signal.SIGQUIT)
        self.process.wait()
        self.folder.cleanup()


def timed_start(cleanup, program, store, api):
    """Returns a server that has answered a call, the seconds until then, and its processor time. `cleanup` ends it."""
    server = cleanup.enter_context(Server(program, store))
    server.unary("SessionService/ListSessions", api.ListSessionsRequest(page_size=1), api.ListSessionsResponse)
    return server, time.monotonic() - server.started_s, server.cpu_s()


def call_times_ms(count, call):
    times_ms = []
    for _ in range(count):
        begin_s = time.monotonic()
        call()
        times_ms.append(1000 * (time.monotonic() - begin_s))
    return times_ms


def list_pages(server, api, count):
    """Latencies of pages at random places: a page token is the last name before the page."""
    chooser = random.Random(1)
    return call_times_ms(count, lambda: server.unary(
        "SessionService/ListSessions", api.ListSessionsRequest(page_size=PAGE_SIZE, page_token=f"sessions/{chooser.getrandbits(128):032x}"),
        api.ListSessionsResponse))


def create_sessions(server, api, model, count):
    numbers = iter(range(count))

    def create():
        request = create_request(api, model, 64)
        request.request_id = f"request-{next(numbers)}"
        server.unary("SessionService/CreateSession", request, api.CreateSessionResponse)

    return call_times_ms(count, create)


def measure(arguments, api, name, store, copy):
    """Prints the figures of one kind of store and returns whether they meet the goals."""
    with contextlib.ExitStack() as cleanup:
        return measure_with(cleanup, arguments, api, name, store, copy)


def measure_with(cleanup, arguments, api, name, store, copy):
    program = os.path.join(arguments.bin, "server", "evpose-server")
    _, sessions, models = api
    options = ["--max-sessions", str(arguments.sessions + arguments.calls + 1), "--max-session-memory", str(10**12),
               "--session-expiry", "86400"]
    server = cleanup.enter_context(Server(program, store + options))
    model = server.upload(models, CUBE, 1).name
    created = server.unary("SessionService/CreateSession", create_request(sessions, model, 64), sessions.CreateSessionResponse)
    server.end()
    server, empty_s, empty_cpu_s = timed_start(cleanup, program, store + options, sessions)
    empty_mb = server.resident_bytes() / 1e6
    server.end()
    copy_sessions = os.path.join(arguments.bin, "tests", "bench", "stores", "copy_sessions")
    subprocess.run([copy_sessions, *copy, created.session.name, str(arguments.sessions - 1)], check=True)
    server, start_s, start_cpu_s = timed_start(cleanup, program, store + options, sessions)
    start_mb = server.resident_bytes() / 1e6
    lists_ms = list_pages(server, sessions, arguments.calls)
    creates_ms = create_sessions(server, sessions, model, arguments.calls)
    print(f"{name}, {arguments.sessions} sessions: start {start_s:.2f} s, {start_cpu_s:.2f} s of processor time, "
          f"{start_mb:.0f} MB resident (with one session {empty_s:.2f} s, {empty_cpu_s:.2f} s, {empty_mb:.0f} MB); "
          f"of {arguments.calls} calls, ms: CreateSession p50 {percentile(creates_ms, 0.5):.1f}, "
          f"p99 {percentile(creates_ms, 0.99):.1f}; ListSessions({PAGE_SIZE}) p50 {percentile(lists_ms, 0.5):.1f}, "
          f"p99 {percentile(lists_ms, 0.99):.1f}", flush=True)
    server.end()
    return (start_s <= GOAL_START_S and start_mb - empty_mb <= GOAL_MEMORY_MB
            and max(percentile(times_ms, 0.99) for times_ms in (creates_ms, lists_ms)) <= GOAL_CALL_MS)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", default="build/release", help="folder of the build")
    parser.add_argument("--stores", nargs="+", choices=("sqlite", "redis", "postgresql"),
                        default=["sqlite", "redis", "postgresql"])
    parser.add_argument("--sessions", type=int, default=100_000, help="sessions in the store")
    parser.add_argument("--calls", type=int, default=200, help="calls of CreateSession and of ListSessions")
    parser.add_argument("--check", action="store_true", help="status 1 if a goal is missed")
    arguments = parser.parse_args()
    is_good = True
    with tempfile.TemporaryDirectory() as folder:
        api = load_api(folder)
        if "sqlite" in arguments.stores:
            data = folder + "/data"
            is_good &= measure(arguments, api, "SQLite", ["--store", "sqlite", "--data-dir", data], ["sqlite", data])
        if "redis" in arguments.stores:
            with Redis(folder) as redis:
                is_good &= measure(arguments, api, "Redis", ["--store", redis.url], [redis.url, ""])
        if "postgresql" in arguments.stores:
            with contextlib.closing(Postgres()) as postgres:
                is_good &= measure(arguments, api, "PostgreSQL", ["--store", postgres.address], [postgres.address, ""])
    sys.exit(1 if arguments.check and not is_good else 0)


if __name__ == "__main__":
    main()

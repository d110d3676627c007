#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Measures how fast a server resumes the sessions of another one that is killed.

  tests/bench/stores/resume_sessions.py --server build/release/server/evpose-server [--server OTHER ...] [--sessions 24] [--busy 4]
                                        [--runs 5] [--tenants 1]

For each server program it starts Redis and two servers on it, kills one that has --sessions sessions of --tenants tenants, attaches to all
of them at the other one at the same time, and prints when the first, the middle and the last stream was attached, and the processor time of
that server per session. Meanwhile --busy processes compute, because the servers of busy machines have to wait for processors. The programs
take turns, so that they have the same load of other programs. Needs redis-server, python3-grpcio and python3-protobuf.
"""
import argparse
import contextlib
import hashlib
import importlib
import os
import pathlib
import queue
import statistics
import subprocess
import sys
import tempfile
import time
from concurrent import futures

sys.path += [str(pathlib.Path(__file__).resolve().parents[level]) for level in (1, 2)]
from processes import Redis  # noqa: E402
from start_stop import CUBE, Server, create_request, load_api  # noqa: E402

SIDE_PX = 480
EVENT_PERIOD_US = 50
EVENTS_MS = 200


def events():
    """Returns events on a diagonal, FLAT64: time, bits 63 to 32; x from bit 16 on, y from bit 2 on."""
    words = ((t_us << 32) | ((t_us // EVENT_PERIOD_US % SIDE_PX) << 16) | ((t_us // EVENT_PERIOD_US % SIDE_PX) << 2)
             for t_us in range(0, 1000 * EVENTS_MS, EVENT_PERIOD_US))
    return b"".join(word.to_bytes(8, "little") for word in words)


class Stream:
    """A Track stream that attaches when it is constructed."""

    def __init__(self, server, track, name, token, metadata):
        self._requests = queue.SimpleQueue()
        self._make = track.TrackRequest
        call = server.channel.stream_stream("/evpose.v1.SessionService/Track", track.TrackRequest.SerializeToString,
                                            track.TrackResponse.FromString)
        self.send(attach={"session": name, "resume_token": token})
        self._call = call(iter(self._requests.get, None), metadata=metadata)

    def send(self, **fields):
        self._requests.put(self._make(**fields))

    def until(self, is_found):
        return next(response for response in self._call if is_found(response))

    def token(self):
        """Waits until the stream is attached, and returns the token of the session."""
        return self.until(lambda response: response.HasField("attached")).attached.resume_token

    def close(self):
        self._call.cancel()
        self._requests.put(None)


def write_tokens(path, count):
    """Writes the token file of that many tenants. Returns their tokens."""
    tokens = [f"evpose_{i:064x}" for i in range(count)]
    path.write_text("".join(f"tenant{i} {hashlib.sha256(token.encode()).hexdigest()}\n" for i, token in enumerate(tokens)))
    path.chmod(0o600)
    return tokens


def create(server, api, tenant_token):
    """Returns the name and the token of a session of the tenant, whose first chunk is in the store, and the metadata of its calls."""
    service, models, track = api
    server.metadata = server.metadata_of(tenant_token)
    model = server.upload(models, CUBE, 1).name
    made = server.unary("SessionService/CreateSession", create_request(service, model, SIDE_PX), service.CreateSessionResponse)
    stream = Stream(server, track, made.session.name, made.resume_token, server.metadata)
    token = stream.token()
    stream.send(events={"seq": 1, "payload": events()})
    stream.until(lambda response: response.HasField("ack") and response.ack.processed_seq == 1)
    stream.close()  # a detached session is persisted
    return made.session.name, token, server.metadata


def resume_times_s(program, options, api, folder):
    """Returns the times from the attaches on until each stream was attached, in increasing order, and the processor time per session."""
    _, _, track = api
    with contextlib.ExitStack() as cleanup:
        redis = cleanup.enter_context(Redis(folder))
        arguments = ["--store", redis.url, "--max-sessions", str(options.sessions + options.tenants), "--log-level", "warning"]
        tenants = [None]  # without tokens a server has one tenant
        if options.tenants > 1:
            token_file = pathlib.Path(folder) / "tokens"
            tenants = write_tokens(token_file, options.tenants)
            arguments += ["--token-file", str(token_file)]
        first, second = (cleanup.enter_context(Server(program, arguments)) for _ in range(2))
        sessions = [create(first, api, tenants[i % len(tenants)]) for i in range(options.sessions)]
        for tenant in tenants:
            create(second, api, tenant)  # a server in use has loaded its models
        for _ in range(options.busy):
            busy = subprocess.Popen([sys.executable, "-c", "while True: pass"])
            cleanup.callback(busy.wait)
            cleanup.callback(busy.kill)
        first.kill()
        begin_cpu_s, begin_s = second.cpu_s(), time.monotonic()
        streams = [Stream(second, track, *session) for session in sessions]

        def time_of(stream):
            stream.token()
            return time.monotonic() - begin_s

        with futures.ThreadPoolExecutor(len(streams)) as threads:
            times_s = sorted(threads.map(time_of, streams))
        cpu_s = (second.cpu_s() - begin_cpu_s) / len(streams)
        for stream in streams:
            stream.close()
        return times_s, cpu_s


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--server", action="append", required=True, help="evpose-server; several are compared")
    parser.add_argument("--sessions", type=int, default=24)
    parser.add_argument("--busy", type=int, default=4, help="number of processes that compute")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--tenants", type=int, default=1, help="number of tenants, who have the sessions in turns")
    options = parser.parse_args()
    results = {program: [] for program in options.server}
    with tempfile.TemporaryDirectory() as code:
        api = (*load_api(code)[1:], importlib.import_module("evpose.v1.track_pb2"))
        for _ in range(options.runs):
            for program in options.server:
                with tempfile.TemporaryDirectory() as folder:
                    results[program].append(resume_times_s(program, options, api, folder))
    for program, runs in results.items():
        first, middle, last = (statistics.median(times_s[index] for times_s, _ in runs) for index in (0, options.sessions // 2, -1))
        cpu_ms = 1000 * statistics.median(cpu_s for _, cpu_s in runs)
        print(f"{program}: {options.sessions} streams of {options.tenants} tenants attached after {first:.3f} s (first), {middle:.3f} s (p50), "
              f"{last:.3f} s (last); {cpu_ms:.1f} ms of processor time per session; medians of {options.runs} runs, load of the machine {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()

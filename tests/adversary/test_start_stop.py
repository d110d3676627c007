#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Start and end of a server whose store or queue a client has filled."""

import time
import unittest

import server
from api import VGA, client, refusal
from camera import chunks
from hostile_models import CUBE, prism
from test_slow_work import hold, upload_cost
from test_time import create_with_most_objects, most_expensive_model


class StartTest(server.AdversaryTest):
    def test_a_start_prepares_no_model(self):
        running = self.serve("--model-cpu-seconds", "60", store="sqlite")
        api = client(self, running)
        cost_s = 0.0
        for i in range(5):
            cost_s += upload_cost(running, api, prism(800), metres_per_unit=0.1 + 0.01 * i)[0]
        model = api.models()[0].name
        num_models = len(api.models())
        running.kill()
        running.start()
        self.assertLess(running.cpu_s(), 0.25 * cost_s + 0.05)  # an empty server takes 0.03 s
        again = client(self, running)
        self.assertEqual(len(again.models()), num_models)
        again.create(model)

    def test_a_start_reads_no_session(self):
        running = self.serve("--max-sessions", "2000", "--max-session-memory", str(1 << 40), store="sqlite")
        api = client(self, running)
        model = api.upload(CUBE).name
        empty_s = self._start_cost_s(running)
        api = client(self, running)
        # Each has another lens, so that each needs a table of its own.
        cameras = [{**VGA, "fx_px": 600 + i, "distortion": [-0.1, 0.05, 0, 0, 0]} for i in range(50)]
        names = [api.create(model, camera=camera).session.name for camera in cameras]
        self.assertLess(self._start_cost_s(running), 10 * max(empty_s, 0.05))
        api = client(self, running)
        self.assertEqual(sorted(session.name for session in api("ListSessions", page_size=1000).sessions), sorted(names))

    def _start_cost_s(self, running):
        running.kill()
        running.start()
        return running.cpu_s()


def time_to_end_s(running):
    start = time.monotonic()
    status = running.terminate()
    if status != 0:
        raise AssertionError(f"status {status}")
    return time.monotonic() - start


class EndTest(server.AdversaryTest):
    def serve_a_silent_stream(self):
        """Starts a server whose shutdown takes its whole timeout of 1 s, because a stream does not end."""
        running = self.serve()
        api = client(self, running)
        return running, api, api.attach(api.create(api.upload(CUBE).name))[0]

    def test_the_end_waits_for_no_slow_work(self):
        alone_s = time_to_end_s(self.serve_a_silent_stream()[0])
        for is_cancelled, name in ((True, "cancelled uploads"), (False, "uploads under way")):
            with self.subTest(name):
                running, api, _ = self.serve_a_silent_stream()
                for stream in hold(running, api):
                    if is_cancelled:
                        stream.cancel()
                took_s = time_to_end_s(running)
                server.figures[f"SIGTERM to exit with {name}, --shutdown-timeout 1"] = (
                    f"{took_s:.1f} s (without uploads {alone_s:.1f} s)")
                self.assertLess(took_s, 2.5 * alone_s)

    def test_the_end_waits_for_no_expensive_session(self):
        """The first slice of each session takes seconds: a turn is paused in it, or has just begun."""
        alone_s = time_to_end_s(self.serve_a_silent_stream()[0])
        running, api, _ = self.serve_a_silent_stream()
        model = most_expensive_model(api)
        streams = []
        for _ in range(4):
            stream, _ = api.attach(create_with_most_objects(api, model))
            for seq, (_, payload) in enumerate(chunks(), 1):
                stream.send(events={"seq": seq, "payload": payload})
            streams.append(stream)
        num_turns = running.metric("evpose_turn_seconds_count")
        server.poll(lambda: running.metric("evpose_turn_seconds_count") > num_turns + 100, "turns of the expensive sessions")
        took_s = time_to_end_s(running)
        server.figures["SIGTERM to exit with expensive sessions, --shutdown-timeout 1"] = (
            f"{took_s:.1f} s (without them {alone_s:.1f} s)")
        # The server waits twice for checkpoints, which the slices in progress delay; without its remedy, it took 10 times as long.
        self.assertLess(took_s, 5 * alone_s)

    def test_the_end_tells_silent_streams(self):
        running, api, stream = self.serve_a_silent_stream()
        name = api("ListSessions").sessions[0].name
        watcher = api.watch("WatchPoses", session=name)
        self.assertEqual(running.terminate(), 0)
        self.assertEqual((stream.failure().code, refusal(list, watcher).code), ("UNAVAILABLE", "UNAVAILABLE"))


if __name__ == "__main__":
    unittest.main()

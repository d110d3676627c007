#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Names and numbers from clients: what is refused, and what of it reaches errors and the log."""

import unittest

import server
from api import FLAT64, VGA, client, refusal
from hostile_models import CUBE

ODD_NAMES = ["", ".", "..", "/", "sessions/", "sessions/../x", "sessions/\0", "sessions/%n%s", "sessions/' OR 1=1 --",
             "sessions/\u202eabc", "sessions/" + "a" * 10_000, "models/" + "f" * 64]


class NameTest(server.AdversaryTest):
    def test_odd_names_are_not_found(self):
        api = client(self, self.serve())
        for name in ODD_NAMES:
            for method in ("GetSession", "DeleteSession", "GetModel", "DeleteModel"):
                with self.subTest(method=method, name=name[:40]):
                    failure = refusal(api, method, name=name)
                    self.assertEqual(failure.code, "NOT_FOUND")
                    self.assertLess(len(failure.message), 400)
            self.assertEqual(refusal(lambda name=name: list(api.watch("WatchPoses", session=name))).code, "NOT_FOUND")

    def test_the_log_of_refused_attaches_is_bounded(self):
        running = self.serve()
        api = client(self, running)
        before = len(running.log())
        streams = [api.stream() for _ in range(300)]
        for stream in streams:
            stream.send(attach={"session": "sessions/" + "x" * 7000, "resume_token": "y" * 100})
        for stream in streams:
            self.assertEqual(stream.failure().reason, "SESSION_NOT_FOUND")
        self.assertLess(len(running.log()) - before, 300 * 100)

    def test_the_log_of_sessions_is_bounded(self):
        """A client that attaches again and again to its session, and one that creates and deletes sessions."""
        running = self.serve()
        api = client(self, running)
        model = api.upload(CUBE).name
        created = api.create(model)
        for _ in range(3000):
            stream, _ = api.attach(created)
            stream.cancel()
        for _ in range(2000):
            api("DeleteSession", name=api.create(model).session.name)
        log = running.log()
        for event, count in (("stream_ended", 3000), ("session_created", 2000), ("session_deleted", 2000)):
            with self.subTest(event):
                self.assertGreater(log.count(event), 0)
                self.assertLess(log.count(event), 0.8 * count)

    def test_object_ids_have_no_control_characters(self):
        api = client(self, self.serve())
        model = api.upload(CUBE).name

        def create(*ids):
            objects = [{"object_id": object_id, "model": model} for object_id in ids]
            return api("CreateSession", config={"encoding": FLAT64, "camera": VGA, "objects": objects})

        for object_id in ("", "a" * 65, "a\0b", "a\nb", "a\x1b[31mb", "a\u202eb", "a\x7fb", "a\u0085b"):
            with self.subTest(ascii(object_id)):
                self.assertEqual(refusal(create, object_id).code, "INVALID_ARGUMENT")
        self.assertEqual(refusal(create, "same", "same").code, "INVALID_ARGUMENT")
        self.assertEqual(refusal(create, *map(str, range(17))).code, "INVALID_ARGUMENT")
        create("cube", "a b")

    def test_odd_cameras_are_refused(self):
        api = client(self, self.serve())
        model = api.upload(CUBE).name
        nan, infinity = float("nan"), float("inf")
        for change in ({"width_px": 65536, "height_px": 1}, {"width_px": 10**9, "height_px": 10**9}, {"width_px": 4097},
                       {"fx_px": nan}, {"fy_px": infinity}, {"fx_px": 0}, {"fx_px": -1}, {"cx_px": nan}, {"cy_px": infinity},
                       {"fx_px": 1e-300}, {"fx_px": 1e300}, {"cx_px": 1e300}, {"cx_px": -1e300},
                       {"fx_px": 1e308, "fy_px": 5e-324}, {"distortion": [nan]}, {"distortion": [1e300, 0, 0, 0, 0]}):
            with self.subTest(str(change)):
                self.assertEqual(refusal(api.create, model, camera={**VGA, **change}).code, "INVALID_ARGUMENT")

    def test_odd_pages_are_refused(self):
        api = client(self, self.serve())
        for method in ("ListSessions", "ListModels"):
            for fields in ({"page_size": -1}, {"page_size": -(2**31)}, {"page_token": "x" * 5000}):
                self.assertEqual(refusal(api, method, **fields).code, "INVALID_ARGUMENT", fields)
            api(method, page_size=2**31 - 1)

    def test_sessions_beyond_the_limit_leave_no_trace(self):
        running = self.serve("--max-sessions", "4")
        api = client(self, running)
        model = api.upload(CUBE).name
        api.create_until_refused(model)
        log, resident = len(running.log()), running.resident_bytes()
        for _ in range(1000):
            self.assertEqual(refusal(api.create, model).reason, "TOO_MANY_SESSIONS")
        self.assertLess(len(running.log()) - log, 100_000)
        self.assertLess(running.resident_bytes() - resident, 50 << 20)


if __name__ == "__main__":
    unittest.main()

#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Uploads under way: they hold what has arrived, are counted, and end."""

import threading
import unittest

import grpc

import server
from api import OBJ, client, failure_of, refusal
from hostile_models import CUBE, padded_cube


def open_upload(api, size_bytes):
    stream = api.start_upload()
    stream.send(header={"format": OBJ, "size_bytes": size_bytes})
    return stream


def end_of(stream):
    """Waits for the end of an upload, and returns its Failure."""
    return failure_of(stream.call.exception(timeout=server.PATIENCE_S))


def reason_of_header(api, size_bytes):
    """Returns the reason for which the header of an upload is refused. An upload that was accepted and has no data is refused without
    one."""
    stream = open_upload(api, size_bytes)
    stream.finish()
    return end_of(stream).reason


class UploadTest(server.AdversaryTest):
    def test_headers_reserve_nothing(self):
        running = self.serve("--max-uploads", "100")
        mallory, alice = client(self, running), client(self, running)
        streams = [open_upload(mallory, 64 << 20) for _ in range(10)]  # more than the 512 MiB of the store
        for number in range(5):  # also after the server has read all headers
            alice.upload(padded_cube(1 << 20, number))
        self.assertFalse(any(stream.call.done() for stream in streams))

    def test_the_store_is_full_of_what_has_arrived_only(self):
        running = self.serve("--max-model-store-bytes", str(4 << 20), "--max-model-bytes", str(2 << 20))
        api = client(self, running)
        streams = [open_upload(api, 2 << 20) for _ in range(3)]
        for stream in streams:
            stream.send(chunk=padded_cube(1 << 20, 2))
        # The server accepts the header of an upload if its model has room beside what has arrived.
        server.poll(lambda: reason_of_header(api, (1 << 20) + 1) == "MODEL_STORE_FULL", "three MiB that have arrived")
        accepted = 0
        with self.assertRaises(grpc.RpcError) as caught:
            for number in range(10):
                api.upload(padded_cube(1 << 19, number))
                accepted += 1
        self.assertEqual(failure_of(caught.exception).reason, "MODEL_STORE_FULL")
        self.assertIn(accepted, (1, 2))  # 1 MiB is left, of which a model also takes what is derived from it

    def test_uploads_are_counted(self):
        running = self.serve("--max-uploads", "4")
        api = client(self, running)
        streams = [open_upload(api, 1000) for _ in range(20)]
        ended = server.poll(lambda: [stream for stream in streams if stream.call.done()], "a refused upload")
        server.poll(lambda: sum(stream.call.done() for stream in streams) == 16, "16 refused uploads")
        self.assertEqual((end_of(ended[0]).code, end_of(ended[0]).reason), ("RESOURCE_EXHAUSTED", "TOO_MANY_UPLOADS"))
        for stream in streams:
            stream.cancel()
        server.poll(lambda: self._try_upload(api), "an upload after the others were cancelled")

    def _try_upload(self, api):
        """Returns the Model, or None if there are too many uploads."""
        try:
            return api.upload(CUBE)
        except grpc.RpcError as error:
            self.assertEqual(failure_of(error).reason, "TOO_MANY_UPLOADS")
            return None

    def test_a_tenant_has_half_of_the_uploads(self):
        running = self.serve("--max-uploads", "8", tenants=("alice", "mallory"))
        mallory, alice = client(self, running, "mallory"), client(self, running, "alice")
        streams = [open_upload(mallory, 1000) for _ in range(20)]
        server.poll(lambda: sum(stream.call.done() for stream in streams) == 16, "16 refused uploads")
        alice.upload(CUBE)

    def test_an_upload_ends_although_a_byte_comes_now_and_then(self):
        running = self.serve("--upload-timeout", "1", "--attach-timeout", "60")
        stream = open_upload(client(self, running), 1 << 20)
        is_ended = threading.Event()
        stream.call.add_done_callback(lambda _: is_ended.set())
        for _ in range(int(server.PATIENCE_S / 0.05)):
            stream.send(chunk=b"#")
            if is_ended.wait(0.05):  # the pace of the adversary
                break
        self.assertTrue(is_ended.is_set(), "the upload goes on while bytes come")
        failure = end_of(stream)
        self.assertEqual((failure.code, failure.reason), ("DEADLINE_EXCEEDED", "UPLOAD_TIMEOUT"))

    def test_messages_out_of_order_are_refused(self):
        api = client(self, self.serve())

        def lie(*messages):
            stream = api.start_upload()
            for message in messages:
                stream.send(**message)
            stream.finish()
            return end_of(stream)

        header = {"header": {"format": OBJ, "size_bytes": len(CUBE)}}
        for messages in ([{"chunk": CUBE}], [{}], [header, header], [header, {"chunk": CUBE + b"#"}], [header],
                         [header, {"chunk": CUBE[:9]}], []):
            self.assertEqual(lie(*messages).code, "INVALID_ARGUMENT", messages)


class StoreSizeTest(server.AdversaryTest):
    def test_the_log_of_sqlite_counts(self):
        limit = 4 << 20
        running = self.serve("--store-max-bytes", str(limit), store="sqlite")
        api = client(self, running)
        for number in range(40):
            api("DeleteModel", name=api.upload(padded_cube(300_000, number)).name)
        files = [path.stat().st_size for path in (self.directory / "data").rglob("*") if path.is_file()]
        self.assertLess(sum(files), 2 * limit, files)

    @unittest.skipUnless(server.CAN_MOUNT, "user namespaces, in which a file system can be mounted, are not permitted here")
    def test_a_full_disk_has_room_again(self):
        """The log of SQLite, which may grow to 64 MiB, must not hold the space that deleted models had."""
        running = self.serve("--store-max-bytes", str(2 << 20), store="sqlite", disk_bytes=6 << 20)
        api = client(self, running)
        names = []
        with self.assertRaises(grpc.RpcError) as caught:
            for number in range(100):
                names.append(api.upload(padded_cube(300_000, number)).name)
        self.assertEqual(failure_of(caught.exception).reason, "STORE_FULL")
        for name in names:
            api("DeleteModel", name=name)
        for number in range(1000, 1020):  # together more than the disk holds
            api("DeleteModel", name=api.upload(padded_cube(300_000, number)).name)
        self.assertEqual(refusal(api, "GetModel", name=names[0]).reason, "MODEL_NOT_FOUND")


if __name__ == "__main__":
    unittest.main()

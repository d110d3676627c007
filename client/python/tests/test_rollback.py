#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Tests of Track after the server's store has lost its last writes: the server requests chunks again that it had reported as durable."""

import threading
import unittest

import grpc
from scripted_server import Fail, ScriptedServer, ack, attached, pose, summary
from testing import evpose

from evpose.stream.outbox import FeedPoint, make_chunk

A, B, C = (bytes([i]) * 16 for i in (1, 2, 3))
UNAVAILABLE = Fail(grpc.StatusCode.UNAVAILABLE, "DRAINING")


class RollbackTest(unittest.TestCase):
    def serve(self, *scripts):
        scripted = ScriptedServer(*scripts)
        self.addCleanup(lambda: self.assertEqual(scripted.failures, []))
        self.addCleanup(scripted.stop)
        return scripted

    def test_a_server_that_asks_for_a_durable_chunk_has_lost_it(self):
        def first(stream):
            stream.read("attach")
            yield attached()
            stream.read("events")
            yield ack(1)
            raise UNAVAILABLE

        def second(stream):
            stream.read("attach")
            yield attached(next_seq=1)
            stream.read("end")

        def third(stream):
            assert stream.read("attach").first_seq == 2
            raise Fail(grpc.StatusCode.DATA_LOSS, "ROLLED_BACK")
            yield

        scripted = self.serve(first, second, third)
        with self.assertRaises(evpose.DataLossError) as caught:
            scripted.track([A, B], retain=evpose.RetainOptions(duration_s=0.0)).read_all()
        self.assertEqual(caught.exception.reason, "ROLLED_BACK")

    def test_a_store_that_lost_durable_chunks_receives_them_again(self):
        def first(stream):
            assert stream.read("attach").first_seq == 1
            yield attached()
            for _ in range(3):
                stream.read("events")
            yield pose(1)
            yield ack(3)
            raise UNAVAILABLE

        def second(stream):
            assert stream.read("attach").first_seq == 1
            yield attached(next_seq=2)
            assert [stream.read("events").payload for _ in range(2)] == [B, C]
            for seq in (1, 2, 3):
                yield pose(seq)
            stream.read("end")
            yield summary(3)

        self.assertEqual([each.seq for each in self.serve(first, second).track([A, B, C])], [1, 2, 3])

    def test_a_continued_stream_has_the_chunks_before_its_position(self):
        is_attached = threading.Event()  # the source has no chunk before, so that the first chunk is not known at the attach

        def source():
            is_attached.wait()
            yield from (A, B, C)

        def takes_the_second(stream):
            assert stream.read("attach").first_seq == 0
            is_attached.set()
            yield attached(next_seq=2)
            assert [stream.read("events").payload for _ in range(2)] == [B, C]
            stream.read("end")
            yield summary(0)

        def takes_the_first(stream):
            assert stream.read("attach").first_seq == 0
            is_attached.set()
            yield attached(next_seq=1)
            stream.read("end")

        def is_told(stream):
            assert stream.read("attach").first_seq == 2
            raise Fail(grpc.StatusCode.DATA_LOSS, "ROLLED_BACK")
            yield

        durable = make_chunk(make_chunk(FeedPoint(), A).end, B).end
        position = evpose.TrackPosition("sessions/1", "token0", durable=durable, max_piece_bytes=16)
        retain = evpose.RetainOptions(max_bytes=16 + 512)
        self.assertEqual(list(self.serve(takes_the_second).track(source(), position, retain=retain)), [])
        is_attached.clear()
        scripted = self.serve(takes_the_first, is_told)
        with self.assertRaises(evpose.DataLossError) as caught:
            scripted.track(source(), position, retain=retain).read_all()
        self.assertEqual(caught.exception.reason, "ROLLED_BACK")

    def test_a_store_that_lost_several_attaches_knows_an_old_token(self):
        def cuts(token):
            def script(stream):
                stream.read("attach")
                yield attached(token=token)
                raise UNAVAILABLE
            return script

        tokens = []

        def refuses(stream):
            tokens.append(stream.read("attach").resume_token)
            raise Fail(grpc.StatusCode.PERMISSION_DENIED, "WRONG_TOKEN")
            yield

        def takes(stream):
            tokens.append(stream.read("attach").resume_token)
            yield attached()
            stream.read("end")
            yield summary(0)

        scripts = [cuts(f"T{i}") for i in (1, 2, 3)] + [refuses] * 3 + [takes]
        self.assertEqual(list(self.serve(*scripts).track([])), [])
        self.assertEqual(tokens, ["T3", "T2", "T1", "token0"])


if __name__ == "__main__":
    unittest.main()

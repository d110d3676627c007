#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The stream against a server that runs a script: credit, retained chunks, resumption, violations of the protocol."""

import hashlib
import threading
import unittest

import crc32c
import grpc
from scripted_server import Fail, ScriptedServer, ack, attached, notice, pose, summary
from testing import Balancer, evpose, server

A, B, C = (bytes([i]) * 16 for i in (1, 2, 3))
UNAVAILABLE = Fail(grpc.StatusCode.UNAVAILABLE, "DRAINING")


def whole(stream):
    """The script of an undisturbed stream of three chunks with a pose each."""
    stream.read("attach")
    yield attached()
    for seq, payload in enumerate((A, B, C), 1):
        chunk = stream.read("events")
        assert (chunk.seq, chunk.payload, chunk.crc32c) == (seq, payload, crc32c.crc32c(payload)), chunk
        yield pose(seq)
        yield ack(seq)
    stream.read("end")
    yield summary(3)


class StreamTest(unittest.TestCase):
    def serve(self, *scripts):
        scripted = ScriptedServer(*scripts)
        self.addCleanup(lambda: self.assertEqual(scripted.failures, []))
        self.addCleanup(scripted.stop)
        return scripted

    def fails(self, error, script, source=(A,), **options):
        with self.assertRaises(error) as caught:
            self.serve(script).track(source, **options).read_all()
        return str(caught.exception)


class OrderTest(StreamTest):
    def test_an_undisturbed_stream(self):
        track = self.serve(whole).track([A, B, C])
        self.assertEqual([(each.seq, each.t_us, each.object_id) for each in track], [(i, 1000 * i, "object") for i in (1, 2, 3)])
        summary_ = track.summary
        self.assertEqual((summary_.sent_bytes, summary_.sent_chunks, summary_.poses, summary_.lost_poses), (48, 3, 3, 0))

    def test_chunks_are_divided_and_marked(self):
        def script(stream):
            stream.read("attach")
            yield attached(max_chunk_bytes=19)
            chunks = [stream.read("events") for _ in range(4)]
            assert [chunk.payload for chunk in chunks] == [A, A, B, C], chunks
            assert [chunk.discontinuity for chunk in chunks] == [False, False, True, False]
            reset = stream.read("reset_pose")
            assert (reset.seq, reset.object_id, reset.camera_from_object.translation_m.z) == (5, "object", 2.0), reset
            assert stream.read("events").seq == 6
            stream.read("end")
            yield summary(0)

        reset = evpose.PoseReset(evpose.Transform.from_quaternion([0, 0, 2], [0, 0, 0, 1]))
        self.serve(script).track([A + A, evpose.Discontinuity(), B, bytearray(C), reset, memoryview(C)]).read_all()

    def test_a_reset_by_the_caller(self):
        has_reset = threading.Event()

        def script(stream):
            stream.read("attach")
            yield attached()
            assert stream.read("events").seq == 1
            yield pose(1)
            assert stream.read("reset_pose").seq == 2
            assert stream.read("events").seq == 3
            stream.read("end")
            yield summary(1)

        def source():
            yield A
            has_reset.wait()
            yield B

        track = self.serve(script).track(source())
        reset = evpose.PoseReset(evpose.Transform.from_quaternion([0, 0, 2], [0, 0, 0, 1]))
        self.assertEqual(next(track).seq, 1)
        track.reset_pose(reset)
        has_reset.set()
        self.assertEqual(list(track), [])
        with self.assertRaises(evpose.InvalidArgumentError):
            track.reset_pose(evpose.PoseReset(reset.camera_from_object, "other"))
        with self.assertRaises(evpose.FailedPreconditionError):
            track.reset_pose(reset)

    def test_no_more_than_the_credit_is_sent(self):
        def script(stream):
            stream.read("attach")
            yield attached(limit=40, idle_timeout={"nanos": 60_000_000})
            assert [stream.read("events").seq for _ in range(2)] == [1, 2]
            stream.read("empty")  # the third chunk would exceed the credit: the client only says that it is alive
            yield ack(1, limit=47)
            stream.read("empty")
            yield ack(2, limit=48)
            assert stream.read("events").seq == 3
            stream.read("end")
            yield summary(0)

        self.serve(script).track([A, B, C]).read_all()

    def test_a_live_source_is_read_while_the_server_takes_nothing(self):
        is_read = threading.Event()
        chunk = bytes(65536)

        def source():
            for _ in range(48):  # three times what is read ahead otherwise
                yield chunk
            is_read.set()

        def script(stream):
            stream.read("attach")
            yield attached(limit=0)
            assert is_read.wait(server.PATIENCE_S)
            yield ack(0, limit=48 * len(chunk))
            for seq in range(1, 49):
                assert stream.read("events").seq == seq
            stream.read("end")
            yield summary(0)

        track = self.serve(script).track(source(), is_live=True)
        self.assertEqual(list(track), [])
        self.assertEqual(track.summary.sent_bytes, 48 * len(chunk))

    def test_a_server_without_credit_is_lost(self):
        def script(stream):
            stream.read("attach")
            yield attached(limit=0)
            stream.wait_until_left()

        scripted = self.serve(script)
        with self.assertRaises(evpose.DeadlineExceededError) as caught:
            scripted.track([A], retry=evpose.RetryOptions(max_outage_s=0.2)).read_all()
        self.assertIn("no credit for 0.2 s", str(caught.exception))


class ResumptionTest(StreamTest):
    def test_chunks_are_sent_again_and_poses_are_not_delivered_twice(self):
        def first(stream):
            stream.read("attach")
            yield attached(token="token1")
            assert [stream.read("events").seq for _ in range(3)] == [1, 2, 3]
            yield pose(1)
            yield pose(2)
            yield ack(2, durable=1)
            raise UNAVAILABLE

        def second(stream):
            attach = stream.read("attach")
            assert (attach.resume_token, attach.last_pose_seq) == ("token1", 2), attach
            yield attached(next_seq=2, first_pose=2, token="token2")
            chunks = [stream.read("events") for _ in range(2)]
            assert [(chunk.seq, chunk.payload) for chunk in chunks] == [(2, B), (3, C)], chunks
            for seq in (2, 3):
                yield pose(seq)
            stream.read("end")
            yield summary(3)

        changes = []
        scripted = self.serve(first, second)
        track = scripted.track([A, B, C], on_connection=changes.append)
        self.assertEqual([each.seq for each in track], [1, 2, 3])
        self.assertEqual([(each.is_disconnected, getattr(each.cause, "reason", "")) for each in changes], [(True, "DRAINING"), (False, "")])
        self.assertEqual(changes[0].kept_bytes, 32)
        # The server and the callbacks have the same IDs.
        trace_id = hashlib.sha256(b"sessions/1").hexdigest()[:32]
        self.assertEqual([each.trace.trace_id for each in changes], [trace_id] * 2)
        self.assertEqual(scripted.traceparents, [f"00-{trace_id}-{each.trace.span_id}-01" for each in changes])
        self.assertNotEqual(changes[0].trace, changes[1].trace)
        self.assertEqual(track.summary.trace, changes[1].trace)
        self.assertEqual(len(scripted.clock.waits), 1)
        self.assertEqual((track.position.resume_token, track.position.previous_token), ("token2", "token1"))

    def test_a_lost_answer_to_attach(self):
        def refuses(stream):
            assert stream.read("attach").resume_token == "token1"
            raise Fail(grpc.StatusCode.PERMISSION_DENIED, "WRONG_TOKEN")
            yield

        def takes_the_previous(stream):
            assert stream.read("attach").resume_token == "token0"
            yield from summary_at_once(stream)

        position = evpose.TrackPosition("sessions/1", "token1", "token0")
        self.assertEqual(list(self.serve(refuses, takes_the_previous).track([], position)), [])
        self.assertEqual(position, evpose.TrackPosition("sessions/1", "token1", "token0"))  # the caller's stays as it was

    def test_a_server_that_restarted_before_its_poses_were_stored(self):
        def refuses(stream):
            assert stream.read("attach").last_pose_seq == 9
            raise Fail(grpc.StatusCode.INVALID_ARGUMENT, field="attach.last_pose_seq")
            yield

        def computes_again(stream):
            assert stream.read("attach").last_pose_seq == 0
            yield attached(first_pose=9)
            stream.read("end")
            for seq in (9, 10):
                yield pose(seq)
            yield summary(10)

        position = evpose.TrackPosition("sessions/1", "token", last_pose_seq=9)
        self.assertEqual([each.seq for each in self.serve(refuses, computes_again).track([], position)], [10])

    def test_poses_of_a_new_search_replace_those_that_were_not_stored(self):
        for after_pose_seq, expected in ((7, [8, 9, 10]), (None, [10])):
            def searches_again(stream):
                assert stream.read("attach").last_pose_seq == 9
                yield attached(first_pose=8)
                yield notice(tracking_restarted=dict(after_seq=1, after_pose_seq=after_pose_seq))
                stream.read("end")
                for seq in (8, 9, 10):
                    yield pose(seq)
                yield summary(10)

            notices = []
            position = evpose.TrackPosition("sessions/1", "token", last_pose_seq=9)
            track = self.serve(searches_again).track([], position, on_notice=notices.append)
            self.assertEqual([each.seq for each in track], expected)
            self.assertEqual(notices, [evpose.TrackingRestarted(1, "", after_pose_seq)])

    def test_poses_that_are_no_longer_stored_are_reported(self):
        def script(stream):
            stream.read("attach")
            yield attached(first_pose=4)
            stream.read("end")
            yield pose(4)
            yield summary(4)

        notices = []
        track = self.serve(script).track([], on_notice=notices.append)
        self.assertEqual([each.seq for each in track], [4])
        self.assertEqual(notices, [evpose.PosesLost(1, 3)])
        self.assertEqual((track.summary.poses, track.summary.lost_poses), (1, 3))

    def test_triggers_are_passed_on_with_their_times(self):
        def script(stream):
            stream.read("attach")
            yield attached()
            yield notice(triggers={"seq": 3, "triggers": [{"t_us": 16_000_001, "input": 6, "rising": True}], "num_skipped": 2})
            stream.read("end")
            yield summary(0)

        notices = []
        self.assertEqual(list(self.serve(script).track([], on_notice=notices.append)), [])
        self.assertEqual(notices, [evpose.Triggers(3, (evpose.Trigger(16_000_001, 6, True),), 2)])

    def test_a_server_that_shuts_down_is_left(self):
        def leaves(stream):
            stream.read("attach")
            yield attached()
            stream.read("events")
            yield notice(go_away={"deadline": {"seconds": 5}})
            try:
                while True:
                    stream.read("events")
            except StopIteration:  # the client has ended its half of the stream
                return

        def second(stream):
            stream.read("attach")
            yield attached(next_seq=2)
            assert stream.read("events").payload == B
            stream.read("end")
            yield summary(0)

        has_left = threading.Event()

        def source():
            yield A
            has_left.wait()
            yield B

        notices = []
        scripted = self.serve(leaves, second)
        track = scripted.track(source(), on_notice=notices.append, on_connection=lambda _: has_left.set())
        self.assertEqual(list(track), [])
        self.assertEqual(notices, [evpose.GoAway(5.0)])
        self.assertEqual(scripted.clock.waits, [0.0])

    def test_another_process_continues_with_the_same_events_only(self):
        def first(stream):
            stream.read("attach")
            yield attached()
            assert [stream.read("events").seq for _ in range(2)] == [1, 2]
            yield ack(2)
            raise Fail(grpc.StatusCode.ABORTED, "FENCED")

        positions = []
        with self.assertRaises(evpose.AbortedError) as caught:
            self.serve(first).track([A, B, C], on_position=lambda position, _: positions.append(position.to_json())).read_all()
        self.assertEqual(caught.exception.reason, "FENCED")
        position = evpose.TrackPosition.from_json(positions[-1])
        self.assertEqual((position.durable.seq, position.durable.bytes), (2, 32))

        def second(stream):
            stream.read("attach")
            yield attached(next_seq=3)
            assert stream.read("events").payload == C
            stream.read("end")
            yield summary(0)

        self.assertEqual(list(self.serve(second).track([A, B, C], position)), [])

        def third(stream):
            stream.read("attach")
            yield attached(next_seq=3)
            stream.wait_until_left()

        for source, words in (([A, A, C], "first 32 bytes differ"), ([A], "the events end after 16 bytes")):
            scripted = self.serve(third)
            with self.assertRaises(evpose.FailedPreconditionError) as refused:
                scripted.track(source, evpose.TrackPosition.from_json(positions[-1])).read_all()
            self.assertIn(words, str(refused.exception))

    def test_outages_end_after_the_limit(self):
        def breaks(stream):
            stream.read("attach")
            raise Fail(grpc.StatusCode.UNAVAILABLE)
            yield

        scripted = self.serve(*[breaks] * 40)
        with self.assertRaises(evpose.UnavailableError) as caught:
            scripted.track([A], retry=evpose.RetryOptions(max_outage_s=20.0)).read_all()
        self.assertRegex(str(caught.exception), r"from the script .after 0 bytes sent, 0 poses received.; gave up after \d+ more tries in "
                         r"[0-9.]+ s; trace_id=[0-9a-f]{32} span_id=[0-9a-f]{16}$")
        self.assertLessEqual(sum(scripted.clock.waits), 20.0)
        self.assertGreater(sum(scripted.clock.waits), 10.0)
        with self.assertRaises(evpose.UnavailableError):
            self.serve(breaks).track([A], retry=evpose.RetryOptions(max_outage_s=0.0)).read_all()

    def test_full_servers_are_tried_again_after_their_delay(self):
        refuses = refusal("TOO_MANY_STREAMS")
        for num_servers, waits in ((1, [7.0, 7.0]), (2, [0.0, 7.0])):
            scripted = self.serve(refuses, refuses, accepts)
            self.assertEqual(list(scripted.track([], num_servers=num_servers)), [])
            self.assertEqual(scripted.clock.waits, waits)

    def test_a_refused_stream_attaches_at_the_server_of_a_new_connection(self):
        at_quota, free = self.serve(refusal("TENANT_QUOTA")), self.serve(accepts)
        balancer = Balancer(at_quota.address, free.address)
        self.addCleanup(balancer.close)
        self.assertEqual(list(at_quota.track([], address=balancer.address)), [])
        self.assertEqual(at_quota.clock.waits, [7.0])

    def test_every_server_is_asked_for_the_session(self):
        def has_not(stream):
            stream.read("attach")
            raise Fail(grpc.StatusCode.NOT_FOUND, "SESSION_NOT_FOUND")
            yield

        def has_it(stream):
            stream.read("attach")
            yield from summary_at_once(stream)

        self.assertEqual(list(self.serve(has_not, has_it).track([], num_servers=2)), [])
        with self.assertRaises(evpose.NotFoundError) as caught:
            self.serve(has_not, has_not).track([], num_servers=2).read_all()
        self.assertEqual(caught.exception.reason, "SESSION_NOT_FOUND")


def summary_at_once(stream):
    yield attached()
    stream.read("end")
    yield summary(0)


def accepts(stream):
    """A stream without events that attaches and ends."""
    stream.read("attach")
    yield from summary_at_once(stream)


def refusal(reason):
    """A stream that is refused with this reason when it attaches."""
    def refuses(stream):
        stream.read("attach")
        raise Fail(grpc.StatusCode.RESOURCE_EXHAUSTED, reason, retry_in_s=7)
        yield
    return refuses


class ViolationTest(StreamTest):
    def responses(self, *responses):
        def script(stream):
            stream.read("attach")
            yield from responses

        return self.fails(evpose.InternalError, script)

    def test_violations_are_final(self):
        for responses, words in (
                ([pose(1)], "its first message is not `attached`"), ([attached(next_seq=0)], "it expects chunk 0"),
                ([attached(first_pose=0)], "it begins with pose 0"), ([attached(max_chunk_bytes=7)], "no room for a single word"),
                ([attached(), attached()], "`attached` twice"), ([attached(), pose(2)], "pose 2 arrived instead of pose 1"),
                ([attached(), pose(1, object_id="other")], "no object 'other'"),
                ([attached(), pose(1), pose(2, t_us=1000)], "its time, 1000 us, is not after 1000 us"),
                ([attached(), pose(1, covariance={"upper_triangle": [1.0]})], "covariance does not have 21 numbers"),
                ([attached(), pose(1, camera_from_object={"rotation": {"w": 2.0}})], "not a unit quaternion"),
                ([attached(), pose(1, state=4)], "LOST has no pose"), ([attached(), summary(1)], "the summary counts 1 poses"),
                ([attached(), summary(0), ack(1)], "a message follows the summary"), ([attached()], "without a summary"),
                ([attached(), ack(2)], "it acknowledges chunk 2, but the last one sent is"),
                ([attached(next_seq=2), ack(1), ack(0, durable=1)], "it has stored chunk 1, but processed only those up to 0")):
            with self.subTest(words):
                self.assertIn(words, self.responses(*responses))

    def test_what_a_later_server_sends_is_ignored(self):
        def script(stream):
            stream.read("attach")
            yield attached()
            yield notice()
            yield pose(1, state=77)
            stream.read("events")
            stream.read("end")
            yield summary(1)

        self.assertEqual(len(self.serve(script).track([A]).read_all()), 0)

    def test_a_source_that_fails_is_raised(self):
        def script(stream):
            stream.read("attach")
            yield attached()
            stream.read("events")
            yield ack(1)
            stream.wait_until_left()

        def source():
            yield A
            raise ZeroDivisionError("of the source")

        with self.assertRaisesRegex(ZeroDivisionError, "of the source"):
            self.serve(script).track(source()).read_all()
        for item, words in ((A[:7], "7 bytes are not whole words of FLAT64"), (3, "not int")):
            with self.assertRaises(evpose.InvalidArgumentError) as caught:
                self.serve(script).track([A, item]).read_all()
            self.assertIn(words, str(caught.exception))

    def test_close_ends_a_stream_and_its_thread(self):
        def script(stream):
            stream.read("attach")
            yield attached()
            yield pose(1)
            yield notice(lag_change={"falls_behind": True})
            stream.wait_until_left()

        waits, reads = threading.Event(), threading.Event()
        self.addCleanup(waits.set)

        def source():
            waits.wait()
            yield A

        scripted = self.serve(script)
        track = scripted.track(source(), on_notice=lambda _: reads.set())
        self.assertEqual(next(track).seq, 1)
        errors = []

        def read():
            try:
                track.read_all()
            except evpose.EvposeError as error:
                errors.append(error)

        reader = threading.Thread(target=read)
        reader.start()
        reads.wait()
        track.close()
        reader.join()
        self.assertEqual([type(error) for error in errors], [evpose.CancelledError])


if __name__ == "__main__":
    unittest.main()

# SPDX-License-Identifier: Apache-2.0
"""A server in this process that runs a script of the test for each Track stream."""

from concurrent import futures

import grpc
from testing import evpose, server

from evpose.channel import Endpoint, TokenSource
from evpose.rpc import error_details_pb2, status_pb2
from evpose.stream.attempt import TRACK, TrackPosition
from evpose.stream.feed import EventFeed
from evpose.stream.servers import Servers
from evpose.stream.track import Track
from evpose.v1 import session_pb2, track_pb2

IDENTITY = {"translation_m": {"z": 1.0}, "rotation": {"w": 1.0}}


class Fail(Exception):
    """Ends a stream with a status."""

    def __init__(self, code, reason="", field="", retry_in_s=0):
        super().__init__(code)
        self.code, self.reason, self.field, self.retry_in_s = code, reason, field, retry_in_s

    def apply(self, context):
        details = status_pb2.Status(code=self.code.value[0])
        if self.reason:
            details.details.add(type_url="type.googleapis.com/google.rpc.ErrorInfo",
                                value=error_details_pb2.ErrorInfo(reason=self.reason).SerializeToString())
        if self.field:
            bad = error_details_pb2.BadRequest(field_violations=[{"field": self.field, "description": "is wrong"}])
            details.details.add(type_url="type.googleapis.com/google.rpc.BadRequest", value=bad.SerializeToString())
        if self.retry_in_s:
            retry = error_details_pb2.RetryInfo(retry_delay={"seconds": self.retry_in_s})
            details.details.add(type_url="type.googleapis.com/google.rpc.RetryInfo", value=retry.SerializeToString())
        context.set_trailing_metadata([("grpc-status-details-bin", details.SerializeToString())])
        context.abort(self.code, "from the script")


class Stream:
    """One stream, as its script sees it. `send` of a script is `yield`."""

    def __init__(self, requests):
        self._requests = requests

    def read(self, kind):
        """Returns the next message, which must be of this kind. Empty chunks, which mean that the client is alive, are left out."""
        while True:
            request = next(self._requests)
            found = request.WhichOneof("message")
            if found != "events" or request.events.seq or kind == "empty":
                break
        if kind == "empty":
            assert found == "events" and not request.events.ByteSize(), request
            return None
        assert found == kind, (found, kind)
        return getattr(request, found)

    def wait_until_left(self):
        """Returns when the client has left the stream. Any message before is a failure."""
        try:
            self.read("end")
        except StopIteration:
            return
        raise AssertionError("the client ends the events instead of leaving")


def attached(next_seq=1, limit=1 << 20, first_pose=1, token="", **more):
    return track_pb2.TrackResponse(attached={"next_seq": next_seq, "send_limit_bytes": limit, "first_pose_seq": first_pose,
                                             "resume_token": token, "max_chunk_bytes": 1 << 20, **more})


def ack(processed, durable=None, limit=1 << 20):
    return track_pb2.TrackResponse(ack={"processed_seq": processed, "durable_seq": processed if durable is None else durable,
                                        "send_limit_bytes": limit})


def pose(seq, **changes):
    message = session_pb2.Pose(pose_seq=seq, object_id="object", t_us=1000 * seq, camera_from_object=IDENTITY, twist={},
                               state=session_pb2.TRACK_STATE_TRACKING, covariance={"upper_triangle": range(21)})
    message.MergeFrom(session_pb2.Pose(**changes))
    return track_pb2.TrackResponse(pose=message)


def notice(**kind):
    return track_pb2.TrackResponse(notice=kind)


def summary(poses):
    return track_pb2.TrackResponse(summary={"health": {"poses": poses}})


class FakeClock:
    """Waits for nothing, and remembers for how long it should have."""

    def __init__(self):
        self.time = 0.0
        self.waits = []

    def now(self):
        return self.time

    def wait(self, seconds, stop):
        self.waits.append(seconds)
        self.time += seconds
        return not stop.is_set()


class ScriptedServer:
    """Runs one script of `scripts` for each stream: a function of a Stream that yields responses and may raise Fail. Errors of a
    script are in `failures`."""

    def __init__(self, *scripts):
        self._scripts = list(scripts)
        self.failures = []
        self.traceparents = []  # of the streams so far
        handler = grpc.stream_stream_rpc_method_handler(
            self._track, track_pb2.TrackRequest.FromString, track_pb2.TrackResponse.SerializeToString)
        service, method = TRACK.strip("/").split("/")
        self._server = grpc.server(futures.ThreadPoolExecutor(4))
        self._server.add_generic_rpc_handlers([grpc.method_handlers_generic_handler(service, {method: handler})])
        self.address = f"127.0.0.1:{self._server.add_insecure_port('127.0.0.1:0')}"
        self._server.start()
        self.clock = FakeClock()
        self.endpoint = None

    def _track(self, requests, context):
        script = self._scripts.pop(0)
        self.traceparents += [value for key, value in context.invocation_metadata() if key == "traceparent"]
        try:
            yield from script(Stream(requests))
        except Fail as fail:
            fail.apply(context)
        except StopIteration:
            self.failures.append("the client has ended the stream")
        except AssertionError as error:
            self.failures.append(repr(error))

    def track(self, source, position=None, num_servers=1, token=None, outlives=True, address=None, **options):
        """Starts a Track of the session sessions/1 with object "object", in FLAT64, at this server, or at `address`."""
        options.setdefault("retry", evpose.RetryOptions(max_outage_s=server.PATIENCE_S))
        options = evpose.TrackOptions(**options)
        position = position or TrackPosition("sessions/1", "token0")
        self.endpoint = Endpoint.open(address or self.address, None, TokenSource(token))
        feed = EventFeed(source, evpose.Encoding.FLAT64, (640, 480), options.memory_bytes, options.is_live, position.durable,
                         options.retain, self.clock.now)
        if position.max_piece_bytes:
            feed.start(position.max_piece_bytes)
        servers = Servers([self.endpoint] * num_servers, outlives)
        return Track(servers, ["object"], position, feed, options, self.clock)

    def stop(self):
        if self.endpoint is not None:
            self.endpoint.close()
        self._server.stop(None).wait()

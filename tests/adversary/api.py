# SPDX-License-Identifier: Apache-2.0
"""The API evpose.v1 as a hostile client sees it: any message, any order, with the details of each error.

The messages and methods are made from proto/ when a test starts, so no code is generated.
"""

import collections
import hashlib
import itertools
import queue
import subprocess

import grpc
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

import server

FLAT64 = 5
EVT3 = 1
OBJ, MESH = 1, 4
VGA = {"width_px": 640, "height_px": 480, "fx_px": 600, "fy_px": 600, "cx_px": 320, "cy_px": 240}
LARGEST = {"width_px": 4096, "height_px": 4096, "fx_px": 3000, "fy_px": 3000, "cx_px": 2048, "cy_px": 2048}

# Lenses of other models than Brown's, as fields of a camera.
RATIONAL_LENS = {"lens_model": 2, "distortion": [0.1, -0.05, 0.0005, 0.0005, 0.01, 0.05, 0.01, 0.001]}
FISHEYE_LENS = {"lens_model": 3, "distortion": [0.02, -0.005, 0.001, 0.0]}

_PROTOS = ["evpose/v1/admin_service.proto", "evpose/v1/mesh.proto", "evpose/v1/model_service.proto", "evpose/v1/session_service.proto",
           "google/rpc/error_details.proto", "google/rpc/status.proto", "grpc/health/v1/health.proto"]
_files = descriptor_pb2.FileDescriptorSet.FromString(subprocess.run(
    ["protoc", "-I", ".", "--include_imports", "--descriptor_set_out=/dev/stdout", *_PROTOS],
    cwd=server.ROOT / "proto", check=True, capture_output=True).stdout)
_pool = descriptor_pool.DescriptorPool()
for _file in _files.file:
    _pool.AddSerializedFile(_file.SerializeToString())
_factory = message_factory.MessageFactory(_pool)


def message_type(name):
    return _factory.GetPrototype(_pool.FindMessageTypeByName(name.lstrip(".")))


Method = collections.namedtuple("Method", "path kind request response")
METHODS = {
    method.name: Method(f"/{file.package}.{service.name}/{method.name}",
                        ("unary", "stream")[method.client_streaming] + "_" + ("unary", "stream")[method.server_streaming],
                        message_type(method.input_type), message_type(method.output_type))
    for file in _files.file for service in file.service for method in service.method
}
_Status = message_type("google.rpc.Status")
_DETAILS = {name: message_type(f"google.rpc.{name}") for name in ("BadRequest", "ErrorInfo", "QuotaFailure", "RetryInfo")}

# How a call failed. `details` has the messages of google.rpc by name.
Failure = collections.namedtuple("Failure", "code reason message details")


def failure_of(error):
    """Returns the Failure of a grpc.RpcError, or of a call that has ended."""
    details = {}
    for key, value in error.trailing_metadata() or ():
        if key == "grpc-status-details-bin":
            for item in _Status.FromString(value).details:
                name = item.type_url.rsplit(".", 1)[-1]
                details[name] = _DETAILS[name].FromString(item.value)
    reason = details["ErrorInfo"].reason if "ErrorInfo" in details else ""
    return Failure(error.code().name, reason, error.details() or "", details)


def refusal(call, /, *arguments, **fields):
    """Makes a call that must fail, and returns its Failure."""
    try:
        answer = call(*arguments, **fields)
    except grpc.RpcError as error:
        return failure_of(error)
    raise AssertionError(f"was accepted: {str(answer)[:500]}")


class Stream:
    """A call whose messages are sent one by one."""

    def __init__(self, call, method, **settings):
        self._out = queue.SimpleQueue()
        self._request = method.request
        self.call = call(iter(self._out.get, None), **settings)

    def send(self, **fields):
        self._out.put(self._request(**fields))

    def finish(self):
        """Ends the client's half of the call."""
        self._out.put(None)

    def read(self, *kinds):
        """Returns the next message, or the next one of these kinds. Raises grpc.RpcError, or StopIteration at the end."""
        while True:
            message = next(self.call)
            if not kinds or message.WhichOneof("message") in kinds:
                return message

    def read_all(self):
        """Reads up to the end of the call. Raises grpc.RpcError."""
        collections.deque(self.call, maxlen=0)

    def failure(self):
        """Reads up to the end of the call, which must fail, and returns its Failure."""
        return refusal(self.read_all)

    def cancel(self):
        self.call.cancel()
        self._out.put(None)


class Api:
    """One client with a connection of its own. `timeout_s` is the deadline of each call; None: calls with one response have
    PATIENCE_S, streams have none."""

    def __init__(self, address, tenant=None, credentials=None, token=None, timeout_s=None):
        options = [("grpc.use_local_subchannel_pool", 1), ("grpc.enable_http_proxy", 0),
                   ("grpc.max_receive_message_length", -1), ("grpc.max_metadata_size", 1 << 20)]
        self.channel = (grpc.secure_channel(address, credentials, options) if credentials
                        else grpc.insecure_channel(address, options))
        token = token or (tenant and server.token(tenant))
        self._settings = {"metadata": [("authorization", "Bearer " + token)] if token else [], "timeout": timeout_s}
        self._streams = []

    def callable(self, name):
        method = METHODS[name]
        return getattr(self.channel, method.kind)(method.path, method.request.SerializeToString, method.response.FromString)

    def __call__(self, name, /, **fields):
        """Makes a call with one request and one response."""
        settings = {**self._settings, "timeout": self._settings["timeout"] or server.PATIENCE_S}
        return self.callable(name)(METHODS[name].request(**fields), **settings)

    def start(self, name, /, **fields):
        """Starts a call with one request and one response, and returns its future."""
        return self.callable(name).future(METHODS[name].request(**fields), **self._settings)

    def watch(self, name, /, **fields):
        """Starts a call with one request and a stream of responses."""
        call = self.callable(name)(METHODS[name].request(**fields), **self._settings)
        self._streams.append(call)
        return call

    def stream(self):
        """Starts a Track call."""
        stream = Stream(self.callable("Track"), METHODS["Track"], **self._settings)
        self._streams.append(stream)
        return stream

    def attach(self, created, last_pose_seq=0):
        """Attaches to a session. Returns the stream and `attached`."""
        stream = self.stream()
        stream.send(attach={"session": created.session.name, "resume_token": created.resume_token,
                            "last_pose_seq": last_pose_seq})
        return stream, stream.read("attached").attached

    def start_upload(self):
        """Starts an UploadModel call; `call` of the result is its future."""
        stream = Stream(self.callable("UploadModel").future, METHODS["UploadModel"], **self._settings)
        self._streams.append(stream)
        return stream

    def send_model(self, data, **header):
        """Starts the upload of a whole file, without waiting for the response."""
        stream = self.start_upload()
        stream.send(header={"format": OBJ, "size_bytes": len(data), "sha256": hashlib.sha256(data).digest(), **header})
        for start in range(0, len(data), 1 << 19):
            stream.send(chunk=data[start:start + (1 << 19)])
        stream.finish()
        return stream

    def upload(self, data, **header):
        """Uploads a file and returns the Model."""
        return self.send_model(data, **header).call.result(timeout=server.PATIENCE_S)

    def create(self, model, camera=None, num_objects=1, encoding=FLAT64, request_id="", pose=None, **more):
        """Creates a session with `num_objects` objects of a model, all with the same initial pose if one is given."""
        objects = [{"object_id": f"object{i}", "model": model, "initial_camera_from_object": pose} for i in range(num_objects)]
        config = {"encoding": encoding, "camera": camera or VGA, "objects": objects, **more}
        return self("CreateSession", config=config, request_id=request_id)

    def create_until_refused(self, model, limit=1000, **settings):
        """Creates sessions, each with another focal length, until one is refused. Returns the sessions and the Failure."""
        camera = settings.pop("camera", VGA)
        created = []
        for i in itertools.count():
            if i == limit:
                raise AssertionError(f"{limit} sessions were admitted")
            try:
                created.append(self.create(model, camera={**camera, "fx_px": camera["fx_px"] + i}, **settings))
            except grpc.RpcError as error:
                return created, failure_of(error)

    def models(self):
        return self("ListModels", page_size=1000).models

    def is_serving(self):
        """Returns whether grpc.health.v1 reports that the server is ready."""
        return self("Check").status == 1

    def close(self):
        for stream in self._streams:
            stream.cancel()
        self.channel.close()


def client(test, running, tenant=None, **settings):
    """Returns an Api that is closed at the end of the test."""
    api = Api(running.address, tenant, **settings)
    test.addCleanup(api.close)
    return api

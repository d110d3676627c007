# SPDX-License-Identifier: Apache-2.0
"""A connection to evpose servers: models, sessions, and the stream of events and poses."""

from __future__ import annotations

import hashlib
import pathlib
import time
import uuid
from typing import Any, Iterator, Optional, Sequence, Union

from google.protobuf import empty_pb2

from evpose.cameras import Camera
from evpose.channel import Endpoint, Tls, Token, TokenSource, explain_tls, parse_address
from evpose.convert import model_from_message, server_from_message, session_from_message
from evpose.errors import (AbortedError, DeadlineExceededError, EvposeError, FailedPreconditionError, InternalError,
                           InvalidArgumentError, UnavailableError, UnimplementedError)
from evpose.events import Encoding
from evpose.files import PathLike, read_file, to_enum, to_number
from evpose.session import Session
from evpose.stream.attempt import SERVICE as SESSIONS
from evpose.stream.attempt import TrackPosition
from evpose.stream.feed import EventSource
from evpose.stream.servers import Servers, is_unreachable
from evpose.stream.track import Track, TrackOptions
from evpose.types import Estimator, Model, Overload, SensorProfile, ServerInfo, SessionConfig, SessionInfo, Surface, TrackedObject
from evpose.rpc import health_pb2
from evpose.v1 import admin_service_pb2, model_service_pb2, session_pb2, session_service_pb2

_MODELS = "/evpose.v1.ModelService/"
_ADMIN = "/evpose.v1.AdminService/"
_UPLOAD_PIECE_BYTES = 256 * 1024
_MAX_MODEL_BYTES = 64 << 20  # the default limit of a server, for one that states none
# Time for which each server is waited for in turn.
_CONNECT_SLICE_S = 0.1
# Time after which the client checks whether TLS prevents the connection.
_FIRST_WAIT_S = 1.0
_FORMATS = {".obj": 1, ".ply": 2, ".stl": 3}  # the numbers of the API
_PAGE_SIZE = 500  # some hundred kilobytes, below gRPC's limit of 4 MiB for a message

Objects = Union[Model, str, TrackedObject, Sequence[TrackedObject]]


class Client:
    """Made by connect(). Thread-safe. All calls block; they raise EvposeError with a text that begins with the server's address.
    Use it in a `with` block, or close() it."""

    def __init__(self, servers: Servers, call_timeout_s: float, max_model_bytes: int = 0) -> None:
        self._servers = servers
        self._timeout_s = call_timeout_s
        self._max_model_bytes = max_model_bytes or _MAX_MODEL_BYTES

    def close(self) -> None:
        """Ends all calls and closes the connections."""
        self._servers.closed.set()
        for endpoint in self._servers.endpoints:
            endpoint.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def server_info(self) -> ServerInfo:
        """Returns version, limits and load of the server. Raises EvposeError."""
        return self._servers.at_any(_server_info, self._timeout_s)

    def is_serving(self) -> bool:
        """Whether the server is ready (grpc.health.v1): not while it shuts down, nor while its store does not respond."""
        endpoint = self._servers.endpoints[self._servers.current]
        self._servers.connect_again(self._servers.current)
        try:
            response = endpoint.call(
                "/grpc.health.v1.Health/Check", health_pb2.HealthCheckRequest(), health_pb2.HealthCheckResponse, self._timeout_s)
        except EvposeError as error:
            if is_unreachable(error):
                endpoint.mark_unreachable()
            raise
        return bool(response.status == health_pb2.HealthCheckResponse.SERVING)

    def upload_model(self, path: PathLike, *, metres_per_unit: float = 1.0, crease_angle_deg: float = 30.0,
                     surface: Surface = Surface.SMOOTH) -> Model:
        """Uploads an OBJ, PLY or STL file; `evpose models upload` takes more formats. Uploading it again has no effect. Raises
        NotFoundError and InvalidArgumentError with the path, and EvposeError."""
        suffix = pathlib.Path(path).suffix.lower()
        if suffix not in _FORMATS:
            raise InvalidArgumentError(f"{path}: unknown model format; the name must end in .obj, .ply or .stl "
                                       "(`evpose models upload` takes more formats)")
        data = read_file(path, self._max_model_bytes, ", the limit of the server for a model")
        header = {"format": _FORMATS[suffix], "metres_per_unit": to_number(metres_per_unit, "metres_per_unit"),
                  "crease_angle_deg": to_number(crease_angle_deg, "crease_angle_deg"),
                  "surface": int(to_enum(surface, Surface, "surface")), "file_name": pathlib.Path(path).name, "size_bytes": len(data),
                  "sha256": hashlib.sha256(data).digest()}

        def requests() -> Iterator[Any]:
            yield model_service_pb2.UploadModelRequest(header=header)
            for begin in range(0, len(data), _UPLOAD_PIECE_BYTES):
                yield model_service_pb2.UploadModelRequest(chunk=data[begin:begin + _UPLOAD_PIECE_BYTES])

        def upload(endpoint: Endpoint, timeout_s: float) -> Any:
            return endpoint.upload(_MODELS + "UploadModel", requests(), model_service_pb2.Model, timeout_s)

        try:
            try:
                message = self._servers.at_any(upload, self._timeout_s)
            except AbortedError:
                # The server had the model and did not read the bytes, but another server has deleted the model since: the second
                # upload is read.
                message = self._servers.at_any(upload, self._timeout_s)
        except InvalidArgumentError as error:
            # The fields of the API are parts of this file, or parameters of this function.
            name = {"chunk": "", "header.size_bytes": "its size "}.get(error.field, error.field.removeprefix("header.") + ": ")
            text = error.message.replace(f": {error.field}: ", f": {name}") if error.field else error.message
            raise error.with_message(f"{path}: {text}") from None
        return model_from_message(message)

    def get_model(self, name: str) -> Model:
        """Returns a model by its name, "models/{id}". Raises NotFoundError."""
        request = model_service_pb2.GetModelRequest(name=name)
        return model_from_message(self._servers.call(_MODELS + "GetModel", request, model_service_pb2.Model, self._timeout_s))

    def list_models(self) -> list[Model]:
        """Returns the models of this client's tenant. Raises EvposeError."""
        pages = self._pages(_MODELS + "ListModels", model_service_pb2.ListModelsRequest(), model_service_pb2.ListModelsResponse)
        return [model_from_message(message) for page in pages for message in page.models]

    def delete_model(self, name: str) -> None:
        """Deletes a model. Raises NotFoundError, and FailedPreconditionError while a session uses it."""
        request = model_service_pb2.DeleteModelRequest(name=name)

        def delete(endpoint: Endpoint, timeout_s: float) -> None:
            try:
                endpoint.call(_MODELS + "DeleteModel", request, empty_pb2.Empty, timeout_s)
            finally:
                request.allow_missing = True  # the server may have deleted the model before it became unreachable

        self._servers.at_any(delete, self._timeout_s)

    def create_session(self, objects: Objects, camera: Camera, encoding: Encoding = Encoding.FLAT64, *,
                       overload: Overload = Overload.BLOCK, max_lag_s: Optional[float] = None, estimator: Estimator = Estimator.MIXTURE,
                       sensor: SensorProfile = SensorProfile(), pose_rate_hz: float = 1000.0, request_id: str = "",
                       max_wait_s: float = 30.0) -> Session:
        """Creates a session that tracks one model, or several TrackedObject, in events of this encoding (Recording.encoding; FLAT64
        for arrays). Calls with the same `request_id` return the same session, so that a call without a response can be repeated;
        without one, each call creates a session.

        A server without room refuses with ResourceExhaustedError (OVERLOADED, TOO_MANY_SESSIONS, SESSION_MEMORY, OUT_OF_MEMORY). The
        next servers are then tried at once. If all refuse, the call is made again after at least the shortest delay that a server
        proposes, as long as these delays end within `max_wait_s` seconds from the start (0: never); then the last refusal is raised. A
        refusal without a delay by all servers, and TENANT_QUOTA, are raised at once. If a full server has refused the session,
        NOT_FOUND for the model from a later server is treated like a refusal: the next server is tried, because models may be stored at
        some servers only. The default permits several delays of 5 s, which is what evpose-server proposes. A server that has refused is
        called again on a new connection, for which a load balancer of connections may choose another server; other calls and streams
        that are under way continue.

        Raises InvalidArgumentError for a parameter, CancelledError if close() ended the wait, and EvposeError."""
        if not max_wait_s >= 0.0:
            raise InvalidArgumentError("max_wait_s must not be negative")
        if not isinstance(camera, Camera):
            raise InvalidArgumentError(f"camera: {camera!r} is no Camera; read_camera(path) reads one")
        encoding = to_enum(encoding, Encoding, "encoding")
        config = SessionConfig(encoding, camera, _tracked_objects(objects), overload, max_lag_s, estimator, sensor, pose_rate_hz)
        request = session_service_pb2.CreateSessionRequest(config=config.to_proto(), request_id=request_id or uuid.uuid4().hex)

        def create(endpoint: Endpoint, timeout_s: float) -> Any:
            return endpoint.call(SESSIONS + "CreateSession", request, session_service_pb2.CreateSessionResponse, timeout_s)

        created = self._servers.where_room_is(create, self._timeout_s, max_wait_s)
        if not created.session.name:
            name = self._servers.endpoints[self._servers.current].name
            raise InternalError(f"{name}: the server violates the protocol: the new session has no name")
        return Session(self._servers, session_from_message(created.session), created.resume_token, self._timeout_s)

    def session(self, name: str) -> Session:
        """Returns a session that another client feeds, to watch it. Raises NotFoundError."""
        return Session(self._servers, self.get_session(name), "", self._timeout_s)

    def get_session(self, name: str) -> SessionInfo:
        """Returns the state of a session by its name, "sessions/{id}". Raises NotFoundError."""
        request = session_service_pb2.GetSessionRequest(name=name)
        return session_from_message(self._servers.call(SESSIONS + "GetSession", request, session_pb2.Session, self._timeout_s))

    def list_sessions(self) -> list[SessionInfo]:
        """Returns the sessions of this client's tenant. Raises EvposeError."""
        pages = self._pages(SESSIONS + "ListSessions", session_service_pb2.ListSessionsRequest(), session_service_pb2.ListSessionsResponse)
        return [session_from_message(message) for page in pages for message in page.sessions]

    def resume(self, position: TrackPosition, events: EventSource, options: TrackOptions = TrackOptions()) -> Track:
        """Continues a session at a position that on_position reported or Track.position has, in this process or another one.
        `events` are those of the session from the start; those before the position are compared with a digest and not sent. The
        iterator raises FailedPreconditionError if they differ. Raises EvposeError."""
        return self.session(position.session).continue_from(position, events, options)

    def _pages(self, method: str, request: Any, response: Any) -> Iterator[Any]:
        request.page_size = _PAGE_SIZE
        while True:
            page = self._servers.call(method, request, response, self._timeout_s)
            yield page
            request.page_token = page.next_page_token
            if not request.page_token:
                return


def _server_info(endpoint: Endpoint, timeout_s: float) -> ServerInfo:
    return server_from_message(endpoint.call(
        _ADMIN + "GetServerInfo", admin_service_pb2.GetServerInfoRequest(), admin_service_pb2.ServerInfo, timeout_s))


def _tracked_objects(objects: Objects) -> tuple[TrackedObject, ...]:
    if isinstance(objects, (Model, str)):
        return (TrackedObject(objects),)
    several = (objects,) if isinstance(objects, TrackedObject) else objects
    if not isinstance(several, Sequence) or not all(isinstance(each, TrackedObject) for each in several):
        raise InvalidArgumentError(f"objects: {objects!r} is neither a Model, the name of one, a TrackedObject nor a list of TrackedObject")
    return tuple(several)


def connect(addresses: str, *, tls: Optional[Tls] = None, token: Optional[Token] = None, connect_timeout_s: float = 10.0,
            call_timeout_s: float = 60.0) -> Client:
    """Connects to HOST:PORT, or to several of them, separated by commas, of servers that share their sessions. Waits until one
    responds (it may be starting); later calls go to the server that responded last. When it cannot be reached, shuts down or has
    lost its store, the next servers are tried in turn, three times each with growing delays. A call that is made again has the
    effect of one call. Track has its own limit (RetryOptions); create_session() also goes to the next server if one is full.

    tls     encryption; None: none
    token   the authentication token, a secret, or a function that returns the current one, which is called before every call. It is
            never sent unencrypted to another machine.

    Raises InvalidArgumentError for a wrong address or token, UnavailableError with the cause, FailedPreconditionError for wrong
    certificates and for a token without TLS to another machine, UnauthenticatedError, and UnimplementedError if the server is
    another service."""
    if not (connect_timeout_s > 0.0 and call_timeout_s > 0.0):
        raise InvalidArgumentError("connect_timeout_s and call_timeout_s must be positive")
    source = TokenSource(token)
    for address in addresses.split(","):
        parse_address(address)
    endpoints: list[Endpoint] = []
    servers = Servers(endpoints, outlive_sessions=False)
    try:
        for address in addresses.split(","):
            endpoints.append(Endpoint.open(address, tls, source))
        info = _wait_for_server(servers, call_timeout_s, addresses, tls, connect_timeout_s)
    except BaseException:
        for endpoint in endpoints:
            endpoint.close()
        raise
    servers.outlive_sessions = info.store != "memory"
    return Client(servers, call_timeout_s, info.max_model_bytes)


def _wait_for_server(servers: Servers, call_timeout_s: float, addresses: str, tls: Optional[Tls], timeout_s: float) -> ServerInfo:
    begin = time.monotonic()
    is_explained = False
    while True:
        for index, endpoint in enumerate(servers.endpoints):
            servers.current = index
            # A server that accepts the call and does not respond leaves the others their share of the time.
            left_s = (begin + timeout_s - time.monotonic()) / (len(servers.endpoints) - index)
            try:
                return _server_info(endpoint, min(call_timeout_s, max(left_s, _CONNECT_SLICE_S)))
            except UnimplementedError:
                raise UnimplementedError(f"the server at {endpoint.name} is not an evpose server") from None
            except (UnavailableError, DeadlineExceededError) as error:
                cause = error
        waited_s = time.monotonic() - begin
        if not is_explained and waited_s >= min(_FIRST_WAIT_S, timeout_s):
            is_explained = True
            for endpoint in servers.endpoints:
                why = explain_tls(endpoint.name, tls, _FIRST_WAIT_S)
                if why:
                    raise FailedPreconditionError(f"server at {endpoint.name}: {why}")
        if waited_s >= timeout_s:
            raise UnavailableError(f"no server at {addresses}: tried to connect for {timeout_s:g} s; "
                                   f"is evpose-server running there? ({cause.message})")
        time.sleep(min(_CONNECT_SLICE_S, timeout_s - waited_s))

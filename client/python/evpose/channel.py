# SPDX-License-Identifier: Apache-2.0
"""Channels to servers: addresses, TLS, tokens and the methods of the API."""

from __future__ import annotations

import dataclasses
import ipaddress
import socket
import ssl
import threading
import time
from typing import Any, Callable, Optional, Sequence, Union

import grpc

from evpose.errors import EvposeError, FailedPreconditionError, InvalidArgumentError, from_call
from evpose.files import read_file

Token = Union[str, Callable[[], str]]

_OPTIONS = [
    # A server that is starting is found within a fraction of a second.
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.min_reconnect_backoff_ms", 5000),  # timeout of one attempt, for slow links
    ("grpc.max_reconnect_backoff_ms", 1000),
    # A dead link is detected within 30 s; the server permits a ping every 10 s.
    ("grpc.keepalive_time_ms", 20_000),
    ("grpc.keepalive_timeout_ms", 10_000),
]

_STOP_PERIOD_S = 0.05  # a request to stop ends a wait for a connection within it
# Longest wait for a new connection to a server that has just responded: a few round trips of a long link, as TLS needs them.
_NEW_CONNECTION_WAIT_S = 1.0


@dataclasses.dataclass(frozen=True)
class Tls:
    """Files of an encrypted connection, PEM.

    ca            certificate authorities that are trusted; None: those of the system
    certificate   of this client with its chain, for servers that require one; with `key`, its private key
    """

    ca: Optional[str] = None
    certificate: Optional[str] = None
    key: Optional[str] = None


def parse_address(text: str) -> tuple[str, int]:
    """Returns host and port of HOST:PORT. Raises InvalidArgumentError."""
    scheme, separator, rest = text.partition("://")
    if separator and scheme.lower() in ("http", "https"):
        host = rest.partition("/")[0]
        port = "" if ":" in host.rpartition("]")[2] else ":PORT"  # an IPv6 address is in brackets
        raise InvalidArgumentError(f'"{text}" is a URL, but the address of a server is HOST:PORT: give {host or "HOST"}{port}')
    host, _, port = text.rpartition(":")
    if not host or not (port.isascii() and port.isdigit()) or not 1 <= int(port) <= 65535:
        raise InvalidArgumentError(f'"{text}" is not a server address; HOST:PORT is needed')
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
    return host, int(port)


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _is_token(text: str) -> bool:
    return all("!" <= c <= "~" for c in text)


class TokenSource:
    """The token of the moment. A token that cannot be renewed or is not valid leaves the previous one in use."""

    def __init__(self, token: Optional[Token]) -> None:
        self._renew = token if callable(token) else None
        self._lock = threading.Lock()
        self._token = (token if isinstance(token, str) else self._renew() if self._renew else "") or ""
        if not _is_token(self._token):
            raise InvalidArgumentError("token: has spaces, line feeds or other characters that are invalid in a token")

    @property
    def is_renewed(self) -> bool:
        """Whether the token is read again before every call, so that it may change."""
        return self._renew is not None

    def get(self) -> str:
        """Returns the current token, empty if there is none."""
        if self._renew is not None:
            try:
                renewed = self._renew()
            except Exception:  # such as a file that is being replaced
                renewed = ""
            if renewed and _is_token(renewed):
                with self._lock:
                    self._token = renewed
        with self._lock:
            return self._token

    def metadata(self) -> Optional[list[tuple[str, str]]]:
        """Returns the metadata of a call with the current token, None without a token."""
        token = self.get()
        return [("authorization", f"Bearer {token}")] if token else None


def _read_pem(path: str) -> bytes:
    data = read_file(path)
    if b"-----BEGIN " not in data:
        raise FailedPreconditionError(f"{path}: is not a PEM file")
    return data


def _credentials(tls: Tls) -> grpc.ChannelCredentials:
    if (tls.certificate is None) != (tls.key is None):
        raise InvalidArgumentError("tls: a certificate needs its key, and a key its certificate")
    return grpc.ssl_channel_credentials(
        root_certificates=_read_pem(tls.ca) if tls.ca else None,
        private_key=_read_pem(tls.key) if tls.key else None,
        certificate_chain=_read_pem(tls.certificate) if tls.certificate else None)


def _serialize(message: Any) -> bytes:
    return bytes(message.SerializeToString())


@dataclasses.dataclass
class _Connection:
    channel: grpc.Channel
    num_calls: int = 0  # that have not ended


class Endpoint:
    """An address of a client. A load balancer of connections, such as a Service of Kubernetes, may choose another server for each
    connection to it. `make_channel` returns a further channel, which shares no connection with others; None: `channel` remains the
    only one. Thread-safe."""

    def __init__(self, name: str, channel: grpc.Channel, token: TokenSource,
                 make_channel: Optional[Callable[[], grpc.Channel]] = None) -> None:
        self.name = name
        self.token = token
        self._make_channel = make_channel
        self._lock = threading.Lock()
        self._connection = _Connection(channel)
        self._left: list[_Connection] = []  # earlier connections: calls on them may be under way
        self._has_refused = False
        self._is_unreachable = False  # a call did not reach the server, and the channel has not been connected since
        self._closed = threading.Event()

    @property
    def channel(self) -> grpc.Channel:
        """The present channel."""
        return self._connection.channel

    def close(self) -> None:
        """Ends the calls, and closes the connections."""
        self._closed.set()
        with self._lock:
            connections, self._left = [self._connection, *self._left], []
        for connection in connections:
            connection.channel.close()

    def mark_unreachable(self) -> None:
        """Informs the endpoint that a call did not reach its server."""
        self._is_unreachable = True

    def connect_again(self, longest_s: float, stop: threading.Event) -> None:
        """If a call did not reach the server, blocks until the channel is connected, for at most `longest_s` seconds or until `stop`.
        After a failed connection attempt a call does not wait for the next one, and gRPC processes an attempt only while a thread waits
        for the channel, and otherwise every 5 s."""
        if self._is_unreachable and self._becomes_ready(self.channel, longest_s, stop):
            self._is_unreachable = False

    def note_refusal(self) -> None:
        """Informs the endpoint that a server has refused a session or a stream because it has no room for it."""
        self._has_refused = True

    def leave_after_refusal(self, stop: threading.Event) -> None:
        """If a server has refused a session or a stream since the last call, replaces the connection by a new one, for which a load
        balancer may choose a server with room. Blocks until it is connected, for at most 1 s or until `stop`. If it is not connected
        then, the former connection remains. Calls keep the connection on which they began."""
        if not self._has_refused or self._make_channel is None:
            return
        self._has_refused = False
        try:
            channel = self._make_channel()
        except EvposeError:  # the files of TLS have become unreadable
            return
        if not self._becomes_ready(channel, _NEW_CONNECTION_WAIT_S, stop):
            channel.close()
            return
        with self._lock:
            self._left.append(self._connection)
            self._connection = _Connection(channel)
            is_closed = self._closed.is_set()
        if is_closed:
            self.close()

    def _becomes_ready(self, channel: grpc.Channel, longest_s: float, stop: threading.Event) -> bool:
        if self._closed.is_set():
            return False
        ready = grpc.channel_ready_future(channel)
        end = time.monotonic() + longest_s
        is_ready = False
        while not is_ready and time.monotonic() < end and not stop.is_set() and not self._closed.is_set():
            try:
                ready.result(min(_STOP_PERIOD_S, longest_s))
                is_ready = True
            except grpc.FutureTimeoutError:
                continue
        ready.cancel()
        return is_ready

    @staticmethod
    def open(address: str, tls: Optional[Tls], token: TokenSource) -> Endpoint:
        """Opens a channel, which connects when it is first used. Raises InvalidArgumentError, and FailedPreconditionError for a token
        that would be sent unencrypted to another machine."""
        host, _ = parse_address(address)
        if token.get() and tls is None and not _is_loopback(host):
            raise FailedPreconditionError(f"{address}: the token would travel through the network in clear: connect with tls=Tls(...)")

        def make_channel(*options: tuple[str, int]) -> grpc.Channel:
            if tls is None:
                return grpc.insecure_channel(address, [*_OPTIONS, *options])
            return grpc.secure_channel(address, _credentials(tls), [*_OPTIONS, *options])

        # Channels of this process with the same address and options use one connection, unless they have a pool of their own.
        return Endpoint(address, make_channel(), token, lambda: make_channel(("grpc.use_local_subchannel_pool", 1)))

    def call(self, method: str, request: Any, response: Any, timeout_s: float) -> Any:
        """Makes a call with one request and one response. Raises EvposeError."""
        return self._start("unary_unary", method, request, response, timeout=timeout_s)

    def upload(self, method: str, requests: Any, response: Any, timeout_s: float) -> Any:
        """Makes a call with a stream of requests and one response. Raises EvposeError."""
        return self._start("stream_unary", method, requests, response, timeout=timeout_s)

    def watch(self, method: str, request: Any, response: Any) -> Any:
        """Starts a call with one request and a stream of responses."""
        return self._start("unary_stream", method, request, response)

    def stream(self, method: str, requests: Any, response: Any, metadata: Sequence[tuple[str, str]] = ()) -> Any:
        """Starts a call with streams of both."""
        return self._start("stream_stream", method, requests, response, metadata)

    def _start(self, kind: str, method: str, request: Any, response: Any, metadata: Sequence[tuple[str, str]] = (), **settings: Any) -> Any:
        connection = self._begin_call()
        is_running = False
        try:
            result = getattr(connection.channel, kind)(method, _serialize, response.FromString)(
                request, metadata=[*(self.token.metadata() or ()), *metadata], **settings)
            is_running = kind.endswith("_stream") and result.add_callback(lambda: self._end_call(connection))
            return result
        except grpc.RpcError as error:
            raise (from_call(error, self.name) or error) from None
        except ValueError:  # of gRPC, for a closed channel
            raise FailedPreconditionError(f"{self.name}: the client was closed") from None
        finally:
            if not is_running:
                self._end_call(connection)

    def _begin_call(self) -> _Connection:
        with self._lock:
            connection = self._connection
            connection.num_calls += 1
            # Not in _end_call(), because the thread of a channel cannot close it.
            unused = [each for each in self._left if each.num_calls == 0]
            self._left = [each for each in self._left if each.num_calls > 0]
        for each in unused:
            each.channel.close()
        return connection

    def _end_call(self, connection: _Connection) -> None:
        with self._lock:
            connection.num_calls -= 1


def explain_tls(address: str, tls: Optional[Tls], timeout_s: float) -> str:
    """Returns why a TLS handshake with the server fails, or cannot be tried; "" if it succeeds, or if nothing listens there."""
    host, port = parse_address(address)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.set_alpn_protocols(["h2"])
    if tls is None:
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
    else:
        try:
            context.load_verify_locations(tls.ca) if tls.ca else context.load_default_certs()
            if tls.certificate and tls.key:
                # Without the password, OpenSSL asks for that of an encrypted key at the terminal.
                context.load_cert_chain(tls.certificate, tls.key, password=lambda: b"")
        except (ssl.SSLError, OSError) as error:
            return f"the TLS files of this client cannot be used: {error}: check Tls.ca, Tls.certificate and Tls.key"
    try:
        with socket.create_connection((host, port), timeout_s) as connection:
            return _explain_handshake(connection, context, host, tls)
    except OSError:
        return ""


def _explain_handshake(connection: socket.socket, context: ssl.SSLContext, host: str, tls: Optional[Tls]) -> str:
    try:
        with context.wrap_socket(connection, server_hostname=host) as secure:
            if tls is None:
                return "it requires TLS: connect with tls=Tls(ca=...)"
            return _explain_client_certificate(secure, tls)
    except ssl.SSLCertVerificationError as error:
        return f"its certificate cannot be verified: {error.verify_message}: check the host and Tls.ca"
    except ssl.SSLError as error:
        if tls is None:
            return ""
        if error.reason in ("WRONG_VERSION_NUMBER", "UNEXPECTED_EOF_WHILE_READING"):
            return "it does not use TLS: omit tls if an unencrypted connection is intended"
        return f"the TLS handshake fails: {error.reason}"


def _explain_client_certificate(secure: ssl.SSLSocket, tls: Tls) -> str:
    # A server refuses the client's certificate after the handshake. Otherwise it sends the first bytes in HTTP/2.
    try:
        if secure.recv(1):
            return ""
    except socket.timeout:  # a TimeoutError only since Python 3.10
        return ""
    except OSError:
        pass
    if tls.certificate is None:
        return "it requires a certificate from its clients: give Tls.certificate and Tls.key"
    return f"it rejects the certificate {tls.certificate}: it must be valid and signed by an authority that the server trusts"

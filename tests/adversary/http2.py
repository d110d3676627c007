# SPDX-License-Identifier: Apache-2.0
"""Frames of HTTP/2 (RFC 9113) that a client of gRPC does not send."""

DATA, HEADERS, RST_STREAM, SETTINGS, PING, WINDOW_UPDATE, CONTINUATION = 0, 1, 3, 4, 6, 8, 9
END_STREAM, END_HEADERS, ACK = 1, 4, 1
PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"  # of a client, section 3.4
CANCEL = (8).to_bytes(4, "big")  # the payload of RST_STREAM
_PATH = b"/evpose.v1.AdminService/GetServerInfo"


def frame(kind, flags, stream, payload):
    return len(payload).to_bytes(3, "big") + bytes([kind, flags]) + stream.to_bytes(4, "big") + payload


EMPTY_SETTINGS = frame(SETTINGS, 0, 0, b"")


def _literal(name, value):
    """A header field without indexing, RFC 7541, section 6.2.2."""
    return b"\x00" + bytes([len(name)]) + name + bytes([len(value)]) + value


def call(is_tls=False, path=_PATH, token=None):
    """The header of a call. ":method: POST", ":scheme: http" and ":scheme: https" are entries 3, 6 and 7 of the static table."""
    authorization = _literal(b"authorization", b"Bearer " + token.encode()) if token else b""
    return ((b"\x83\x87" if is_tls else b"\x83\x86") + _literal(b":path", path) + _literal(b":authority", b"localhost")
            + _literal(b"content-type", b"application/grpc") + b"\x00\x02te\x08trailers" + authorization)


CALL = call()
# A field with a value of 16000 bytes: the length is 127 + 1 + 124 * 128, RFC 7541, section 5.1.
LONG_FIELD = b"\x00\x01a\x7f\x81\x7c" + b"a" * 16_000


def reset_streams(first, count):
    """Calls that are reset at once."""
    streams = range(2 * first + 1, 2 * (first + count) + 1, 2)
    return b"".join(frame(HEADERS, END_HEADERS, i, CALL) + frame(RST_STREAM, 0, i, CANCEL) for i in streams)


def unary_call(stream, path, request, token):
    """A whole call with one request, a serialized message."""
    message = bytes([0]) + len(request).to_bytes(4, "big") + request
    return (frame(HEADERS, END_HEADERS, stream, call(path=path.encode(), token=token))
            + frame(DATA, END_STREAM, stream, message))


def window(size_bytes):
    """Settings with which a stream may receive this many bytes of data; headers may always be sent (section 5.2.1)."""
    return frame(SETTINGS, 0, 0, b"\x00\x04" + size_bytes.to_bytes(4, "big"))


def frames(connection):
    """Yields the kind, the flags and the stream of each frame that the server sends, until it closes the connection. Pings are answered:
    without an answer the server closes the connection after 40 s, which is less than some tests take beside other work."""
    with connection.makefile("rb") as received:
        while len(head := received.read(9)) == 9:
            payload = received.read(int.from_bytes(head[:3], "big"))
            kind, flags = head[3], head[4]
            if kind == PING and not flags & ACK:
                connection.sendall(frame(PING, ACK, 0, payload))
            yield kind, flags, int.from_bytes(head[5:], "big")


def open_connection(running, start=b""):
    """Returns a connection on which the preface was sent, and then `start`."""
    connection = running.connect()
    connection.sendall(PREFACE + EMPTY_SETTINGS + start)
    return connection


def send(connection, data):
    """Sends data and reads nothing. Returns false when the server cuts the connection, or takes nothing for a second."""
    connection.settimeout(1.0)
    try:
        connection.sendall(data)
        return True
    except OSError:
        return False

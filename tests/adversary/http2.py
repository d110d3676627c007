# SPDX-License-Identifier: Apache-2.0
"""Frames of HTTP/2 (RFC 9113) that a client of gRPC does not send."""

HEADERS, RST_STREAM, SETTINGS, PING, CONTINUATION = 1, 3, 4, 6, 9
END_HEADERS = 4
PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"  # of a client, section 3.4
CANCEL = (8).to_bytes(4, "big")  # the payload of RST_STREAM
_PATH = b"/evpose.v1.AdminService/GetServerInfo"


def frame(kind, flags, stream, payload):
    return len(payload).to_bytes(3, "big") + bytes([kind, flags]) + stream.to_bytes(4, "big") + payload


EMPTY_SETTINGS = frame(SETTINGS, 0, 0, b"")


def _literal(name, value):
    """A header field without indexing, RFC 7541, section 6.2.2."""
    return b"\x00" + bytes([len(name)]) + name + bytes([len(value)]) + value


def call(is_tls=False):
    """The header of a call without a token. ":method: POST", ":scheme: http" and ":scheme: https" are entries 3, 6 and 7 of the static
    table."""
    return ((b"\x83\x87" if is_tls else b"\x83\x86") + _literal(b":path", _PATH) + _literal(b":authority", b"localhost")
            + _literal(b"content-type", b"application/grpc") + b"\x00\x02te\x08trailers")


CALL = call()
# A field with a value of 16000 bytes: the length is 127 + 1 + 124 * 128, RFC 7541, section 5.1.
LONG_FIELD = b"\x00\x01a\x7f\x81\x7c" + b"a" * 16_000


def reset_streams(first, count):
    """Calls that are reset at once."""
    streams = range(2 * first + 1, 2 * (first + count) + 1, 2)
    return b"".join(frame(HEADERS, END_HEADERS, i, CALL) + frame(RST_STREAM, 0, i, CANCEL) for i in streams)


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

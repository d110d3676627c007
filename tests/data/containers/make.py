#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes the recordings of this folder with the programs that users write them with: SQLite and NumPy here, @mcap/core in
make_mcap.mjs, to which the packets are passed as JSON (packets.json, not kept). All hold the same 300 events of a sensor of 346x260:
t = 5000 + 37 i + i % 3 us, x = 7 i % 346, y = 11 i % 260, p = i % 2. dvs_msgs has the same after 1,700,000,000 s.

  cd tests/data/containers && /usr/bin/python3 make.py && npm install --no-save @mcap/core @foxglove/wasm-zstd lz4js &&
  node make_mcap.mjs"""

import base64
import json
import os
import sqlite3
import struct

import numpy

WIDTH, HEIGHT, COUNT = 346, 260, 300
EPOCH_S = 1_700_000_000
EVENTS = [(5000 + 37 * i + i % 3, 7 * i % WIDTH, 11 * i % HEIGHT, i % 2) for i in range(COUNT)]
WORDS_PER_PACKET = 111  # of no particular kind: packets do not end with an event


class Cdr:
    """A little-endian CDR message."""

    def __init__(self):
        self.bytes = b""

    def number(self, code, value):
        size = struct.calcsize("<" + code)
        self.bytes += b"\0" * (-len(self.bytes) % size) + struct.pack("<" + code, value)

    def text(self, value):
        self.number("I", len(value) + 1)
        self.bytes += value.encode() + b"\0"

    def header(self):
        self.number("i", EPOCH_S)
        self.number("I", 0)
        self.text("camera")

    def message(self):
        return b"\0\1\0\0" + self.bytes


def packet(seq, events):
    cdr = Cdr()
    cdr.header()
    cdr.number("I", HEIGHT)
    cdr.number("I", WIDTH)
    cdr.number("Q", seq)
    cdr.number("Q", 0)
    cdr.text("evt3")
    cdr.number("B", 0)
    cdr.number("I", len(events))
    cdr.bytes += events
    return cdr.message()


def packets():
    words = []
    for t, x, y, p in EVENTS:
        words += [0x8000 | t >> 12 & 0xFFF, 0x6000 | t & 0xFFF, y, 0x2000 | p << 11 | x]
    for begin in range(0, len(words), WORDS_PER_PACKET):
        part = words[begin:begin + WORDS_PER_PACKET]
        yield packet(100 + begin // WORDS_PER_PACKET, struct.pack(f"<{len(part)}H", *part))


def event_arrays():
    for begin in range(0, COUNT, 70):
        cdr = Cdr()
        cdr.header()
        cdr.number("I", HEIGHT)
        cdr.number("I", WIDTH)
        part = EVENTS[begin:begin + 70]
        cdr.number("I", len(part))
        for t, x, y, p in part:
            cdr.number("H", x)
            cdr.number("H", y)
            cdr.number("i", EPOCH_S)
            cdr.number("I", t * 1000)
            cdr.number("B", p)
        yield cdr.message()


def write_bag(path, topics):
    """The tables of rosbag2_storage_sqlite3, version 4 of its schema."""
    if os.path.exists(path):
        os.remove(path)
    bag = sqlite3.connect(path)
    bag.executescript("""
        CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
        CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
        CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL,
          offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT NOT NULL);
        CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
          encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
        CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL);
        CREATE INDEX timestamp_idx ON messages (timestamp ASC);
        INSERT INTO schema VALUES (4, 'jazzy');""")
    stamp = EPOCH_S * 10**9
    for number, (name, kind, messages) in enumerate(topics, 1):
        bag.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '', '')", (number, name, kind))
        for message in messages:
            stamp += 10**6
            bag.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", (number, stamp, message))
    bag.commit()
    bag.close()


def main():
    chatter = ("/chatter", "std_msgs/msg/String", [b"\0\1\0\0\6\0\0\0hello\0"] * 3)
    write_bag("packets.db3", [chatter, ("/camera/events", "event_camera_msgs/msg/EventPacket", packets())])
    write_bag("event_arrays.db3", [("/dvs/events", "dvs_msgs/msg/EventArray", event_arrays()), chatter])
    with open("packets.json", "w", encoding="ascii") as file:
        json.dump([base64.b64encode(message).decode() for message in packets()], file)
    t, x, y, p = (numpy.array(column) for column in zip(*EVENTS))
    records = numpy.zeros(COUNT, dtype=[("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")])  # as Metavision's
    records["t"], records["x"], records["y"], records["p"] = t, x, y, p
    numpy.save("records.npy", records)
    numpy.save("rows.npy", numpy.stack([t * 1e-6, x, y, p * 2.0 - 1.0], axis=1))
    numpy.savez_compressed("lists.npz", size=numpy.zeros(3), x=x.astype(">u2"), y=y.astype("<i4"),
                           timestamp=t * 1e-6, polarity=p.astype(bool))
    numpy.savez("records.npz", labels=numpy.array(["a", "b"]), events=records)


main()

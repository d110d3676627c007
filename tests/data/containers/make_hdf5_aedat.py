#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes recordings of this folder in HDF5 with h5py and in AEDAT 4.0 with the FlatBuffers library. All hold the events of make.py;
events.aedat4 has them after 1,700,000,000 s. The files of Metavision have three triggers. The fuzzing seed events.hdf5 has ten events.
metavision_ecf.hdf5 is compressed by Prophesee's own filter (github.com/prophesee-ai/hdf5_ecf), whose plug-in must be in
HDF5_PLUGIN_PATH. metavision_time_shift.hdf5 has no filter, and the attribute time_shift as OpenEB's Camera::start_recording writes it:
the time of the first event, as a text.

  cd tests/data/containers && HDF5_PLUGIN_PATH=FOLDER_OF_THE_PLUGIN /usr/bin/python3 make_hdf5_aedat.py"""

import struct

import flatbuffers
import h5py
import lz4.frame
import numpy

WIDTH, HEIGHT, COUNT = 346, 260, 300
EPOCH_US = 1_700_000_000_000_000
EVENTS = [(5000 + 37 * i + i % 3, 7 * i % WIDTH, 11 * i % HEIGHT, i % 2) for i in range(COUNT)]
TRIGGERS = [(5100, 1, 0), (5200, 0, 0), (9000, 1, 3)]  # t, p, id
ECF = 0x8ECF


def write_metavision(path, attributes, **layout):
    events = numpy.zeros(COUNT, dtype=numpy.dtype(
        {"names": ["x", "y", "p", "t"], "formats": ["<u2", "<u2", "<i2", "<i8"], "offsets": [0, 2, 4, 8], "itemsize": 16}))
    triggers = numpy.zeros(len(TRIGGERS), dtype=numpy.dtype(
        {"names": ["p", "t", "id"], "formats": ["<i2", "<i8", "<i2"], "offsets": [0, 8, 16], "itemsize": 24}))
    events["t"], events["x"], events["y"], events["p"] = zip(*EVENTS)
    triggers["t"], triggers["p"], triggers["id"] = zip(*TRIGGERS)
    with h5py.File(path, "w") as file:
        file.attrs["version"] = "1.0"
        file.attrs["geometry"] = f"{WIDTH}x{HEIGHT}"
        for name, text in attributes.items():
            file.attrs[name] = text
        # Chunks of 128 events, so that the last one is not full.
        file.create_dataset("/CD/events", data=events, chunks=(128,), maxshape=(None,), **layout)
        file.create_dataset("/EXT_TRIGGER/events", data=triggers)


def write_dsec(path):
    with h5py.File(path, "w") as file:
        for name, kind, column in zip("txyp", ("<u4", "<u2", "<u2", "u1"), zip(*EVENTS)):
            file.create_dataset(f"/events/{name}", data=numpy.array(column, kind), chunks=(100,), compression="gzip")
        file["/ms_to_idx"] = numpy.arange(17, dtype="<u8")
        file["/t_offset"] = numpy.int64(49_599_300_523)


def write_seed(path):
    with h5py.File(path, "w") as file:
        for name, kind, column in zip("txyp", ("<u4", "<u2", "<u2", "u1"), zip(*EVENTS[:10])):
            file.create_dataset(f"/events/{name}", data=numpy.array(column, kind))


def finished(builder, table, identifier):
    builder.FinishSizePrefixed(table, identifier)
    return bytes(builder.Output())


def io_header():
    info = ('<dv version="2.0"><node name="outInfo" path="/mainloop/Recorder/outInfo/">'
            '<node name="0" path="/mainloop/Recorder/outInfo/0/"><attr key="compression" type="string">LZ4</attr>'
            '<attr key="typeIdentifier" type="string">EVTS</attr><node name="info" path="/mainloop/Recorder/outInfo/0/info/">'
            f'<attr key="sizeX" type="int">{WIDTH}</attr><attr key="sizeY" type="int">{HEIGHT}</attr>'
            '<attr key="source" type="string">DAVIS346_00000001</attr></node></node></node></dv>')
    builder = flatbuffers.Builder(0)
    text = builder.CreateString(info)
    builder.StartObject(3)
    builder.PrependInt32Slot(0, 1, 0)  # LZ4
    builder.PrependUOffsetTRelativeSlot(2, text, 0)
    return finished(builder, builder.EndObject(), b"IOHE")


def event_packet(events):
    builder = flatbuffers.Builder(0)
    builder.StartVector(16, len(events), 8)
    for t, x, y, p in reversed(events):
        builder.Prep(8, 16)
        builder.Pad(3)
        builder.PrependBool(p)
        builder.PrependInt16(y)
        builder.PrependInt16(x)
        builder.PrependInt64(EPOCH_US + t)
    vector = builder.EndVector()
    builder.StartObject(1)
    builder.PrependUOffsetTRelativeSlot(0, vector, 0)
    return finished(builder, builder.EndObject(), b"EVTS")


def write_aedat4(path):
    with open(path, "wb") as file:
        file.write(b"#!AER-DAT4.0\r\n" + io_header())
        for begin in range(0, COUNT, 70):
            content = lz4.frame.compress(event_packet(EVENTS[begin:begin + 70]))
            file.write(struct.pack("<ii", 0, len(content)) + content)


write_metavision("metavision_ecf.hdf5", {}, compression=ECF)
write_metavision("metavision_time_shift.hdf5", {"time_shift": str(EVENTS[0][0])})
write_dsec("dsec.hdf5")
write_seed("../../fuzz/seeds/containers/events.hdf5")
write_aedat4("events.aedat4")

#!/usr/bin/env node
// SPDX-License-Identifier: Apache-2.0
// Reads an MCAP file with the libraries of Foxglove and prints it as one JSON object: header, statistics, metadata, topics and
// messages, decoded by the schemas in the file. It checks all checksums, and that the schemas and messages that it has decoded have
// the bytes of the file when they are encoded again.
//
//     node read_mcap.mjs FILE [--stream] [--from NANOSECONDS]
//
// Reads by the index, or with --stream from the beginning, as a player reads a file without an end. --from reads messages from that log
// time on.
import { parse } from "@foxglove/rosmsg";
import { MessageReader, MessageWriter } from "@foxglove/rosmsg2-serialization";
import zstd from "@foxglove/wasm-zstd";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import assert from "node:assert/strict";
import { open, readFile } from "node:fs/promises";
import { parseArgs } from "node:util";

await zstd.isLoaded;
const decompressHandlers = { zstd: (bytes, size) => zstd.decompress(bytes, Number(size)) };

class Decoder {
  #codecs = new Map();
  topics = {};

  add(channel, schema) {
    if (this.#codecs.has(channel.id)) {
      return;
    }
    assert.equal(channel.messageEncoding, "cdr");
    assert.equal(schema.encoding, "ros2msg");
    const definitions = parse(new TextDecoder().decode(schema.data), { ros2: true });
    this.#codecs.set(channel.id, {
      topic: channel.topic,
      reader: new MessageReader(definitions),
      writer: new MessageWriter(definitions),
    });
    this.topics[channel.topic] = { type: schema.name, qos: channel.metadata.get("offered_qos_profiles") };
  }

  decode(message) {
    const { topic, reader, writer } = this.#codecs.get(message.channelId);
    const decoded = reader.readMessage(message.data);
    assert.deepEqual(Buffer.from(writer.writeMessage(decoded)), Buffer.from(message.data), topic);
    return {
      topic,
      sequence: message.sequence,
      log_time_ns: String(message.logTime),
      publish_time_ns: String(message.publishTime),
      message: decoded,
    };
  }
}

async function readByIndex(path, startTime) {
  const file = await open(path);
  const readable = {
    size: async () => BigInt((await file.stat()).size),
    read: async (offset, size) => {
      const bytes = new Uint8Array(Number(size));
      const { bytesRead } = await file.read(bytes, 0, bytes.length, Number(offset));
      assert.equal(bytesRead, bytes.length);
      return bytes;
    },
  };
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  const decoder = new Decoder();
  for (const channel of reader.channelsById.values()) {
    decoder.add(channel, reader.schemasById.get(channel.schemaId));
  }
  const messages = [];
  for await (const message of reader.readMessages({ startTime, validateCrcs: true })) {
    messages.push(decoder.decode(message));
  }
  const metadata = {};
  for await (const record of reader.readMetadata()) {
    metadata[record.name] = Object.fromEntries(record.metadata);
  }
  await file.close();
  const statistics = {
    messages: Number(reader.statistics.messageCount),
    chunks: reader.statistics.chunkCount,
    channels: reader.statistics.channelCount,
    start_ns: String(reader.statistics.messageStartTime),
    end_ns: String(reader.statistics.messageEndTime),
    by_topic: Object.fromEntries(
      [...reader.statistics.channelMessageCounts].map(([id, count]) => [reader.channelsById.get(id).topic, Number(count)]),
    ),
  };
  return { header: reader.header, statistics, metadata, topics: decoder.topics, messages };
}

async function readAsStream(path) {
  const reader = new McapStreamReader({ decompressHandlers, validateCrcs: true });
  reader.append(await readFile(path));
  const decoder = new Decoder();
  const schemas = new Map();
  const messages = [];
  for (let record; (record = reader.nextRecord()); ) {
    if (record.type === "Schema") {
      schemas.set(record.id, record);
    } else if (record.type === "Channel") {
      decoder.add(record, schemas.get(record.schemaId));
    } else if (record.type === "Message") {
      messages.push(decoder.decode(record));
    }
  }
  return { is_complete: reader.done(), topics: decoder.topics, messages };
}

const { values, positionals } = parseArgs({
  allowPositionals: true,
  options: { stream: { type: "boolean" }, from: { type: "string" } },
});
const startTime = values.from == null ? undefined : BigInt(values.from);
const result = values.stream ? await readAsStream(positionals[0]) : await readByIndex(positionals[0], startTime);
const toJson = (key, value) => {
  if (value instanceof Uint8Array) {
    return Buffer.from(value).toString("base64");
  }
  if (ArrayBuffer.isView(value)) {
    return [...value];
  }
  return Object.is(value, -0) ? "-0" : value;
};
process.stdout.write(JSON.stringify(result, toJson));

// SPDX-License-Identifier: Apache-2.0

// Writes packets.json, which make.py has made, with Foxglove's writer of MCAP: packets.mcap with chunks in zstd and an index,
// packets_lz4.mcap with chunks in lz4 (by lz4js, which does not use the library of lz4), and packets_plain.mcap without compression,
// chunks and index.
import { readFileSync, writeFileSync } from "fs";
import { McapWriter } from "@mcap/core";
import lz4 from "lz4js";
import zstd from "@foxglove/wasm-zstd";

class Memory {
  bytes = Buffer.alloc(0);
  position() { return BigInt(this.bytes.length); }
  async write(buffer) { this.bytes = Buffer.concat([this.bytes, buffer]); }
}

async function write(path, options) {
  const memory = new Memory();
  const writer = new McapWriter({ writable: memory, ...options });
  await writer.start({ profile: "ros2", library: "make_mcap.mjs" });
  const schemaId = await writer.registerSchema({ name: "event_camera_msgs/msg/EventPacket", encoding: "ros2msg", data: new Uint8Array() });
  const textSchemaId = await writer.registerSchema({ name: "std_msgs/msg/String", encoding: "ros2msg", data: new Uint8Array() });
  const channelId = await writer.registerChannel({ schemaId, topic: "/camera/events", messageEncoding: "cdr", metadata: new Map() });
  const textId = await writer.registerChannel({ schemaId: textSchemaId, topic: "/chatter", messageEncoding: "cdr", metadata: new Map() });
  let time = 1_700_000_000_000_000_000n;
  for (const message of JSON.parse(readFileSync("packets.json"))) {
    const data = Buffer.from(message, "base64");
    for (const [id, bytes] of [[textId, Buffer.from([0, 1, 0, 0, 1, 0, 0, 0, 0])], [channelId, data]]) {
      await writer.addMessage({ channelId: id, sequence: 0, logTime: time, publishTime: time, data: bytes });
      time += 1_000_000n;
    }
  }
  await writer.end();
  writeFileSync(path, memory.bytes);
}

await zstd.isLoaded;
await write("packets.mcap", {
  useStatistics: true, useChunks: true, useChunkIndex: true, chunkSize: 1000,
  compressChunk: (data) => ({ compression: "zstd", compressedData: zstd.compress(data, 3) }),
});
await write("packets_lz4.mcap", {
  useStatistics: true, useChunks: true, useChunkIndex: true, chunkSize: 1000,
  compressChunk: (data) => ({ compression: "lz4", compressedData: lz4.compress(data) }),
});
await write("packets_plain.mcap", {
  useStatistics: false, useChunks: false, useChunkIndex: false, useMessageIndex: false, repeatChannels: false, repeatSchemas: false,
  useSummaryOffsets: false,
});

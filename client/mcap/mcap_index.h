// SPDX-License-Identifier: Apache-2.0

// The summary of an MCAP file (https://mcap.dev/spec), by which a reader finds messages.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "client/mcap/byte_writer.h"

namespace evpose::client {

// Size of an entry of a Message Index record: time and position of a message.
inline constexpr size_t kMcapIndexEntryBytes = 16;

// A chunk of messages and the records with the positions of its messages behind it. Positions are from the start of the
// file, lengths include the head of the record.
struct McapChunk {
  uint64_t start_ns = 0;  // earliest log time
  uint64_t end_ns = 0;    // latest log time
  uint64_t begin = 0;
  uint64_t length = 0;
  std::map<uint16_t, uint64_t> message_indexes;  // position of the Message Index record of each channel
  uint64_t message_index_length = 0;
  std::string compression;  // "zstd"; empty: none
  uint64_t stored_bytes = 0;
  uint64_t num_bytes = 0;  // without compression
};

struct McapMetadata {
  uint64_t begin = 0;
  uint64_t length = 0;
  std::string name;
  std::map<std::string, std::string> values;
};

struct McapIndex {
  std::vector<std::string> schemas;   // contents of the Schema records
  std::vector<std::string> channels;  // contents of the Channel records
  std::vector<McapMetadata> metadata;
  std::vector<McapChunk> chunks;
  std::map<uint16_t, uint64_t> num_messages;  // by channel

  // All bytes after the data section, which ends at `data_end`: DataEnd, summary, Footer and magic.
  std::string MakeEnd(uint64_t data_end) const;
};

// Appends a record to `out`.
void PutRecord(uint8_t op, std::string_view content, ByteWriter& out);
void PutStrings(const std::map<std::string, std::string>& values, ByteWriter& out);

// Reads the index of the first `size` bytes of a file that this project has begun to write: the magic and whole records
// of the data section, with schemas and channels outside the chunks. Errors have the path: NOT_FOUND and similar codes
// if the file cannot be read; DATA_LOSS if it has other bytes.
absl::StatusOr<McapIndex> ReadMcapIndex(const std::string& path, uint64_t size);

}  // namespace evpose::client

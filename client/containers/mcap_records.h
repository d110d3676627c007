// SPDX-License-Identifier: Apache-2.0

// The records of an MCAP file (https://mcap.dev/spec), in its order, those inside chunks included. No index is needed.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "client/containers/compression/frame_decompressor.h"
#include "core/recordings/byte_source.h"
#include "core/recordings/recording_reader.h"

namespace evpose::client {

inline constexpr std::string_view kMcapMagic("\x89MCAP0\r\n", 8);

struct McapRecord {
  enum Op : uint8_t {
    kHeader = 1,
    kFooter = 2,
    kSchema = 3,
    kChannel = 4,
    kMessage = 5,
    kChunk = 6,
    kMessageIndex = 7,
    kChunkIndex = 8,
    kStatistics = 11,
    kMetadata = 12,
    kMetadataIndex = 13,
    kSummaryOffset = 14,
    kDataEnd = 15
  };
  static constexpr size_t kHeadBytes = 9;  // op, and the length of the content in 64 bits

  uint8_t op = 0;
  std::string_view content;  // valid until the next record is read
};

// The checksum of chunks and of the summary: CRC-32 as in zlib.
uint32_t McapCrc32(std::string_view bytes);

class McapRecords {
 public:
  // `bytes` begin behind the magic.
  explicit McapRecords(std::unique_ptr<ByteSource> bytes) : bytes_(std::move(bytes)) {}

  // The next Schema, Channel, Message, DataEnd or Footer record; nullopt at the end. Errors: those of ByteSource.
  absl::StatusOr<std::optional<McapRecord>> Next();
  std::vector<SkippedParts> skipped() const;

 private:
  // The next record inside the current chunk.
  std::optional<McapRecord> NextInChunk();
  // The content of the frames of a chunk; nullopt if it is damaged or does not have `size` bytes.
  std::optional<std::string_view> Decompress(FrameFormat format, std::string_view frames, uint64_t size);
  // Decompresses a chunk and makes it the current one; counts a damaged one.
  void OpenChunk(std::string_view content);
  // Fills `buffer` with `size` bytes; false if the file ends before.
  absl::StatusOr<bool> ReadExactly(uint64_t size, std::string& buffer);
  // Passes over `size` bytes; false if the file ends before.
  absl::StatusOr<bool> PassOver(uint64_t size);

  std::unique_ptr<ByteSource> bytes_;
  std::string head_;     // op and length of a record
  std::string content_;  // content of a record of the file
  FrameDecompressor decompressor_;
  std::string_view chunk_rest_;  // rest of the records of a chunk, in `content_` or `decompressor_`
  bool is_at_end_ = false;
  uint64_t num_truncated_ = 0;
  uint64_t num_large_ = 0;
  uint64_t num_damaged_chunks_ = 0;
};

}  // namespace evpose::client

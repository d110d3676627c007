// SPDX-License-Identifier: Apache-2.0
#include "client/containers/mcap_records.h"

#include <zlib.h>

#include <algorithm>

#include "client/containers/bag.h"
#include "client/containers/byte_view.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr size_t kPieceBytes = size_t{64} * 1024;  // in which content is read, so that a wrong length costs nothing

bool IsWanted(uint8_t op) {
  switch (op) {
    case McapRecord::kSchema:
    case McapRecord::kChannel:
    case McapRecord::kMessage:
    case McapRecord::kDataEnd:
    case McapRecord::kFooter:
      return true;
    default:
      return false;
  }
}

}  // namespace

uint32_t McapCrc32(std::string_view bytes) {
  return static_cast<uint32_t>(crc32_z(0, reinterpret_cast<const Bytef*>(bytes.data()), bytes.size()));
}

absl::StatusOr<bool> McapRecords::ReadExactly(uint64_t size, std::string& buffer) {
  buffer.clear();
  while (buffer.size() < size) {
    const size_t begin = buffer.size();
    buffer.resize(std::min<uint64_t>(size, begin + kPieceBytes));
    const absl::Span<uint8_t> piece(reinterpret_cast<uint8_t*>(buffer.data()) + begin, buffer.size() - begin);
    EVPOSE_ASSIGN_OR_RETURN(const size_t num_read, bytes_->Read(piece));
    buffer.resize(begin + num_read);
    if (num_read == 0) return false;
  }
  return true;
}

absl::StatusOr<bool> McapRecords::PassOver(uint64_t size) {
  while (size > 0) {
    const uint64_t piece = std::min<uint64_t>(size, kPieceBytes);
    EVPOSE_ASSIGN_OR_RETURN(const bool is_complete, ReadExactly(piece, content_));
    if (!is_complete) return false;
    size -= piece;
  }
  return true;
}

std::optional<std::string_view> McapRecords::Decompress(FrameFormat format, std::string_view frames, uint64_t size) {
  absl::Span<const uint8_t> rest(reinterpret_cast<const uint8_t*>(frames.data()), frames.size());
  decompressor_.Clear();
  while (!rest.empty()) {
    if (!decompressor_.Append(format, rest, size).ok()) return std::nullopt;
  }
  const absl::Span<const uint8_t> content = decompressor_.content();
  if (content.size() != size) return std::nullopt;
  return std::string_view(reinterpret_cast<const char*>(content.data()), content.size());
}

void McapRecords::OpenChunk(std::string_view content) {
  ByteView view(content);
  view.TakeBytes(16);  // times of the first and the last message
  const auto size = view.Take<uint64_t>();
  const auto crc = view.Take<uint32_t>();
  const std::string_view compression = view.TakeString();
  const std::string_view records = view.TakeBytes(view.Take<uint64_t>());
  std::optional<std::string_view> chunk;
  if (!view.ok() || size > kMaxMessageBytes) {
    chunk = std::nullopt;
  } else if (compression == "zstd") {
    chunk = Decompress(FrameFormat::kZstd, records, size);
  } else if (compression == "lz4") {
    chunk = Decompress(FrameFormat::kLz4, records, size);
  } else if (compression.empty() && size == records.size()) {
    chunk = records;
  }
  if (chunk && crc != 0 && crc != McapCrc32(*chunk)) chunk = std::nullopt;  // 0: the writer computed none
  num_damaged_chunks_ += chunk ? 0 : 1;
  chunk_rest_ = chunk.value_or(std::string_view());
}

std::optional<McapRecord> McapRecords::NextInChunk() {
  while (!chunk_rest_.empty()) {
    ByteView view(chunk_rest_);
    McapRecord record;
    record.op = view.Take<uint8_t>();
    record.content = view.TakeBytes(view.Take<uint64_t>());
    chunk_rest_ = view.ok() ? view.rest() : std::string_view();
    num_damaged_chunks_ += view.ok() ? 0 : 1;
    if (view.ok() && IsWanted(record.op)) return record;
  }
  return std::nullopt;
}

absl::StatusOr<std::optional<McapRecord>> McapRecords::Next() {
  while (!is_at_end_) {
    if (const std::optional<McapRecord> record = NextInChunk()) return record;
    EVPOSE_ASSIGN_OR_RETURN(bool is_complete, ReadExactly(McapRecord::kHeadBytes, head_));
    if (!is_complete) {
      num_truncated_ += 1;
      break;
    }
    ByteView head(head_);
    const auto op = head.Take<uint8_t>();
    const auto size = head.Take<uint64_t>();
    const bool is_chunk = op == McapRecord::kChunk;
    const bool is_kept = (is_chunk || IsWanted(op)) && size <= kMaxMessageBytes;
    num_large_ += (is_chunk || IsWanted(op)) && !is_kept ? 1 : 0;
    EVPOSE_ASSIGN_OR_RETURN(is_complete, is_kept ? ReadExactly(size, content_) : PassOver(size));
    if (!is_complete) {
      num_truncated_ += 1;
      break;
    }
    if (is_chunk && is_kept) OpenChunk(content_);
    if (op == McapRecord::kDataEnd || op == McapRecord::kFooter) is_at_end_ = true;
    if (!is_chunk && is_kept) return McapRecord{op, content_};
  }
  is_at_end_ = true;
  return std::nullopt;
}

std::vector<SkippedParts> McapRecords::skipped() const {
  std::vector<SkippedParts> parts;
  if (num_damaged_chunks_ > 0) parts.push_back({"damaged chunks", num_damaged_chunks_});
  if (num_large_ > 0) parts.push_back({"records above 64 MiB", num_large_});
  if (num_truncated_ > 0) parts.push_back({"truncated end: messages may be missing", num_truncated_});
  return parts;
}

}  // namespace evpose::client

// SPDX-License-Identifier: Apache-2.0
#include "client/mcap/mcap_index.h"

#include <algorithm>
#include <cerrno>
#include <fstream>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/containers/byte_view.h"
#include "client/containers/mcap_records.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// The records of a summary, in groups by their op.
class Summary {
 public:
  explicit Summary(uint64_t begin) : begin_(begin) {}

  void BeginGroup(uint8_t op) {
    EndGroup();
    op_ = op;
    group_begin_ = position();
  }
  void Put(std::string_view content) { PutRecord(op_, content, records_); }
  // Ends the summary with the positions of its groups and the Footer.
  std::string_view Finish() {
    EndGroup();
    const uint64_t offsets_begin = position();
    records_.PutBytes(offsets_.bytes());
    // The checksum covers the Footer up to itself.
    records_.Put<uint8_t>(McapRecord::kFooter);
    records_.Put<uint64_t>(20);
    records_.Put(begin_);
    records_.Put(offsets_begin);
    records_.Put(McapCrc32(records_.bytes()));
    return records_.bytes();
  }

 private:
  uint64_t position() const { return begin_ + records_.size(); }
  void EndGroup() {
    if (position() == group_begin_ || op_ == 0) return;
    ByteWriter offset;
    offset.Put(op_);
    offset.Put(group_begin_);
    offset.Put(position() - group_begin_);
    PutRecord(McapRecord::kSummaryOffset, offset.bytes(), offsets_);
  }

  const uint64_t begin_;
  ByteWriter records_;
  ByteWriter offsets_;
  uint8_t op_ = 0;
  uint64_t group_begin_ = 0;
};

void PutCounts(const std::map<uint16_t, uint64_t>& counts, ByteWriter& out) {
  out.Put(static_cast<uint32_t>(counts.size() * 10));
  for (const auto& [channel, count] : counts) {
    out.Put(channel);
    out.Put(count);
  }
}

std::string StatisticsContent(const McapIndex& index) {
  uint64_t total = 0, start_ns = std::numeric_limits<uint64_t>::max(), end_ns = 0;
  for (const auto& [channel, count] : index.num_messages) total += count;
  for (const McapChunk& chunk : index.chunks) {
    start_ns = std::min(start_ns, chunk.start_ns);
    end_ns = std::max(end_ns, chunk.end_ns);
  }
  ByteWriter content;
  content.Put(total);
  content.Put(static_cast<uint16_t>(index.schemas.size()));
  content.Put(static_cast<uint32_t>(index.channels.size()));
  content.Put<uint32_t>(0);  // attachments
  content.Put(static_cast<uint32_t>(index.metadata.size()));
  content.Put(static_cast<uint32_t>(index.chunks.size()));
  content.Put(index.chunks.empty() ? uint64_t{0} : start_ns);
  content.Put(end_ns);
  PutCounts(index.num_messages, content);
  return std::string(content.bytes());
}

std::string ChunkIndexContent(const McapChunk& chunk) {
  ByteWriter content;
  content.Put(chunk.start_ns);
  content.Put(chunk.end_ns);
  content.Put(chunk.begin);
  content.Put(chunk.length);
  PutCounts(chunk.message_indexes, content);
  content.Put(chunk.message_index_length);
  content.PutString(chunk.compression);
  content.Put(chunk.stored_bytes);
  content.Put(chunk.num_bytes);
  return std::string(content.bytes());
}

std::string MetadataIndexContent(const McapMetadata& metadata) {
  ByteWriter content;
  content.Put(metadata.begin);
  content.Put(metadata.length);
  content.PutString(metadata.name);
  return std::string(content.bytes());
}

// Reads the records of a data section from a file.
class IndexReader {
 public:
  IndexReader(const std::string& path, uint64_t size) : path_(path), size_(size), file_(path, std::ios::binary) {}

  absl::StatusOr<McapIndex> Read() {
    if (!file_) return absl::ErrnoToStatus(errno, absl::StrCat(path_, ": cannot be read"));
    EVPOSE_ASSIGN_OR_RETURN(const std::string magic, Take(kMcapMagic.size()));
    if (magic != kMcapMagic) return Damaged("is not an MCAP file");
    while (position_ < size_) EVPOSE_RETURN_IF_ERROR(ReadRecord());
    return std::move(index_);
  }

 private:
  absl::Status Damaged(std::string_view what) const {
    return absl::DataLossError(absl::StrCat(path_, ": ", std::string(what), ", at byte ", position_));
  }

  absl::StatusOr<std::string> Take(uint64_t size) {
    if (size > size_ - position_) return Damaged("has an incomplete record");
    std::string bytes(size, '\0');
    if (!file_.read(bytes.data(), static_cast<std::streamsize>(size))) return Damaged("ends");
    position_ += size;
    return bytes;
  }

  absl::Status Skip(uint64_t size) {
    if (size > size_ - position_) return Damaged("has an incomplete record");
    position_ += size;
    file_.seekg(static_cast<std::streamoff>(position_));
    return absl::OkStatus();
  }

  absl::Status ReadRecord() {
    const uint64_t begin = position_;
    EVPOSE_ASSIGN_OR_RETURN(const std::string head, Take(McapRecord::kHeadBytes));
    ByteView view(head);
    const auto op = view.Take<uint8_t>();
    const auto length = view.Take<uint64_t>();
    if (op == McapRecord::kHeader) return Skip(length);
    if (op == McapRecord::kChunk) return ReadChunk(begin, length);
    EVPOSE_ASSIGN_OR_RETURN(std::string content, Take(length));
    if (op == McapRecord::kSchema) {
      index_.schemas.push_back(std::move(content));
    } else if (op == McapRecord::kChannel) {
      index_.channels.push_back(std::move(content));
    } else if (op == McapRecord::kMessageIndex) {
      return AddMessageIndex(begin, content);
    } else if (op == McapRecord::kMetadata) {
      return AddMetadata(begin, content);
    } else {
      return Damaged(absl::StrCat("has a record of type ", op, ", which is not written there"));
    }
    return absl::OkStatus();
  }

  absl::Status ReadChunk(uint64_t begin, uint64_t length) {
    // Times, size, checksum, the length of the compression's name, at most four bytes of it, the length of the records.
    constexpr uint64_t kMaxFieldsBytes = 8 + 8 + 8 + 4 + 4 + 4 + 8;
    EVPOSE_ASSIGN_OR_RETURN(const std::string fields, Take(std::min(length, kMaxFieldsBytes)));
    ByteView view(fields);
    McapChunk chunk = {.begin = begin, .length = McapRecord::kHeadBytes + length};
    chunk.start_ns = view.Take<uint64_t>();
    chunk.end_ns = view.Take<uint64_t>();
    chunk.num_bytes = view.Take<uint64_t>();
    view.Take<uint32_t>();  // checksum
    chunk.compression = view.TakeString();
    chunk.stored_bytes = view.Take<uint64_t>();
    if (!view.ok()) return Damaged("has a damaged chunk");
    index_.chunks.push_back(std::move(chunk));
    return Skip(length - fields.size());
  }

  absl::Status AddMessageIndex(uint64_t begin, std::string_view content) {
    ByteView view(content);
    const auto channel = view.Take<uint16_t>();
    const auto num_bytes = view.Take<uint32_t>();
    if (!view.ok() || view.rest().size() != num_bytes || index_.chunks.empty()) return Damaged("has a damaged index");
    McapChunk& chunk = index_.chunks.back();
    chunk.message_indexes[channel] = begin;
    chunk.message_index_length += McapRecord::kHeadBytes + content.size();
    index_.num_messages[channel] += num_bytes / kMcapIndexEntryBytes;
    return absl::OkStatus();
  }

  absl::Status AddMetadata(uint64_t begin, std::string_view content) {
    ByteView view(content);
    McapMetadata metadata = {.begin = begin, .length = McapRecord::kHeadBytes + content.size()};
    metadata.name = view.TakeString();
    ByteView values(view.TakeString());
    while (values.ok() && !values.rest().empty()) {
      const std::string key(values.TakeString());
      metadata.values[key] = values.TakeString();
    }
    if (!view.ok() || !values.ok()) return Damaged("has damaged metadata");
    index_.metadata.push_back(std::move(metadata));
    return absl::OkStatus();
  }

  const std::string path_;
  const uint64_t size_;
  std::ifstream file_;
  uint64_t position_ = 0;
  McapIndex index_;
};

}  // namespace

void PutRecord(uint8_t op, std::string_view content, ByteWriter& out) {
  out.Put(op);
  out.Put(static_cast<uint64_t>(content.size()));
  out.PutBytes(content);
}

void PutStrings(const std::map<std::string, std::string>& values, ByteWriter& out) {
  ByteWriter entries;
  for (const auto& [key, value] : values) {
    entries.PutString(key);
    entries.PutString(value);
  }
  out.PutString(entries.bytes());
}

std::string McapIndex::MakeEnd(uint64_t data_end) const {
  ByteWriter end;
  PutRecord(McapRecord::kDataEnd, std::string(4, '\0'), end);  // no checksum of the data section: chunks have their own
  Summary summary(data_end + end.size());
  summary.BeginGroup(McapRecord::kSchema);
  for (const std::string& content : schemas) summary.Put(content);
  summary.BeginGroup(McapRecord::kChannel);
  for (const std::string& content : channels) summary.Put(content);
  summary.BeginGroup(McapRecord::kStatistics);
  summary.Put(StatisticsContent(*this));
  summary.BeginGroup(McapRecord::kChunkIndex);
  for (const McapChunk& chunk : chunks) summary.Put(ChunkIndexContent(chunk));
  summary.BeginGroup(McapRecord::kMetadataIndex);
  for (const McapMetadata& each : metadata) summary.Put(MetadataIndexContent(each));
  return absl::StrCat(std::string(end.bytes()), std::string(summary.Finish()), std::string(kMcapMagic));
}

absl::StatusOr<McapIndex> ReadMcapIndex(const std::string& path, uint64_t size) {
  return IndexReader(path, size).Read();
}

}  // namespace evpose::client

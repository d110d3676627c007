// SPDX-License-Identifier: Apache-2.0
#include "client/mcap/mcap_writer.h"

#include <zstd.h>

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "client/containers/byte_view.h"
#include "client/containers/mcap_records.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr int kZstdLevel = 1;  // higher levels save some percent for several times the time

// The quality of service of a publisher, as rosbag2 stores it: keep the last messages, deliver reliably; zero durations
// mean the defaults. The values are numbers, because older versions of rosbag2 do not read their names.
std::string QosProfile(bool is_latched) {
  constexpr char kZero[] = "\n    sec: 0\n    nsec: 0\n";
  return absl::StrCat("- history: 1\n  depth: ", is_latched ? 1 : 10,
                      "\n  reliability: 1\n  durability: ", is_latched ? 1 : 2, "\n  deadline:", kZero,
                      "  lifespan:", kZero, "  liveliness: 1\n  liveliness_lease_duration:", kZero,
                      "  avoid_ros_namespace_conventions: false\n");
}

}  // namespace

McapWriter::McapWriter(OutputFile file, const McapWriterOptions& options)
    : file_(std::move(file)), options_(options), zstd_(ZSTD_createCCtx(), ZSTD_freeCCtx) {}

absl::StatusOr<McapWriter> McapWriter::Create(const std::string& path, const McapWriterOptions& options) {
  EVPOSE_ASSIGN_OR_RETURN(OutputFile file, OutputFile::Create(path));
  McapWriter writer(std::move(file), options);
  writer.WriteHeader();
  return writer;
}

absl::StatusOr<McapWriter> McapWriter::Continue(const std::string& path, uint64_t kept_bytes,
                                                const McapWriterOptions& options) {
  EVPOSE_ASSIGN_OR_RETURN(OutputFile file, OutputFile::Continue(path, kept_bytes));
  McapWriter writer(std::move(file), options);
  if (kept_bytes == 0) {
    writer.WriteHeader();
    return writer;
  }
  EVPOSE_ASSIGN_OR_RETURN(writer.index_, ReadMcapIndex(writer.file_.present_path(), kept_bytes));
  writer.size_ = kept_bytes;
  writer.ReadTopics();
  return writer;
}

void McapWriter::Append(std::string_view bytes) {
  file_.Append(bytes).IgnoreError();  // Commit() returns the error
  size_ += bytes.size();
}

void McapWriter::AppendRecord(uint8_t op, std::string_view content) {
  ByteWriter record;
  PutRecord(op, content, record);
  Append(record.bytes());
}

void McapWriter::WriteHeader() {
  ByteWriter content;
  content.PutString("ros2");
  content.PutString(options_.library);
  Append(kMcapMagic);
  AppendRecord(McapRecord::kHeader, content.bytes());
}

void McapWriter::ReadTopics() {
  for (const std::string& content : index_.schemas) {
    ByteView view(content);
    const auto id = view.Take<uint16_t>();
    schemas_.emplace(view.TakeString(), id);
  }
  for (const std::string& content : index_.channels) {
    ByteView view(content);
    const auto id = view.Take<uint16_t>();
    view.Take<uint16_t>();  // schema
    channels_.emplace(view.TakeString(), id);
  }
  for (const auto& [channel, count] : index_.num_messages) sequence_[channel] = static_cast<uint32_t>(count);
}

void McapWriter::AddMetadata(const std::string& name, const std::map<std::string, std::string>& values) {
  ByteWriter content;
  content.PutString(name);
  PutStrings(values, content);
  const uint64_t begin = size_;
  AppendRecord(McapRecord::kMetadata, content.bytes());
  index_.metadata.push_back({.begin = begin, .length = size_ - begin, .name = name, .values = values});
}

uint16_t McapWriter::AddSchema(const McapTopic& topic) {
  const auto [known, is_new] = schemas_.try_emplace(topic.type, static_cast<uint16_t>(schemas_.size() + 1));
  if (!is_new) return known->second;
  ByteWriter content;
  content.Put(known->second);
  content.PutString(topic.type);
  content.PutString("ros2msg");
  content.PutString(topic.definition);
  index_.schemas.emplace_back(content.bytes());
  AppendRecord(McapRecord::kSchema, content.bytes());
  return known->second;
}

uint16_t McapWriter::AddTopic(const McapTopic& topic) {
  const auto [known, is_new] = channels_.try_emplace(topic.name, static_cast<uint16_t>(channels_.size() + 1));
  if (!is_new) return known->second;
  // Outside the chunks and therefore before the present one, so that an index can be made without decompression.
  const uint16_t schema = AddSchema(topic);
  ByteWriter content;
  content.Put(known->second);
  content.Put(schema);
  content.PutString(topic.name);
  content.PutString("cdr");
  PutStrings({{"offered_qos_profiles", QosProfile(topic.is_latched)}}, content);
  index_.channels.emplace_back(content.bytes());
  AppendRecord(McapRecord::kChannel, content.bytes());
  return known->second;
}

std::optional<uint16_t> McapWriter::FindTopic(std::string_view name) const {
  const auto known = channels_.find(name);
  return known == channels_.end() ? std::nullopt : std::optional(known->second);
}

void McapWriter::Write(uint16_t channel, uint64_t log_time_ns, std::string_view message) {
  if (records_.size() > 0) {
    const uint64_t span_ns = std::max(end_ns_, log_time_ns) - std::min(start_ns_, log_time_ns);
    if (records_.size() + message.size() > options_.chunk_bytes || span_ns >= options_.chunk_ns) EndChunk();
  }
  const bool is_first = records_.size() == 0;
  start_ns_ = is_first ? log_time_ns : std::min(start_ns_, log_time_ns);
  end_ns_ = is_first ? log_time_ns : std::max(end_ns_, log_time_ns);
  positions_[channel].emplace_back(log_time_ns, records_.size());
  ByteWriter fields;
  fields.Put(channel);
  fields.Put(sequence_[channel]++);
  fields.Put(log_time_ns);
  fields.Put(log_time_ns);  // time of publication
  records_.Put<uint8_t>(McapRecord::kMessage);
  records_.Put(static_cast<uint64_t>(fields.size() + message.size()));
  records_.PutBytes(fields.bytes());
  records_.PutBytes(message);
}

std::string_view McapWriter::Compressed(std::string_view records) {
  compressed_.resize(ZSTD_compressBound(records.size()));
  const size_t size = ZSTD_compressCCtx(zstd_.get(), compressed_.data(), compressed_.size(), records.data(),
                                        records.size(), kZstdLevel);
  return std::string_view(compressed_).substr(0, size);  // cannot fail: the buffer has the size of the worst case
}

void McapWriter::EndChunk() {
  if (records_.size() == 0) return;
  const std::string_view stored = options_.compresses ? Compressed(records_.bytes()) : records_.bytes();
  McapChunk chunk = {.start_ns = start_ns_,
                     .end_ns = end_ns_,
                     .begin = size_,
                     .compression = options_.compresses ? "zstd" : "",
                     .stored_bytes = stored.size(),
                     .num_bytes = records_.size()};
  ByteWriter fields;
  fields.Put(start_ns_);
  fields.Put(end_ns_);
  fields.Put(chunk.num_bytes);
  fields.Put(McapCrc32(records_.bytes()));
  fields.PutString(chunk.compression);
  fields.Put(chunk.stored_bytes);
  ByteWriter head;
  head.Put<uint8_t>(McapRecord::kChunk);
  head.Put(static_cast<uint64_t>(fields.size() + stored.size()));
  Append(head.bytes());
  Append(fields.bytes());
  Append(stored);
  chunk.length = size_ - chunk.begin;
  const uint64_t indexes_begin = size_;
  for (auto& [channel, messages] : positions_) {
    // Messages of several sources come in turns, so that their times may step back.
    std::stable_sort(messages.begin(), messages.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
    ByteWriter content;
    content.Put(channel);
    content.Put(static_cast<uint32_t>(messages.size() * kMcapIndexEntryBytes));
    for (const auto& [time_ns, position] : messages) {
      content.Put(time_ns);
      content.Put(position);
    }
    chunk.message_indexes[channel] = size_;
    index_.num_messages[channel] += messages.size();
    AppendRecord(McapRecord::kMessageIndex, content.bytes());
  }
  chunk.message_index_length = size_ - indexes_begin;
  index_.chunks.push_back(std::move(chunk));
  records_.Clear();
  positions_.clear();
  file_.Flush().IgnoreError();  // Commit() returns the error
}

absl::StatusOr<uint64_t> McapWriter::Sync() {
  EndChunk();
  return file_.Sync();
}

absl::Status McapWriter::Commit() {
  EndChunk();
  Append(index_.MakeEnd(size_));
  return file_.Commit();
}

}  // namespace evpose::client

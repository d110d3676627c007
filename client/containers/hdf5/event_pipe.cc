// SPDX-License-Identifier: Apache-2.0
#include "client/containers/hdf5/event_pipe.h"

#include "core/base/byte_order.h"

namespace evpose::client {
namespace {

constexpr size_t kRecordHeaderBytes = 5;  // kind, then the size of the content in 32 bits
constexpr size_t kPipeEventBytes = 13;
constexpr size_t kPipeTriggerBytes = 10;
constexpr size_t kFixedHeaderBytes = 24;  // before the name of the format
constexpr size_t kMaxContentBytes = kMaxPipeElements * kPipeEventBytes;
constexpr size_t kMaxNameBytes = 256;  // a name of a format has some 30 bytes
constexpr int kMaxSizePx = 1 << 16;    // coordinates have 16 bits

void AppendRecordHeader(PipeRecordKind kind, size_t content_bytes, std::vector<uint8_t>& out) {
  out.push_back(static_cast<uint8_t>(kind));
  AppendLittleEndian(static_cast<uint32_t>(content_bytes), out);
}

bool ParseHeader(absl::Span<const uint8_t> content, PipeHeader& header) {
  if (content.size() < kFixedHeaderBytes || content.size() > kFixedHeaderBytes + kMaxNameBytes) return false;
  const auto width = LoadLittleEndian<uint32_t>(content.data());
  const auto height = LoadLittleEndian<uint32_t>(content.data() + 4);
  if (width > kMaxSizePx || height > kMaxSizePx) return false;
  header.geometry = {static_cast<int>(width), static_cast<int>(height)};
  header.time_offset_us = LoadLittleEndian<int64_t>(content.data() + 8);
  if (header.time_offset_us < -kMaxStateTimeUs || header.time_offset_us > kMaxStateTimeUs) return false;
  header.metavision_zero_us = LoadLittleEndian<int64_t>(content.data() + 16);
  if (header.metavision_zero_us < -1 || header.metavision_zero_us > kMaxStateTimeUs) return false;
  header.format.assign(content.begin() + kFixedHeaderBytes, content.end());
  return true;
}

bool ParseEvents(absl::Span<const uint8_t> content, std::vector<Event>& events) {
  if (content.size() % kPipeEventBytes != 0) return false;
  events.clear();
  for (; !content.empty(); content.remove_prefix(kPipeEventBytes)) {
    const uint8_t* const bytes = content.data();
    const Event event = {LoadLittleEndian<int64_t>(bytes), LoadLittleEndian<uint16_t>(bytes + 8),
                         LoadLittleEndian<uint16_t>(bytes + 10), bytes[12]};
    if (event.t_us < 0 || event.t_us > kMaxStateTimeUs || event.polarity > 1) return false;
    events.push_back(event);
  }
  return true;
}

bool ParseTriggers(absl::Span<const uint8_t> content, std::vector<Trigger>& triggers) {
  if (content.size() % kPipeTriggerBytes != 0) return false;
  triggers.clear();
  for (; !content.empty(); content.remove_prefix(kPipeTriggerBytes)) {
    const Trigger trigger = {LoadLittleEndian<int64_t>(content.data()), content[8], content[9]};
    if (trigger.t_us < 0 || trigger.t_us > kMaxStateTimeUs || trigger.polarity > 1) return false;
    triggers.push_back(trigger);
  }
  return true;
}

bool ParseLosses(absl::Span<const uint8_t> content, PipeLosses& losses) {
  if (content.size() != 24) return false;
  losses = {LoadLittleEndian<uint64_t>(content.data()), LoadLittleEndian<uint64_t>(content.data() + 8),
            LoadLittleEndian<uint64_t>(content.data() + 16)};
  return true;
}

bool ParseContent(absl::Span<const uint8_t> content, PipeRecord& record) {
  switch (record.kind) {
    case PipeRecordKind::kHeader:
      return ParseHeader(content, record.header);
    case PipeRecordKind::kEvents:
      return ParseEvents(content, record.events);
    case PipeRecordKind::kTriggers:
      return ParseTriggers(content, record.triggers);
    case PipeRecordKind::kLosses:
      return ParseLosses(content, record.losses);
    case PipeRecordKind::kEnd:
      return content.empty();
  }
  return false;
}

}  // namespace

void AppendPipeHeader(const PipeHeader& header, std::vector<uint8_t>& out) {
  const std::string name = header.format.substr(0, kMaxNameBytes);
  AppendRecordHeader(PipeRecordKind::kHeader, kFixedHeaderBytes + name.size(), out);
  AppendLittleEndian(static_cast<uint32_t>(header.geometry.width_px), out);
  AppendLittleEndian(static_cast<uint32_t>(header.geometry.height_px), out);
  AppendLittleEndian(header.time_offset_us, out);
  AppendLittleEndian(header.metavision_zero_us, out);
  out.insert(out.end(), name.begin(), name.end());
}

void AppendPipeEvents(absl::Span<const Event> events, std::vector<uint8_t>& out) {
  AppendRecordHeader(PipeRecordKind::kEvents, events.size() * kPipeEventBytes, out);
  for (const Event& event : events) {
    AppendLittleEndian(event.t_us, out);
    AppendLittleEndian(event.x, out);
    AppendLittleEndian(event.y, out);
    out.push_back(event.polarity);
  }
}

void AppendPipeTriggers(absl::Span<const Trigger> triggers, std::vector<uint8_t>& out) {
  AppendRecordHeader(PipeRecordKind::kTriggers, triggers.size() * kPipeTriggerBytes, out);
  for (const Trigger& trigger : triggers) {
    AppendLittleEndian(trigger.t_us, out);
    out.push_back(trigger.id);
    out.push_back(trigger.polarity);
  }
}

void AppendPipeLosses(const PipeLosses& losses, std::vector<uint8_t>& out) {
  AppendRecordHeader(PipeRecordKind::kLosses, 24, out);
  AppendLittleEndian(losses.events, out);
  AppendLittleEndian(losses.triggers, out);
  AppendLittleEndian(losses.invalid, out);
}

void AppendPipeEnd(std::vector<uint8_t>& out) { AppendRecordHeader(PipeRecordKind::kEnd, 0, out); }

absl::StatusOr<bool> TakePipeRecord(absl::Span<const uint8_t>& bytes, PipeRecord& record) {
  if (bytes.size() < kRecordHeaderBytes) return false;
  record.kind = static_cast<PipeRecordKind>(bytes[0]);
  const size_t size = LoadLittleEndian<uint32_t>(bytes.data() + 1);
  if (size > kMaxContentBytes) return absl::DataLossError("a record between evpose and evpose-hdf5 is too long");
  if (bytes.size() - kRecordHeaderBytes < size) return false;
  if (!ParseContent(bytes.subspan(kRecordHeaderBytes, size), record)) {
    return absl::DataLossError("a record between evpose and evpose-hdf5 is damaged");
  }
  bytes.remove_prefix(kRecordHeaderBytes + size);
  return true;
}

}  // namespace evpose::client

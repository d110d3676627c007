// SPDX-License-Identifier: Apache-2.0

// rosbag2 files of MCAP.
#include <fstream>
#include <map>
#include <set>
#include <utility>

#include "client/containers/bag.h"
#include "client/containers/byte_view.h"
#include "client/containers/mcap_records.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// Size of the end of a complete file: the footer (op, length, three fields) and the magic.
constexpr int64_t kFooterBytes = 1 + 8 + 20;

// The schemas and channels of records.
class ChannelTable {
 public:
  void Add(const McapRecord& record) {
    ByteView view(record.content);
    const auto id = view.Take<uint16_t>();
    if (record.op == McapRecord::kSchema) {
      const std::string_view name = view.TakeString();
      if (view.ok() && name.size() <= kMaxNameBytes) schemas_[id] = name;
    } else if (record.op == McapRecord::kChannel) {
      const auto schema = view.Take<uint16_t>();
      const std::string_view topic = view.TakeString();
      const std::string_view encoding = view.TakeString();
      const bool is_valid = view.ok() && topic.size() <= kMaxNameBytes && encoding.size() <= kMaxNameBytes;
      if (is_valid) channels_[id] = {schema, {std::string(topic), "", std::string(encoding)}};
    }
  }

  // The topics, each once, in the order of their channels, at most kMaxTopics.
  std::vector<BagTopic> Topics() const {
    std::vector<BagTopic> topics;
    std::set<std::string_view> names;
    for (const auto& [id, channel] : channels_) {
      if (topics.size() == kMaxTopics) break;
      if (!names.insert(channel.topic.name).second) continue;
      BagTopic topic = channel.topic;
      if (const auto schema = schemas_.find(channel.schema); schema != schemas_.end()) topic.type = schema->second;
      topics.push_back(std::move(topic));
    }
    return topics;
  }

  bool IsOfTopic(uint16_t channel, const std::string& name) const {
    const auto found = channels_.find(channel);
    return found != channels_.end() && found->second.topic.name == name;
  }

 private:
  struct Channel {
    uint16_t schema = 0;
    BagTopic topic;  // without its type
  };

  std::map<uint16_t, std::string> schemas_;
  std::map<uint16_t, Channel> channels_;
};

absl::StatusOr<McapRecords> OpenRecords(const std::string& path, const RecordingReaderOptions& options,
                                        int64_t begin = kMcapMagic.size()) {
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<ByteSource> bytes, ByteSource::Open(path, options));
  EVPOSE_RETURN_IF_ERROR(bytes->Seek(begin));
  return McapRecords(std::move(bytes));
}

// The position of the summary, which repeats the channels; 0 if the file has none or is incomplete.
uint64_t FindSummary(const std::string& path) {
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  const int64_t size = file.tellg();
  const int64_t tail_bytes = kFooterBytes + static_cast<int64_t>(kMcapMagic.size());
  if (size < tail_bytes) return 0;
  std::string tail(static_cast<size_t>(tail_bytes), '\0');
  file.seekg(size - tail_bytes);
  if (!file.read(tail.data(), tail_bytes)) return 0;
  ByteView view(tail);
  const bool is_footer = view.Take<uint8_t>() == McapRecord::kFooter && view.Take<uint64_t>() == 20;
  const auto begin = view.Take<uint64_t>();
  view.TakeBytes(12);  // begin of the offsets of the summary, checksum
  return is_footer && view.rest() == kMcapMagic && begin < static_cast<uint64_t>(size) ? begin : 0;
}

// The channels of the summary; if it has none, those of the whole file.
absl::StatusOr<ChannelTable> ReadChannels(const std::string& path, const RecordingReaderOptions& options) {
  for (const uint64_t begin : {FindSummary(path), uint64_t{kMcapMagic.size()}}) {
    if (begin == 0) continue;
    ChannelTable table;
    EVPOSE_ASSIGN_OR_RETURN(McapRecords records, OpenRecords(path, options, static_cast<int64_t>(begin)));
    while (true) {
      EVPOSE_ASSIGN_OR_RETURN(const std::optional<McapRecord> record, records.Next());
      if (!record) break;
      table.Add(*record);
    }
    if (!table.Topics().empty()) return table;
  }
  return ChannelTable();
}

class McapStream final : public MessageStream {
 public:
  McapStream(McapRecords records, ChannelTable channels, std::string topic)
      : records_(std::move(records)), channels_(std::move(channels)), topic_(std::move(topic)) {}

  absl::StatusOr<bool> Next(std::string& message) override {
    while (true) {
      EVPOSE_ASSIGN_OR_RETURN(const std::optional<McapRecord> record, records_.Next());
      if (!record) return false;
      if (record->op != McapRecord::kMessage) continue;
      ByteView view(record->content);
      const auto channel = view.Take<uint16_t>();
      view.TakeBytes(4 + 8 + 8);  // sequence number, times of the host
      num_damaged_ += view.ok() ? 0 : 1;
      if (!view.ok() || !channels_.IsOfTopic(channel, topic_)) continue;
      message = view.rest();
      return true;
    }
  }

  std::vector<SkippedParts> skipped() const override {
    std::vector<SkippedParts> parts = records_.skipped();
    if (num_damaged_ > 0) parts.push_back({"damaged message records", num_damaged_});
    return parts;
  }

 private:
  McapRecords records_;
  const ChannelTable channels_;
  const std::string topic_;
  uint64_t num_damaged_ = 0;
};

bool MatchesMcap(std::string_view prefix) { return prefix.starts_with(kMcapMagic); }

absl::StatusOr<std::unique_ptr<RecordingReader>> OpenMcap(ContainerFile file) {
  const RecordingReaderOptions options = file.bytes->options();
  EVPOSE_ASSIGN_OR_RETURN(ChannelTable channels, ReadChannels(file.path, options));
  Bag bag = {.format = "rosbag2 MCAP", .topics = channels.Topics()};
  bag.open = [&](const BagTopic& topic) -> absl::StatusOr<std::unique_ptr<MessageStream>> {
    EVPOSE_ASSIGN_OR_RETURN(McapRecords records, OpenRecords(file.path, options));
    return std::make_unique<McapStream>(std::move(records), channels, topic.name);
  };
  return OpenBag(file, bag);
}

}  // namespace

const ContainerFormat kMcapFormat = {
    .name = "rosbag2 (.mcap)", .matches = MatchesMcap, .open = OpenMcap, .has_topics = true};

}  // namespace evpose::client

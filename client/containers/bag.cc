// SPDX-License-Identifier: Apache-2.0
#include "client/containers/bag.h"

#include <algorithm>
#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/types/span.h"
#include "client/containers/event_source.h"
#include "client/containers/ros_messages.h"
#include "core/base/status_macros.h"
#include "core/events/decoder.h"

namespace evpose::client {
namespace {

bool HasPackets(const BagTopic& topic) {
  return topic.type == "event_camera_msgs/msg/EventPacket" || topic.type == "event_array_msgs/msg/EventArray";
}
bool HasArrays(const BagTopic& topic) { return topic.type == "dvs_msgs/msg/EventArray"; }

SensorGeometry SizeOf(const auto& message) {
  constexpr uint32_t kLimit = 1 << 20;  // above every sensor
  return {static_cast<int>(std::min(message.width, kLimit)), static_cast<int>(std::min(message.height, kLimit))};
}

// EVT3 of EventPackets, byte for byte.
class PacketReader final : public RecordingReader {
 public:
  PacketReader(std::string name, std::unique_ptr<MessageStream> messages)
      : name_(std::move(name)), messages_(std::move(messages)) {}

  absl::Status Start(const std::string& format) {
    EVPOSE_ASSIGN_OR_RETURN(const bool has_packet, NextPacket());
    if (!has_packet) return absl::InvalidArgumentError(absl::StrCat(name_, ": has no packet with events"));
    header_.container = format;
    return absl::OkStatus();
  }

  const RecordingHeader& header() const override { return header_; }
  int64_t data_size_bytes() const override { return -1; }
  bool follows_loss() const override { return read_follows_loss_; }

  absl::StatusOr<size_t> Read(absl::Span<uint8_t> buffer) override {
    read_follows_loss_ = false;
    if (events_.empty()) {
      EVPOSE_ASSIGN_OR_RETURN(const bool has_packet, NextPacket());
      if (!has_packet) return 0;
    }
    read_follows_loss_ = std::exchange(packet_follows_loss_, false);
    const size_t size = std::min(buffer.size(), events_.size());
    std::memcpy(buffer.data(), events_.data(), size);
    events_.remove_prefix(size);
    return size;
  }

  std::vector<SkippedParts> skipped() const override {
    std::vector<SkippedParts> parts = messages_->skipped();
    if (num_damaged_ > 0) parts.push_back({"damaged packets", num_damaged_});
    if (num_other_ > 0) parts.push_back({"packets of another encoding, byte order or sensor size", num_other_});
    if (num_gaps_ > 0) parts.push_back({"gaps in the sequence numbers of the packets", num_gaps_});
    if (num_missing_ > 0) parts.push_back({"packets missing in these gaps", num_missing_});
    return parts;
  }

 private:
  // Makes the next packet with events the current one; false at the end.
  absl::StatusOr<bool> NextPacket() {
    while (true) {
      EVPOSE_ASSIGN_OR_RETURN(const bool has_message, messages_->Next(message_));
      if (!has_message) return false;
      const std::optional<EventPacket> packet = ParseEventPacket(message_);
      if (!packet) {
        ++num_damaged_;
        packet_follows_loss_ = has_packet_;
        continue;
      }
      EVPOSE_ASSIGN_OR_RETURN(const bool fits, Check(*packet));
      if (!fits) {
        ++num_other_;
        packet_follows_loss_ = has_packet_;
        continue;
      }
      CheckSequence(packet->seq);
      events_ = packet->events;
      if (!events_.empty()) return true;
    }
  }

  // Whether the packet continues the recording. Takes the size of the sensor from the first one. UNIMPLEMENTED if that
  // is not EVT3.
  absl::StatusOr<bool> Check(const EventPacket& packet) {
    const bool is_evt3 = packet.encoding == "evt3" && !packet.is_big_endian;
    if (has_packet_) return is_evt3 && SizeOf(packet) == header_.geometry;
    if (!is_evt3) {
      return absl::UnimplementedError(absl::StrCat(
          name_, ": has packets in the encoding '", std::string(packet.encoding.substr(0, 32)), "'",
          packet.is_big_endian ? ", big-endian" : "",
          "; only evt3 is read: convert them to dvs_msgs/EventArray with event_camera_tools, or record evt3"));
    }
    header_.encoding = Encoding::kEvt3;
    header_.geometry = SizeOf(packet);
    header_.geometry_is_stated = true;
    header_.geometry_is_known = true;
    const absl::Status is_valid = ValidateGeometry(Encoding::kEvt3, header_.geometry);
    if (!is_valid.ok()) return absl::InvalidArgumentError(absl::StrCat(name_, ": ", is_valid.message()));
    return true;
  }

  void CheckSequence(uint64_t seq) {
    const uint64_t before = std::exchange(seq_, seq);
    if (!std::exchange(has_packet_, true)) return;
    const bool is_unset = seq == 0 && before == 0;  // a publisher that does not count
    if (is_unset || seq == before + 1) return;
    ++num_gaps_;
    if (seq > before) num_missing_ += seq - before - 1;
    packet_follows_loss_ = true;
  }

  const std::string name_;
  const std::unique_ptr<MessageStream> messages_;
  RecordingHeader header_;
  std::string message_;
  std::string_view events_;  // of the current packet, what Read() has not returned
  uint64_t seq_ = 0;         // of the last packet
  bool has_packet_ = false;
  bool packet_follows_loss_ = false;
  bool read_follows_loss_ = false;
  uint64_t num_damaged_ = 0;
  uint64_t num_other_ = 0;
  uint64_t num_gaps_ = 0;
  uint64_t num_missing_ = 0;
};

// Events of dvs_msgs/EventArray.
class EventArraySource final : public EventSource {
 public:
  EventArraySource(std::string format, std::unique_ptr<MessageStream> messages) : messages_(std::move(messages)) {
    facts_.format = std::move(format);
  }

  // Reads the first message, which states the size of the sensor.
  absl::Status Start() {
    EVPOSE_ASSIGN_OR_RETURN(is_first_kept_, Next(first_events_));
    return absl::OkStatus();
  }

  const SourceFacts& facts() const override { return facts_; }

  absl::StatusOr<bool> Next(std::vector<SourceEvent>& events) override {
    events.clear();
    if (std::exchange(is_first_kept_, false)) {
      events.swap(first_events_);
      return true;
    }
    EVPOSE_ASSIGN_OR_RETURN(const bool has_message, messages_->Next(message_));
    if (!has_message) return false;
    const std::optional<EventArray> array = ParseEventArray(message_, events);
    num_damaged_ += !array ? 1 : 0;
    if (!array) return true;
    num_missing_ += array->num_missing;
    if (!facts_.geometry && array->width > 0 && array->height > 0) facts_.geometry = SizeOf(*array);
    return true;
  }

  std::vector<SkippedParts> skipped() const override {
    std::vector<SkippedParts> parts = messages_->skipped();
    if (num_damaged_ > 0) parts.push_back({"damaged messages", num_damaged_});
    if (num_missing_ > 0)
      parts.push_back({"events missing at the end of messages", num_missing_, SkippedParts::Loss::kEvents});
    return parts;
  }

 private:
  const std::unique_ptr<MessageStream> messages_;
  SourceFacts facts_;
  std::string message_;
  std::vector<SourceEvent> first_events_;
  bool is_first_kept_ = false;
  uint64_t num_damaged_ = 0;
  uint64_t num_missing_ = 0;
};

constexpr size_t kMaxListedTopics = 20;  // in an error, so that it stays readable

std::string NamesOf(absl::Span<const BagTopic> topics) {
  const auto append = [](std::string* text, const BagTopic& topic) { absl::StrAppend(text, topic.name); };
  const std::string names = absl::StrJoin(topics.subspan(0, kMaxListedTopics), ", ", append);
  if (topics.size() <= kMaxListedTopics) return names;
  return absl::StrCat(names, " and ", topics.size() - kMaxListedTopics, " others");
}

absl::StatusOr<BagTopic> ChooseTopic(const ContainerFile& file, const Bag& bag) {
  std::vector<BagTopic> with_events;
  for (const BagTopic& topic : bag.topics) {
    if (HasPackets(topic) || HasArrays(topic)) with_events.push_back(topic);
  }
  if (with_events.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(file.name, ": has no topic with events (event_camera_msgs/EventPacket or dvs_msgs/EventArray); ",
                     bag.topics.empty() ? "it has no topics" : absl::StrCat("its topics: ", NamesOf(bag.topics))));
  }
  const auto has_name = [&file](const BagTopic& topic) { return topic.name == file.topic; };
  const auto chosen = std::find_if(with_events.begin(), with_events.end(), has_name);
  if (chosen != with_events.end()) return *chosen;
  if (file.topic.empty() && with_events.size() == 1) return with_events.front();
  return absl::InvalidArgumentError(absl::StrCat(
      file.name, ": ",
      file.topic.empty() ? "has several topics with events" : absl::StrCat("has no topic ", file.topic, " with events"),
      "; choose one as ", file.path, "#TOPIC: ", NamesOf(with_events)));
}

}  // namespace

absl::StatusOr<std::unique_ptr<RecordingReader>> OpenBag(const ContainerFile& file, const Bag& bag) {
  EVPOSE_ASSIGN_OR_RETURN(const BagTopic topic, ChooseTopic(file, bag));
  const std::string name = absl::StrCat(file.name, ": topic ", topic.name);
  if (topic.encoding != "cdr") {
    return absl::UnimplementedError(absl::StrCat(name, ": has messages in the encoding '", topic.encoding.substr(0, 32),
                                                 "'; only those of ROS 2 (cdr) are read"));
  }
  if (HasPackets(topic)) {
    EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<MessageStream> messages, bag.open(topic));
    auto reader = std::make_unique<PacketReader>(name, std::move(messages));
    EVPOSE_RETURN_IF_ERROR(reader->Start(bag.format));
    return reader;
  }
  const auto open = [&]() -> absl::StatusOr<std::unique_ptr<EventSource>> {
    EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<MessageStream> messages, bag.open(topic));
    auto source = std::make_unique<EventArraySource>(bag.format, std::move(messages));
    EVPOSE_RETURN_IF_ERROR(source->Start());
    return source;
  };
  return MakeSourceReader(name, open, file.geometry, /*can_reopen=*/true);
}

}  // namespace evpose::client

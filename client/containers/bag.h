// SPDX-License-Identifier: Apache-2.0

// ROS 2 bags: files with the messages of several topics.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/containers/container_format.h"
#include "core/recordings/recording_reader.h"

namespace evpose::client {

// Larger messages and chunks are skipped, so that a damaged length cannot exhaust the memory. Recorders write chunks of
// about 1 MB.
inline constexpr uint64_t kMaxMessageBytes = uint64_t{64} << 20;

// Bounds of the topics of a damaged file: further ones, and those with a longer text, are left out.
inline constexpr size_t kMaxTopics = 1000;
inline constexpr size_t kMaxNameBytes = 4096;  // length of the name of a topic, of its type and of its encoding

struct BagTopic {
  std::string name;      // "/event_camera/events"
  std::string type;      // "event_camera_msgs/msg/EventPacket"
  std::string encoding;  // encoding of its messages: "cdr"
};

// The messages of one topic, in the order in which they were stored.
class MessageStream {
 public:
  virtual ~MessageStream() = default;

  // Replaces `message` by the next one; false at the end. Damaged parts are skipped and counted. Errors: those of
  // RecordingReader::Read().
  virtual absl::StatusOr<bool> Next(std::string& message) = 0;
  virtual std::vector<SkippedParts> skipped() const = 0;
};

struct Bag {
  std::string format;  // "rosbag2 MCAP"
  std::vector<BagTopic> topics;
  std::function<absl::StatusOr<std::unique_ptr<MessageStream>>(const BagTopic&)> open;
};

// The recording of the topic `file.topic`, or of the only topic with events. Errors have the names of the topics with
// events: INVALID_ARGUMENT if there are several or none, or if `file.topic` is not among them; UNIMPLEMENTED for
// packets of another encoding than EVT3.
absl::StatusOr<std::unique_ptr<RecordingReader>> OpenBag(const ContainerFile& file, const Bag& bag);

extern const ContainerFormat kMcapFormat;
extern const ContainerFormat kSqliteBagFormat;

}  // namespace evpose::client

// SPDX-License-Identifier: Apache-2.0

// Records what a session yields in an MCAP file for ROS 2, Foxglove and Lichtblick: README.md lists the topics.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "client/mcap/mcap_writer.h"
#include "evpose/types.h"

namespace evpose::client {

inline constexpr char kCameraFrame[] = "evpose_camera";  // optical axes: x right, y down, z forward

struct PoseRecorderOptions {
  std::vector<std::string> object_ids;  // the objects that are recorded
  // Time of messages at the sensor time 0, nanoseconds since 1970; absent: the host's time at which the first message
  // with a time is recorded, minus its sensor time.
  std::optional<int64_t> epoch_ns;
  std::string transform = "camera_from_object";  // name of the transform that pose messages have
  // The frame that the camera is fixed in, and its pose there; absent: the camera's frame is the root.
  std::optional<std::pair<std::string, Transform>> world_from_camera;
  std::function<absl::Time()> now = absl::Now;  // the host's clock, UTC
  McapWriterOptions writer;
};

// A pose as it is written: with the transform, the covariance and the twist of the output's frame.
struct FramedPose {
  Pose pose;
  std::string frame_id;
};

// Thread-safe. Sensor times are those of the arguments; messages before 1970 have the time 0.
class PoseRecorder {
 public:
  // With `kept_bytes`, continues the file of an earlier process, with its epoch: the number that Sync() returned.
  // Errors: those of McapWriter.
  static absl::StatusOr<std::unique_ptr<PoseRecorder>> Open(const std::string& path, const PoseRecorderOptions& options,
                                                            std::optional<uint64_t> kept_bytes = std::nullopt);

  // Written with the time of the first message that has one. In a continued file the former ones stay.
  void SetCamera(const Camera& camera);
  void SetModel(const std::string& object_id, const ModelGeometry& geometry);

  // Records the state, and if the pose is confirmed (TRACKING or DEGRADED) also `framed`, its twist and the transform
  // from object to camera. `state_json` is the text of the state's message.
  void Add(const Pose& camera_pose, const FramedPose& framed, const std::string& state_json);
  // Records a state without a pose: {"object_id": ..., "t_us": ..., "state": ...}.
  void AddState(const std::string& object_id, int64_t t_us, TrackState state);
  void Add(const SessionHealth& health, const std::string& session);
  // `png` is the picture of the image (EventImagePng()), which several recorders share.
  void Add(const EventImage& image, std::string_view png);

  // The first error of any call. Writes all messages to the disk, and returns the size of the file.
  absl::StatusOr<uint64_t> Sync();
  absl::Status Commit();
  void Remove();  // instead of Commit(): removes what was written

 private:
  PoseRecorder(McapWriter writer, const PoseRecorderOptions& options);
  // The time of a message. The first call writes what waits for it.
  uint64_t LogTime(int64_t t_us);
  void Write(const std::string& topic, std::string_view type, uint64_t time_ns, std::string_view message,
             bool is_latched = false);
  void WriteConstants();
  void WriteOnce(const std::string& topic, std::string_view type, std::function<std::string(uint64_t)> encode);
  bool IsRecorded(const std::string& object_id) const { return names_.contains(object_id); }
  std::string Topic(const std::string& object_id, std::string_view what) const;

  std::mutex mutex_;
  McapWriter writer_;
  const PoseRecorderOptions options_;
  std::map<std::string, std::string> names_;  // names of the recorded objects in topics
  std::optional<int64_t> epoch_ns_;
  struct Constant {
    std::string topic;
    std::string_view type;
    std::function<std::string(uint64_t time_ns)> encode;
  };
  std::optional<uint64_t> first_ns_;  // time of the first message
  std::vector<Constant> waiting_;     // for that
};

// A text as part of a topic's name: letters, digits and underscores, not beginning with a digit.
std::string NameInRos(std::string_view text);

}  // namespace evpose::client

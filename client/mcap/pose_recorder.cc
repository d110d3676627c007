// SPDX-License-Identifier: Apache-2.0
#include "client/mcap/pose_recorder.h"

#include <algorithm>
#include <limits>
#include <nlohmann/json.hpp>
#include <set>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "client/mcap/diagnostics.h"
#include "client/mcap/ros_encoders.h"
#include "client/mcap/ros_types.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr char kMetadataName[] = "evpose";
constexpr char kEpochKey[] = "epoch_ns";
// The latest time of a stamp of ROS.
constexpr int64_t kLatestNs = int64_t{std::numeric_limits<int32_t>::max()} * 1'000'000'000;

// The names of the objects in topics; equal ones get a number.
std::map<std::string, std::string> TopicNames(const std::vector<std::string>& object_ids) {
  std::map<std::string, std::string> names;
  std::set<std::string> taken;
  for (const std::string& id : object_ids) {
    std::string name = NameInRos(id);
    for (int number = 2; !taken.insert(name).second; ++number) name = absl::StrCat(NameInRos(id), "_", number);
    names[id] = name;
  }
  return names;
}

std::optional<int64_t> FindEpoch(const McapIndex& index) {
  for (const McapMetadata& metadata : index.metadata) {
    const auto epoch = metadata.values.find(kEpochKey);
    int64_t epoch_ns = 0;
    if (metadata.name == kMetadataName && epoch != metadata.values.end() &&
        absl::SimpleAtoi(epoch->second, &epoch_ns)) {
      return epoch_ns;
    }
  }
  return std::nullopt;
}

}  // namespace

std::string NameInRos(std::string_view text) {
  std::string name;
  for (const char character : text) {
    const bool is_valid = absl::ascii_isalnum(static_cast<unsigned char>(character));
    name.push_back(is_valid ? character : '_');
  }
  return name.empty() || absl::ascii_isdigit(static_cast<unsigned char>(name[0])) ? "_" + name : name;
}

PoseRecorder::PoseRecorder(McapWriter writer, const PoseRecorderOptions& options)
    : writer_(std::move(writer)),
      options_(options),
      names_(TopicNames(options.object_ids)),
      epoch_ns_(FindEpoch(writer_.index())) {
  if (!writer_.index().chunks.empty()) first_ns_ = writer_.index().chunks.front().start_ns;
}

absl::StatusOr<std::unique_ptr<PoseRecorder>> PoseRecorder::Open(const std::string& path,
                                                                 const PoseRecorderOptions& options,
                                                                 std::optional<uint64_t> kept_bytes) {
  EVPOSE_ASSIGN_OR_RETURN(McapWriter writer, kept_bytes ? McapWriter::Continue(path, *kept_bytes, options.writer)
                                                        : McapWriter::Create(path, options.writer));
  std::unique_ptr<PoseRecorder> recorder(new PoseRecorder(std::move(writer), options));
  if (options.world_from_camera) {
    recorder->WriteOnce("/tf_static", kTransformsType, [world = *options.world_from_camera](uint64_t time_ns) {
      return EncodeTransform({time_ns, world.first}, kCameraFrame, world.second);
    });
  }
  return recorder;
}

std::string PoseRecorder::Topic(const std::string& object_id, std::string_view what) const {
  return absl::StrCat("/evpose/", names_.at(object_id), "/", std::string(what));
}

void PoseRecorder::Write(const std::string& topic, std::string_view type, uint64_t time_ns, std::string_view message,
                         bool is_latched) {
  std::optional<uint16_t> channel = writer_.FindTopic(topic);
  if (!channel) channel = writer_.AddTopic({topic, std::string(type), RosDefinition(type), is_latched});
  writer_.Write(*channel, time_ns, message);
}

void PoseRecorder::WriteOnce(const std::string& topic, std::string_view type,
                             std::function<std::string(uint64_t)> encode) {
  if (writer_.FindTopic(topic)) return;  // by an earlier process
  waiting_.push_back({topic, type, std::move(encode)});
  if (first_ns_) WriteConstants();
}

void PoseRecorder::WriteConstants() {
  for (const Constant& constant : std::exchange(waiting_, {})) {
    Write(constant.topic, constant.type, *first_ns_, constant.encode(*first_ns_), /*is_latched=*/true);
  }
}

uint64_t PoseRecorder::LogTime(int64_t t_us) {
  const int64_t sensor_ns = 1000 * std::clamp(t_us, -kLatestNs / 1000, kLatestNs / 1000);
  if (!epoch_ns_) epoch_ns_ = options_.epoch_ns ? *options_.epoch_ns : absl::ToUnixNanos(options_.now()) - sensor_ns;
  // The recording or the continued file may state any number; the bound is that of the line above.
  epoch_ns_ = std::clamp(*epoch_ns_, -2 * kLatestNs, 2 * kLatestNs);
  if (writer_.index().metadata.empty()) {
    writer_.AddMetadata(
        kMetadataName,
        {{kEpochKey, absl::StrCat(*epoch_ns_)}, {"transform", options_.transform}, {"camera_frame", kCameraFrame}});
  }
  const auto time_ns = static_cast<uint64_t>(std::clamp(*epoch_ns_ + sensor_ns, int64_t{0}, kLatestNs));
  if (!first_ns_) {
    first_ns_ = time_ns;
    WriteConstants();
  }
  return time_ns;
}

void PoseRecorder::SetCamera(const Camera& camera) {
  const std::lock_guard lock(mutex_);
  WriteOnce("/evpose/camera_info", kCameraInfoType, [camera](uint64_t time_ns) {
    return EncodeCamera({time_ns, kCameraFrame}, camera);
  });
}

void PoseRecorder::SetModel(const std::string& object_id, const ModelGeometry& geometry) {
  const std::lock_guard lock(mutex_);
  if (!IsRecorded(object_id)) return;
  WriteOnce(Topic(object_id, "model"), kMarkersType,
            [message = EncodeModel(object_id, geometry)](uint64_t) { return message; });
}

void PoseRecorder::Add(const Pose& camera_pose, const FramedPose& framed, const std::string& state_json) {
  const std::lock_guard lock(mutex_);
  const std::string& id = camera_pose.object_id;
  if (!IsRecorded(id)) return;
  const uint64_t time_ns = LogTime(camera_pose.t_us);
  // Subscribers may act on every pose that they receive, so that poses in other states are not written.
  if (camera_pose.state == TrackState::kTracking || camera_pose.state == TrackState::kDegraded) {
    const Pose& pose = framed.pose;
    Write("/tf", kTransformsType, time_ns,
          EncodeTransform({time_ns, kCameraFrame}, id, camera_pose.camera_from_object));
    Write(Topic(id, "pose"), kPoseType, time_ns,
          EncodePose({time_ns, framed.frame_id}, pose.camera_from_object, pose.covariance));
    Write(Topic(id, "twist"), kTwistType, time_ns, EncodeTwist({time_ns, framed.frame_id}, pose.twist));
  }
  Write(Topic(id, "state"), kTextType, time_ns, EncodeText(state_json));
}

void PoseRecorder::AddState(const std::string& object_id, int64_t t_us, TrackState state) {
  nlohmann::ordered_json json;
  json["object_id"] = object_id;
  json["t_us"] = t_us;
  json["state"] = TrackStateName(state);
  // An object ID that is not valid UTF-8 must not stop the recording.
  const std::string text = json.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
  const std::lock_guard lock(mutex_);
  if (!IsRecorded(object_id)) return;
  Write(Topic(object_id, "state"), kTextType, LogTime(t_us), EncodeText(text));
}

void PoseRecorder::Add(const SessionHealth& health, const std::string& session) {
  if (health.decoded_events == 0) return;  // there is no sensor time yet
  const std::lock_guard lock(mutex_);
  const uint64_t time_ns = LogTime(health.t_us);
  Write("/diagnostics", kDiagnosticsType, time_ns, EncodeDiagnostics({time_ns, ""}, session, Diagnose(health)));
}

void PoseRecorder::Add(const EventImage& image, std::string_view png) {
  const std::lock_guard lock(mutex_);
  const uint64_t time_ns = LogTime(image.to_t_us);
  Write("/evpose/events/compressed", kImageType, time_ns, EncodeImage({time_ns, kCameraFrame}, "png", png));
  Write("/evpose/events/annotations", kAnnotationsType, time_ns, EncodeOutlines(time_ns, image.outlines));
}

absl::StatusOr<uint64_t> PoseRecorder::Sync() {
  const std::lock_guard lock(mutex_);
  return writer_.Sync();
}

absl::Status PoseRecorder::Commit() {
  const std::lock_guard lock(mutex_);
  return writer_.Commit();
}

void PoseRecorder::Remove() {
  const std::lock_guard lock(mutex_);
  writer_.Remove();
}

}  // namespace evpose::client

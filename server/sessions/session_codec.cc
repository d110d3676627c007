// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/session_codec.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/state_io.h"
#include "core/base/status_macros.h"

namespace evpose::server {
namespace {

// Of everything below. Higher whenever the meaning of the bytes changes.
constexpr uint32_t kVersion = 5;

constexpr size_t kDigestBytes = 64;  // hex

// The functions below name the fields for both directions. A member that is added to one of the structs and not to its
// function does not compile.

template <typename Archive, typename List, typename VisitItem>
void VisitItems(Archive& archive, List& list, VisitItem visit_item) {
  size_t count = list.size();
  archive.Count(count);
  if constexpr (Archive::kReading) {
    list.clear();
    for (size_t i = 0; i < count && archive.ok(); ++i) visit_item(list.emplace_back());
  } else {
    for (auto& item : list) visit_item(item);
  }
}

template <typename Archive, typename Duration>
void VisitDuration(Archive& archive, Duration& duration) {
  int64_t nanoseconds = absl::ToInt64Nanoseconds(duration);
  archive(nanoseconds);
  if constexpr (Archive::kReading) duration = absl::Nanoseconds(nanoseconds);
}

// `visit` the value of an optional whose type has no visitor of its own.
template <typename Archive, typename Optional, typename Visit>
void VisitOptional(Archive& archive, Optional& optional, Visit visit) {
  bool has_value = optional.has_value();
  archive(has_value);
  if constexpr (Archive::kReading) {
    optional.reset();
    if (has_value) optional.emplace();
  }
  if (has_value) visit(*optional);
}

void VisitCamera(auto& archive, auto& camera) {
  auto& [width_px, height_px, fx_px, fy_px, cx_px, cy_px, distortion] = camera;
  archive(width_px, height_px, fx_px, fy_px, cx_px, cy_px, distortion);
}

void VisitSensor(auto& archive, auto& sensor) {
  auto& [name, pixel_noise_px, blur_px, contrast_threshold, refractory_us, latency_us] = sensor;
  archive(name, pixel_noise_px, blur_px, contrast_threshold, refractory_us, latency_us);
}

void VisitTransform(auto& archive, auto& transform) {
  auto& [rotation, translation_m] = transform;
  archive(rotation, translation_m);
}

void VisitObject(auto& archive, auto& object) {
  auto& [object_id, model, initial_camera_from_object, reference_rotation] = object;
  archive(object_id, model);
  VisitOptional(archive, initial_camera_from_object, [&archive](auto& pose) { VisitTransform(archive, pose); });
  archive(reference_rotation);
}

void VisitConfig(auto& archive, auto& config) {
  auto& [encoding, camera, objects, estimator, sensor, overload_policy, max_lag] = config;
  archive(AtMost(encoding, Encoding::kFlat64));
  VisitCamera(archive, camera);
  VisitItems(archive, objects, [&archive](auto& object) { VisitObject(archive, object); });
  archive(AtMost(estimator, Estimator::kReleasedMm));
  VisitSensor(archive, sensor);
  archive(AtMost(overload_policy, OverloadPolicy::kLatest));
  VisitOptional(archive, max_lag, [&archive](auto& lag) { VisitDuration(archive, lag); });
}

void VisitLifecycle(auto& archive, auto& lifecycle) {
  auto& [token_digest, previous_token_digest, num_attaches, detached_at, num_renewals] = lifecycle;
  archive(token_digest, previous_token_digest, num_attaches, num_renewals);
  archive.Check(token_digest.size() == kDigestBytes, "the digest of the resume token has another length");
  archive.Check(previous_token_digest.empty() || previous_token_digest.size() == kDigestBytes,
                "the digest of the previous resume token has another length");
  VisitOptional(archive, detached_at, [&archive](auto& time) {
    auto since_epoch = time - absl::UnixEpoch();
    VisitDuration(archive, since_epoch);
    if constexpr (std::remove_reference_t<decltype(archive)>::kReading) time = absl::UnixEpoch() + since_epoch;
  });
}

void VisitObjectHealth(auto& archive, auto& object) {
  auto& [state, losses, explained_ratio, initialization] = object;
  auto& [status, attempts, num_lines] = initialization;
  archive(AtMost(state, TrackState::kLost), losses, explained_ratio);
  archive(AtMost(status, InitializationStatus::kAmbiguous), attempts, num_lines);
}

void VisitHealth(auto& archive, auto& health) {
  // What passes is not kept: the age of the queue, and the percentiles, which follow from the latencies.
  auto& [t_us, received_bytes, processed_bytes, counts, poses, reattaches, sensor_time_us, processing_us, queue_age_us,
         skipped_events, skipped_us, latency_p50_us, latency_p99_us, objects] = health;
  archive(t_us, received_bytes, processed_bytes, counts, poses, reattaches, sensor_time_us, processing_us,
          skipped_events, skipped_us);
  VisitItems(archive, objects, [&archive](auto& object) { VisitObjectHealth(archive, object); });
}

void VisitCheckpoint(auto& archive, auto& checkpoint) {
  auto& [processed_seq, ended, health, latencies, pipeline] = checkpoint;
  archive(processed_seq, ended);
  VisitHealth(archive, health);
  archive(latencies, pipeline);
}

void VisitEstimate(auto& archive, auto& estimate) {
  auto& [object_index, t_us, pose, covariance, twist, state, num_events, explained_ratio, residual_rms_px] = estimate;
  archive(object_index, t_us);
  VisitTransform(archive, pose);
  archive(covariance, twist, AtMost(state, TrackState::kLost), num_events, explained_ratio, residual_rms_px);
}

void VisitPose(auto& archive, auto& pose) {
  auto& [pose_seq, object_index, estimate, latency_us] = pose;
  archive(pose_seq, object_index, latency_us);
  VisitEstimate(archive, estimate);
}

template <typename Visit>
std::string Encode(Visit visit) {
  StateWriter writer;
  writer(kVersion);
  visit(writer);
  return writer.Take();
}

template <typename Visit>
absl::Status Decode(absl::string_view bytes, absl::string_view what, Visit visit) {
  StateReader reader(bytes);
  uint32_t version = 0;
  reader(version);
  if (reader.ok() && version != kVersion) {
    return absl::DataLossError(absl::StrCat("the ", what, " was written by another version of evpose (", version,
                                            ", this one reads ", kVersion, ")"));
  }
  visit(reader);
  const absl::Status status = reader.Finish();
  if (status.ok()) return status;
  return absl::Status(status.code(), absl::StrCat("the ", what, " is damaged: ", status.message()));
}

}  // namespace

std::string EncodeConfig(const SessionConfig& config) {
  return Encode([&config](StateWriter& writer) { VisitConfig(writer, config); });
}

absl::StatusOr<SessionConfig> DecodeConfig(absl::string_view bytes) {
  SessionConfig config;
  EVPOSE_RETURN_IF_ERROR(
      Decode(bytes, "configuration", [&config](StateReader& reader) { VisitConfig(reader, config); }));
  const absl::Status valid = config.Validate();
  if (valid.ok()) return config;
  return absl::DataLossError(absl::StrCat("the configuration is damaged: ", valid.message()));
}

std::string EncodeLifecycle(const SessionLifecycle& lifecycle) {
  return Encode([&lifecycle](StateWriter& writer) { VisitLifecycle(writer, lifecycle); });
}

absl::StatusOr<SessionLifecycle> DecodeLifecycle(absl::string_view bytes) {
  SessionLifecycle lifecycle;
  EVPOSE_RETURN_IF_ERROR(
      Decode(bytes, "lifecycle", [&lifecycle](StateReader& reader) { VisitLifecycle(reader, lifecycle); }));
  return lifecycle;
}

std::string EncodeCheckpoint(const SessionCheckpoint& checkpoint) {
  return Encode([&checkpoint](StateWriter& writer) { VisitCheckpoint(writer, checkpoint); });
}

absl::StatusOr<SessionCheckpoint> DecodeCheckpoint(absl::string_view bytes, size_t num_objects) {
  SessionCheckpoint checkpoint;
  EVPOSE_RETURN_IF_ERROR(Decode(bytes, "checkpoint", [&checkpoint, num_objects](StateReader& reader) {
    VisitCheckpoint(reader, checkpoint);
    reader.Check(checkpoint.health.objects.size() == num_objects, "it has another number of objects");
  }));
  return checkpoint;
}

PoseSegment EncodePoses(absl::Span<const StoredPose> poses) {
  return {.first_pose_seq = poses.front().pose_seq,
          .last_pose_seq = poses.back().pose_seq,
          .bytes = Encode([poses](StateWriter& writer) {
            VisitItems(writer, poses, [&writer](const StoredPose& pose) { VisitPose(writer, pose); });
          })};
}

absl::StatusOr<std::vector<StoredPose>> DecodePoses(const PoseSegment& segment, size_t num_objects) {
  std::vector<StoredPose> poses;
  EVPOSE_RETURN_IF_ERROR(
      Decode(segment.bytes, absl::StrCat("segment of poses ", segment.first_pose_seq, " to ", segment.last_pose_seq),
             [&](StateReader& reader) {
               VisitItems(reader, poses, [&reader](StoredPose& pose) { VisitPose(reader, pose); });
               uint64_t expected = segment.first_pose_seq;
               for (const StoredPose& pose : poses) {
                 reader.Check(pose.pose_seq == expected++, "the poses are not numbered in a row");
                 reader.Check(pose.object_index < num_objects && pose.estimate.object_index == pose.object_index,
                              "a pose is of an object that the session does not have");
               }
               reader.Check(!poses.empty() && expected == segment.last_pose_seq + 1, "poses are missing");
             }));
  return poses;
}

}  // namespace evpose::server

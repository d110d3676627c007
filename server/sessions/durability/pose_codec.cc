// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/durability/pose_codec.h"

#include <cstdint>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "evpose/storage/v1/session.pb.h"
#include "google/protobuf/arena.h"
#include "server/runtime/enum_number.h"
#include "server/sessions/durability/pose_columns.h"
#include "server/sessions/durability/stored_fields.h"
#include "server/stores/common/record_version.h"

namespace evpose::server {
namespace {

namespace pb = storage::v1;

void ToStored(const PoseAlternative& alternative, pb::PoseAlternative& stored) {
  SetNumbers(alternative.camera_from_object.rotation, *stored.mutable_rotation());
  SetNumbers(alternative.camera_from_object.translation_m, *stored.mutable_translation_m());
  stored.set_log_likelihood_ratio(alternative.log_likelihood_ratio);
}

PoseAlternative FromStored(const pb::PoseAlternative& stored, RecordCheck& check) {
  PoseAlternative alternative;
  GetNumbers(stored.rotation(), check, alternative.camera_from_object.rotation);
  GetNumbers(stored.translation_m(), check, alternative.camera_from_object.translation_m);
  alternative.log_likelihood_ratio = stored.log_likelihood_ratio();
  return alternative;
}

void ToStored(const StoredPose& pose, pb::Pose& stored) {
  const auto& [pose_seq, object_index, estimate, latency_us] = pose;
  const auto& [estimate_object, t_us, camera_from_object, covariance, twist, state, num_events, explained_ratio,
               residual_rms_px, alternatives, loss_cause, lost_at_us] = estimate;
  stored.set_pose_seq(pose_seq);
  stored.set_object_index(object_index);
  stored.set_t_us(t_us);
  SetNumbers(camera_from_object.rotation, *stored.mutable_rotation());
  SetNumbers(camera_from_object.translation_m, *stored.mutable_translation_m());
  SetNumbers(covariance, *stored.mutable_covariance());
  SetNumbers(twist, *stored.mutable_twist());
  stored.set_state(EnumNumber<pb::TrackState>(Earlier(state)));
  if (state != Earlier(state)) stored.set_later_state(EnumNumber<pb::TrackState>(state));
  for (const PoseAlternative& alternative : alternatives) ToStored(alternative, *stored.add_alternatives());
  stored.set_num_events(num_events);
  stored.set_explained_ratio(explained_ratio);
  stored.set_residual_rms_px(residual_rms_px);
  stored.set_latency_us(latency_us);
  stored.set_loss_cause(static_cast<pb::LossCause>(loss_cause));
  stored.set_lost_at_us(lost_at_us);
}

StoredPose FromStored(const pb::Pose& stored, RecordCheck& check) {
  StoredPose pose;
  PoseEstimate& estimate = pose.estimate;
  pose.pose_seq = stored.pose_seq();
  pose.object_index = estimate.object_index = stored.object_index();
  estimate.t_us = stored.t_us();
  GetNumbers(stored.rotation(), check, estimate.camera_from_object.rotation);
  GetNumbers(stored.translation_m(), check, estimate.camera_from_object.translation_m);
  GetNumbers(stored.covariance(), check, estimate.covariance);
  GetNumbers(stored.twist(), check, estimate.twist);
  EnumFromStored(stored.state(), check, estimate.state);
  EnumFromStored(stored.later_state(), check, estimate.state);
  const bool has_space = static_cast<size_t>(stored.alternatives_size()) <= PoseAlternatives::kMaxSize;
  check.Require(has_space, "a pose has more alternatives than there may be");
  for (const pb::PoseAlternative& alternative : stored.alternatives()) {
    estimate.alternatives.Add(FromStored(alternative, check));
  }
  estimate.num_events = stored.num_events();
  estimate.explained_ratio = stored.explained_ratio();
  estimate.residual_rms_px = stored.residual_rms_px();
  pose.latency_us = stored.latency_us();
  check.Require(pb::LossCause_IsValid(stored.loss_cause()), "a cause of a loss that this version does not know");
  estimate.loss_cause = static_cast<LossCause>(stored.loss_cause());
  estimate.lost_at_us = stored.lost_at_us();
  return pose;
}

}  // namespace

PoseSegment EncodePoses(absl::Span<const StoredPose> poses) {
  google::protobuf::Arena arena;
  auto& stored = *google::protobuf::Arena::CreateMessage<pb::PoseSegment>(&arena);
  DeflatedColumns columns =
      EncodeColumns(poses, [&stored](const StoredPose& pose) { ToStored(pose, *stored.add_poses()); });
  if (!columns.bytes.empty()) {
    stored.set_columns(std::move(columns.bytes));
    stored.set_columns_bytes(columns.inflated_bytes);
  }
  return {.first_pose_seq = poses.front().pose_seq,
          .last_pose_seq = poses.back().pose_seq,
          .bytes = SerializeRecord(stored)};
}

absl::StatusOr<std::vector<StoredPose>> DecodePoses(const PoseSegment& segment, size_t num_objects) {
  RecordCheck check(absl::StrCat("segment of poses ", segment.first_pose_seq, " to ", segment.last_pose_seq));
  google::protobuf::Arena arena;
  auto& stored = *google::protobuf::Arena::CreateMessage<pb::PoseSegment>(&arena);
  check.Parse(segment.bytes, stored);
  const uint64_t num_poses = segment.last_pose_seq - segment.first_pose_seq + 1;
  std::vector<StoredPose> in_columns;
  if (!stored.columns().empty()) {
    EVPOSE_ASSIGN_OR_RETURN(in_columns, DecodeColumns(stored.columns(), stored.columns_bytes(), num_poses));
  }
  check.Require(num_poses == in_columns.size() + static_cast<size_t>(stored.poses_size()), "poses are missing");
  EVPOSE_RETURN_IF_ERROR(check.Finish());
  std::vector<StoredPose> poses;
  poses.reserve(num_poses);
  auto next = stored.poses().begin();
  auto next_in_columns = in_columns.begin();
  for (uint64_t seq = segment.first_pose_seq; seq <= segment.last_pose_seq; ++seq) {
    const bool is_next = next != stored.poses().end() && next->pose_seq() == seq;
    check.Require(is_next || next_in_columns != in_columns.end(), "the poses are not numbered in a row");
    EVPOSE_RETURN_IF_ERROR(check.Finish());
    poses.push_back(is_next ? FromStored(*next++, check) : std::move(*next_in_columns++));
    poses.back().pose_seq = seq;
    check.Require(poses.back().object_index < num_objects, "a pose is of an object that the session does not have");
  }
  EVPOSE_RETURN_IF_ERROR(check.Finish());
  return poses;
}

}  // namespace evpose::server

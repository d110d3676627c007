// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/pose_reader.h"

#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "client/cli/common/pose_records.h"
#include "client/lib/messages/core_types.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// Collects the poses of one object.
class PoseCollector {
 public:
  absl::Status Add(const Pose& pose) {
    if (num_poses_ > 0 && pose.object_id != object_id_) {
      return absl::InvalidArgumentError(
          absl::StrCat("holds poses of ", object_id_, " and of ", pose.object_id, "; keep those of one object"));
    }
    if (num_poses_ > 0 && pose.t_us <= last_us_) return absl::InvalidArgumentError("its time does not increase");
    object_id_ = pose.object_id;
    last_us_ = pose.t_us;
    ++num_poses_;
    if (pose.state == TrackState::kAmbiguous) {
      poses_.ambiguous_us.push_back(pose.t_us);
      return absl::OkStatus();
    }
    if (pose.latest_loss && pose.latest_loss != latest_loss_) poses_.after_losses.push_back(poses_.trajectory.size());
    latest_loss_ = pose.latest_loss;
    poses_.trajectory.push_back({pose.t_us, ToCore(pose.camera_from_object)});
    poses_.covariances.push_back(pose.covariance);
    return absl::OkStatus();
  }

  ReadPoses Finish(const PoseFileFacts& facts) {
    poses_.transform = facts.transform;
    if (!facts.has_covariances) poses_.covariances.clear();
    return std::move(poses_);
  }

 private:
  ReadPoses poses_;
  size_t num_poses_ = 0;
  std::string object_id_;
  int64_t last_us_ = 0;
  std::optional<Loss> latest_loss_;  // of the last pose of the trajectory
};

}  // namespace

absl::StatusOr<ReadPoses> ReadPoseFile(const std::string& path) {
  PoseCollector poses;
  EVPOSE_ASSIGN_OR_RETURN(const PoseFileFacts facts,
                          VisitPoses(path, [&](const Pose& pose) { return poses.Add(pose); }));
  return poses.Finish(facts);
}

absl::StatusOr<ReadPoses> ReadCameraPoses(const std::string& path, const PoseFrame& frame) {
  EVPOSE_ASSIGN_OR_RETURN(ReadPoses read, ReadPoseFile(path));
  EVPOSE_ASSIGN_OR_RETURN(const PoseFrame to_camera, FrameToCamera(read.transform, frame, path));
  if (to_camera.is_default()) return read;
  for (size_t i = 0; i < read.trajectory.size(); ++i) {
    Pose pose;
    pose.t_us = read.trajectory[i].t_us;
    pose.camera_from_object = FromCore(read.trajectory[i].camera_from_object);
    if (!read.covariances.empty()) pose.covariance = read.covariances[i];
    pose = to_camera.Apply(pose);
    read.trajectory[i].camera_from_object = ToCore(pose.camera_from_object);
    if (!read.covariances.empty()) read.covariances[i] = pose.covariance;
  }
  read.transform = kCameraFromObject;
  return read;
}

absl::StatusOr<Trajectory> ReadTruePoses(const std::string& path, const std::optional<PoseFrame>& frame) {
  EVPOSE_RETURN_IF_ERROR(RefuseMcap(path, ".tum"));
  if (absl::EndsWith(path, ".csv") || absl::EndsWith(path, ".jsonl")) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": the true poses (--truth) are a TUM file"));
  }
  EVPOSE_ASSIGN_OR_RETURN(ReadPoses read, frame ? ReadCameraPoses(path, *frame) : ReadPoseFile(path));
  return std::move(read.trajectory);
}

}  // namespace evpose::client

// SPDX-License-Identifier: Apache-2.0

// Reads the files that PoseFiles writes.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/cli/common/pose_format.h"
#include "core/geometry/trajectory.h"

namespace evpose::client {

struct ReadPoses {
  // Name of the transform of the poses: the one that the file states (PoseHeader()), otherwise camera_from_object.
  std::string transform = kCameraFromObject;
  Trajectory trajectory;              // without the AMBIGUOUS poses
  std::vector<int64_t> ambiguous_us;  // times of the poses whose state is AMBIGUOUS
  std::vector<size_t> after_losses;   // indexes of the poses of `trajectory` before which the file states a loss
  std::vector<Matrix6d> covariances;  // one for each pose, or none: TUM has no covariances
};

// Reads a .csv, .jsonl or TUM file (VisitPoses()). Times must increase. Errors: those of VisitPoses(), and
// INVALID_ARGUMENT for poses of several objects.
absl::StatusOr<ReadPoses> ReadPoseFile(const std::string& path);
// ReadPoseFile() for users of camera_from_object: other transforms are converted, with their covariances. Additional
// errors: those of FrameToCamera().
absl::StatusOr<ReadPoses> ReadCameraPoses(const std::string& path, const PoseFrame& frame = {});
// Reads true poses, a TUM file, as ReadCameraPoses() does. Without a frame, the poses stay in that of the file.
// Additional error: INVALID_ARGUMENT for another format.
absl::StatusOr<Trajectory> ReadTruePoses(const std::string& path, const std::optional<PoseFrame>& frame = PoseFrame());

}  // namespace evpose::client

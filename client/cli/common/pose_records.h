// SPDX-License-Identifier: Apache-2.0

// Reads files of poses line by line, with all that each format states of a pose.
#pragma once

#include <string>

#include "absl/functional/function_ref.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "client/cli/common/pose_format.h"
#include "evpose/types.h"

namespace evpose::client {

// The properties that all poses of a file share.
struct PoseFileFacts {
  std::string transform;         // as the file states it (PoseHeader()), otherwise camera_from_object
  bool has_covariances = false;  // false: those of the poses are zero
  bool has_losses = false;       // true: the file states the latest loss before each pose (pose_columns.h)
};

// A pose as the file has it: the field camera_from_object is the file's transform. What the format does not state has
// the default of Pose, except for the state, which is kTracking; an object ID that is not stated is empty.
struct FilePose : Pose {
  // The rotation of camera_from_object. If the quaternion in a .csv or .jsonl file has a length within 1e-9 of 1, its
  // digits are kept as they are in the file; the quaternion that is computed from the matrix may differ in the last
  // digits.
  Eigen::Quaterniond quaternion = Eigen::Quaterniond::Identity();
};
using PoseVisitor = absl::FunctionRef<absl::Status(FilePose pose)>;

// Error: INVALID_ARGUMENT for a .mcap file, which replay writes and no command reads; `formats` are those to give.
absl::Status RefuseMcap(const std::string& path, const std::string& formats = ".tum, .csv or .jsonl");

// Calls `visit` for each pose in the order of the file, which is read as TUM unless its name ends in .csv or .jsonl.
// A .csv file is read by its header: t_us, tx_m to tz_m, qx to qw, and the other columns of PoseHeader() if they
// are present, in any order and among other columns. Errors name the file and the line: those of ReadFile(), of
// RefuseMcap() and of `visit`, and INVALID_ARGUMENT for a line that is not a pose.
absl::StatusOr<PoseFileFacts> VisitPoses(const std::string& path, PoseVisitor visit);
absl::StatusOr<PoseFileFacts> VisitCsvPoses(absl::string_view text, const std::string& name_for_errors,
                                            PoseVisitor visit);
absl::StatusOr<PoseFileFacts> VisitJsonPoses(absl::string_view text, const std::string& name_for_errors,
                                             PoseVisitor visit);

// Returns the frame whose Apply() turns poses with this transform into camera_from_object. `frame` is that of
// --world-from-camera. Error: INVALID_ARGUMENT with the path if the transform is neither that of `frame` nor
// camera_from_object nor object_from_camera.
absl::StatusOr<PoseFrame> FrameToCamera(const std::string& transform, const PoseFrame& frame, const std::string& path);

}  // namespace evpose::client

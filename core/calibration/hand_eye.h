// SPDX-License-Identifier: Apache-2.0

// The constant transforms and the clock offset between the poses of evpose and those of a robot or of another
// reference: hand-eye calibration, and alignment with a reference (core/calibration/README.md, section 7).
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/geometry/rigid_transform.h"
#include "core/geometry/trajectory.h"

namespace evpose {

// The body that is fixed to the moving part of the reference (the tool of a robot, or a tracked marker).
enum class HandEyeMount {
  kAuto,    // the one with the smaller residuals
  kBeside,  // the object; the camera stands beside the robot ("eye to hand")
  kInHand,  // the camera; the object is at rest ("eye in hand")
};
inline constexpr std::array<std::pair<HandEyeMount, const char*>, 3> kHandEyeMountNames = {
    {{HandEyeMount::kAuto, "auto"}, {HandEyeMount::kBeside, "beside"}, {HandEyeMount::kInHand, "in-hand"}}};
const char* HandEyeMountName(HandEyeMount mount);

// The limits are validated by hand_eye_test: transforms and offset within their standard errors, a robot that turns
// about one axis, and a trajectory of something else. The other fields are input.
struct HandEyeOptions {
  HandEyeMount mount = HandEyeMount::kAuto;
  // The clock of the reference minus that of the sensor, seconds; absent: estimated.
  std::optional<double> time_offset_s;
  // Both constant transforms are the identity, and only the offset is estimated.
  bool has_same_frames = false;
  // Number of poses that are used, evenly spread: more add no information, as successive errors are correlated.
  int max_poses = 2000;
  // Smallest number of poses with a reference at their time: six for each unknown transform.
  int min_poses = 12;
  // Smallest correlation of the speeds of both trajectories at the best offset: half of their variance is common.
  double min_correlation = 0.7;
  // Spread of the orientations about the second of their axes, radians, below which a rotation about one axis alone is
  // reported; 5 degrees, below which the errors of usual robots exceed a millimetre.
  double min_second_axis_rad = 0.087;

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// camera_from_object(t) = left * G(t + time_offset_s) * right, with G the reference (kBeside) or its inverse (kInHand).
struct HandEye {
  HandEyeMount mount = HandEyeMount::kBeside;
  RigidTransform left;   // camera_from_base (kBeside) or camera_from_tool (kInHand)
  RigidTransform right;  // tool_from_object or base_from_object
  // Standard errors of `left` and `right`, [translation (m), rotation (rad)] as in core/geometry/rigid_transform.h,
  // with the correlation of successive errors. Infinite for a motion that the poses do not determine.
  Vector6d left_errors = Vector6d::Zero();
  Vector6d right_errors = Vector6d::Zero();
  Matrix6d left_covariance = Matrix6d::Zero();
  double time_offset_s = 0.0;
  std::optional<double> time_offset_error_s;  // absent unless it was estimated
  double position_rms_m = 0.0;                // residuals of the poses that are no outliers
  double rotation_rms_rad = 0.0;
  int num_poses = 0;              // used
  int num_outliers = 0;           // of them, beyond 5 standard deviations
  double correlated_poses = 1.0;  // number of successive poses that count as one
  // Spread of the orientations of the reference about three perpendicular axes, the largest first: standard deviations.
  std::array<double, 3> axes_rad = {};
  // kAuto: residuals of the other mount over those of this one; 1 means undecided.
  std::optional<double> other_mount_ratio;
  bool has_second_axis = true;  // false: the reference turns about one axis only, which determines no transform
  // False: the residuals are as large as the motion, as of poses of something else or in another unit.
  bool explains_motion = true;
  std::vector<std::string> warnings;

  // The reference as camera_from_object on the sensor's clock.
  Trajectory Aligned(const Trajectory& reference) const;
  RigidTransform Predict(const RigidTransform& reference_pose) const;
};

// `reference` has poses base_from_tool (of any fixed base and moving tool) on its own clock. Errors: INVALID_ARGUMENT
// for options, FAILED_PRECONDITION if the poses do not suffice: too few in common, or no offset at which the speeds of
// both agree.
absl::StatusOr<HandEye> SolveHandEye(const Trajectory& camera_from_object, const Trajectory& reference,
                                     const HandEyeOptions& options = {});

}  // namespace evpose

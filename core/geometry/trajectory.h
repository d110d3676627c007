// SPDX-License-Identifier: Apache-2.0

// Trajectories as files: TUM, `timestamp tx ty tz qx qy qz qw`, seconds on the sensor's clock, camera_from_object.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

struct StampedPose {
  int64_t t_us = 0;
  RigidTransform camera_from_object;
};
using Trajectory = std::vector<StampedPose>;

// Times must increase; they are rounded to the microsecond. Blank lines and lines that begin with '#' are skipped; a
// file without a pose is an empty trajectory. Errors name path and line: NOT_FOUND, PERMISSION_DENIED,
// INVALID_ARGUMENT (not 8 numbers, a quaternion that is not unit to 1e-3, time that does not increase).
absl::StatusOr<Trajectory> ReadTumTrajectory(const std::string& path);
absl::StatusOr<Trajectory> ParseTumTrajectory(absl::string_view text, const std::string& name_for_errors);
// One line, without line feed: 6 decimals of time, 17 significant digits for the rest, so that the numbers read back
// have the same bits.
std::string TumLine(const StampedPose& pose);
// Written whole or not at all. Errors name the path.
absl::Status WriteTumTrajectory(const std::string& path, const Trajectory& trajectory);

// "tx ty tz qx qy qz qw", metres, separated by white space or commas. Errors: INVALID_ARGUMENT saying which number is
// missing or that the quaternion is not unit.
absl::StatusOr<RigidTransform> ParsePose(const std::string& text);

// The pose at t_us on the SE(3) geodesic (a screw motion) between its neighbours; at a sample exactly that sample.
// Errors: OUT_OF_RANGE outside the trajectory.
absl::StatusOr<RigidTransform> Interpolate(const Trajectory& trajectory, int64_t t_us);

}  // namespace evpose

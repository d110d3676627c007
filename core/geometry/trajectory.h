// SPDX-License-Identifier: Apache-2.0

// Trajectories, and their files in the TUM format: a line `timestamp tx ty tz qx qy qz qw` per pose camera_from_object,
// in seconds of the sensor clock and metres.
#pragma once

#include <cstdint>
#include <optional>
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

// Reads a trajectory. Times are rounded to microseconds and must increase. Blank lines and lines that begin with '#'
// are skipped; a file without a pose is an empty trajectory. Errors have path and line: NOT_FOUND, PERMISSION_DENIED,
// INVALID_ARGUMENT (not 8 numbers, a quaternion whose norm is not 1 to 1e-3, a time that does not increase).
absl::StatusOr<Trajectory> ReadTumTrajectory(const std::string& path);
absl::StatusOr<Trajectory> ParseTumTrajectory(absl::string_view text, const std::string& name_for_errors);
// One line without line feed: the time with 6 decimals, the other numbers with 17 significant digits, which determine a
// double.
std::string TumLine(const StampedPose& pose);
// Writes a file as OutputFile does: complete or not at all. Errors have the path.
absl::Status WriteTumTrajectory(const std::string& path, const Trajectory& trajectory);

// Parses "tx ty tz qx qy qz qw" (metres), separated by white space or commas. Errors: INVALID_ARGUMENT with the missing
// or wrong number.
absl::StatusOr<RigidTransform> ParsePose(const std::string& text);

// The pose at t_us on the screw motion between the neighbouring samples; at the time of a sample exactly that sample.
// Errors: OUT_OF_RANGE outside the trajectory.
absl::StatusOr<RigidTransform> Interpolate(const Trajectory& trajectory, int64_t t_us);
// Interpolate() between samples that are at most `max_gap_us` apart; before the first and after the last one, that
// sample if it is at most `max_gap_us` away. Else nullopt.
std::optional<RigidTransform> PoseNear(const Trajectory& trajectory, int64_t t_us, int64_t max_gap_us);

}  // namespace evpose

// Trajectories as files: TUM, `timestamp tx ty tz qx qy qz qw`, seconds on the sensor's clock, camera_from_object.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

struct StampedPose {
  int64_t t_us = 0;
  RigidTransform camera_from_object;
};
using Trajectory = std::vector<StampedPose>;

// Times must increase. Errors name path and line: NOT_FOUND, INVALID_ARGUMENT (not 8 numbers, a quaternion that is
// not unit to 1e-3, time that does not increase).
absl::StatusOr<Trajectory> ReadTumTrajectory(const std::string& path);
// One line, without line feed: 6 decimals of time, 17 significant digits for the rest, so that reading gives the same bits.
std::string TumLine(const StampedPose& pose);
// Written whole or not at all.
absl::Status WriteTumTrajectory(const std::string& path, const Trajectory& trajectory);

// "tx ty tz qx qy qz qw". Errors: INVALID_ARGUMENT saying which number is missing or that the quaternion is not unit.
absl::StatusOr<RigidTransform> ParsePose(const std::string& text);

// The pose at t_us by interpolation on SE(3) (constant twist between neighbours). OUT_OF_RANGE outside the trajectory.
absl::StatusOr<RigidTransform> Interpolate(const Trajectory& trajectory, int64_t t_us);

}  // namespace evpose

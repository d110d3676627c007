// SPDX-License-Identifier: Apache-2.0

// An estimated trajectory against the truth. No alignment: both are camera_from_object on the sensor's clock.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"

namespace evpose {

struct EvaluationOptions {
  // An estimate is good when it is within both of these. 5 % and 10 deg: beyond, a tracker no longer finds its lines
  // again by itself (the gate of 8 px is 5 % of an object 160 px wide).
  double good_position_ratio = 0.05;  // of the true depth
  double good_rotation_rad = 0.1745;
  // An estimate stands for the time after it, until the next one but at most for this long: the longest window that
  // closes on time, with room.
  int64_t max_gap_us = 20'000;
  // Rigid motions that map the object onto itself (object_from_object), the identity included or not. Each estimate is
  // compared with the nearest of the equivalent truths: smallest rotation, then smallest distance.
  std::vector<RigidTransform> symmetries;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// One estimate against the truth at its time.
struct TrajectoryError {
  int64_t t_us = 0;
  RigidTransform estimated_pose;
  RigidTransform true_pose;  // of the equivalent truths the nearest
  double position_m = 0.0;
  double position_of_depth = 0.0;
  double rotation_rad = 0.0;
  bool is_good = false;
};

// Of the estimates inside the truth's time span, in order. Errors as Evaluate(), but an estimate outside the span is
// none.
absl::StatusOr<std::vector<TrajectoryError>> TrajectoryErrors(const Trajectory& truth, const Trajectory& estimate,
                                                              const EvaluationOptions& options = {});

// Errors are taken at the estimates' own times, the truth interpolated, over the estimates inside the truth's time
// span; all of them, good or not. Without any they are NaN.
struct Evaluation {
  uint64_t num_poses = 0;  // estimates inside the truth's time span
  // The share of the truth's time span that good estimates stand for (see max_gap_us).
  double coverage_ratio = 0.0;
  // Distance between the estimated and the true position of the object's origin in the camera frame.
  double position_rmse_m = 0.0;
  double position_mean_m = 0.0;
  double position_median_m = 0.0;
  double position_std_m = 0.0;  // about the mean, of the population
  // Root mean square of distance / true depth, depth the z of the object's origin.
  double position_rmse_of_depth = 0.0;
  // Angle between the estimated and the true rotation. The 95th percentile is interpolated between neighbours.
  double rotation_mean_rad = 0.0;
  double rotation_median_rad = 0.0;
  double rotation_p95_rad = 0.0;
  double rotation_max_rad = 0.0;
  // With a model and a camera: mean distance, undistorted pixels, between the estimated and the true projections of all
  // the lines' end points, hidden ones too. A distance counts as the image's diagonal at most, and as that when only
  // the estimate puts the point behind the camera; points truly behind it are left out.
  std::optional<double> reprojection_mean_px;
  // Times that a good estimate was followed by a bad one or by more than max_gap_us without one, the truth's end
  // included.
  uint64_t losses = 0;
  std::vector<int64_t> losses_at_us;  // the times of those last good estimates
  double pose_rate_hz = 0.0;          // (num_poses - 1) / time from the first to the last of them; 0 for less than 2
};

// An estimate without any pose is a result (a tracker that lost the object at once): coverage 0.
// Errors: INVALID_ARGUMENT for options, a truth of fewer than 2 poses or with the object not in front of the camera,
// times that do not increase, or an estimate that lies wholly outside the truth's time span (naming both).
absl::StatusOr<Evaluation> Evaluate(const Trajectory& truth, const Trajectory& estimate,
                                    const EvaluationOptions& options = {}, const ObjectModel* model = nullptr,
                                    const CameraModel* camera = nullptr);

}  // namespace evpose

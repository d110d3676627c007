// SPDX-License-Identifier: Apache-2.0

// Compares an estimated trajectory with the truth (core/evaluation/README.md, section 1). Both are camera_from_object
// on the sensor's clock; no alignment is applied.
#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"

namespace evpose {

// The bounds define which estimates count as good; they are not tuned. evaluate_test checks both.
struct EvaluationOptions {
  // An estimate is good if it is within both bounds. Beyond 5 % and 10 deg a tracker cannot recover by association (a
  // gate of 8 px is 5 % of an object that is 160 px wide).
  double good_position_ratio = 0.05;  // as a share of the true depth
  double good_rotation_rad = 0.1745;
  // An estimate is valid until the next one, but for at most this time: the longest duration of a window
  // (WindowOptions::max_duration_us).
  int64_t max_gap_us = 20'000;
  // Rigid motions that map the object onto itself (object_from_object), with or without the identity. Each estimate is
  // compared with the nearest equivalent true pose: smallest rotation, then smallest distance.
  std::vector<RigidTransform> symmetries;
  // Instead of `symmetries`. The rotation error is the angle between the axes, the smaller one if the symmetry is
  // flippable; that of a sphere is 0. The position error is that of the symmetry's centre.
  std::optional<ContinuousSymmetry> continuous_symmetry;

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// An estimate compared with the truth at its time.
struct TrajectoryError {
  int64_t t_us = 0;
  RigidTransform estimated_pose;
  RigidTransform true_pose;  // the nearest of the equivalent true poses
  double position_m = 0.0;
  double position_of_depth = 0.0;
  double rotation_rad = 0.0;
  bool is_good = false;
};

// The errors of the estimates within the truth's time span, in order. Returns the errors of Evaluate(), except that
// estimates outside the span are ignored.
absl::StatusOr<std::vector<TrajectoryError>> TrajectoryErrors(const Trajectory& truth, const Trajectory& estimate,
                                                              const EvaluationOptions& options = {});

inline constexpr double kUndefinedError = std::numeric_limits<double>::quiet_NaN();

// Errors are computed at the times of the estimates, with interpolated truth, over all estimates within the truth's
// time span, good or not. Without any they are NaN.
struct Evaluation {
  uint64_t num_poses = 0;  // estimates within the truth's time span
  // Share of the truth's time span for which good estimates are valid (see max_gap_us).
  double coverage_ratio = 0.0;
  double ambiguous_ratio = 0.0;  // share for which AMBIGUOUS estimates are valid
  // Distance between the estimated and the true position of the object's origin, or of the centre of its continuous
  // symmetry, in the camera frame.
  double position_rmse_m = kUndefinedError;
  double position_mean_m = kUndefinedError;
  double position_median_m = kUndefinedError;
  double position_std_m = kUndefinedError;  // about the mean; population standard deviation
  // Root mean square of distance / true depth; the depth is the z coordinate of the object's origin.
  double position_rmse_of_depth = kUndefinedError;
  // Angle between the estimated and the true rotation. The 95th percentile is interpolated linearly.
  double rotation_mean_rad = kUndefinedError;
  double rotation_median_rad = kUndefinedError;
  double rotation_p95_rad = kUndefinedError;
  double rotation_max_rad = kUndefinedError;
  // With a model and a camera: mean distance, in undistorted pixels, between the estimated and the true projections of
  // the end points of all lines and points of all curves, or of the vertices of a model without edges, hidden ones
  // included. A distance counts as at most the image's diagonal, which also
  // replaces the distance of a point that only the estimate places behind the camera; points that are truly behind it
  // are ignored.
  std::optional<double> reprojection_mean_px;
  // Number of times that a good estimate was followed by a bad one or by a gap of more than max_gap_us, the end of the
  // truth included. AMBIGUOUS estimates in between neither end the good period nor prolong its coverage.
  uint64_t losses = 0;
  std::vector<int64_t> losses_at_us;  // times of the last good estimates
  double pose_rate_hz = 0.0;  // (num_poses - 1) / time between the first and the last of them; 0 for fewer than 2
};

// Evaluates `estimate`. `ambiguous_us`, which must increase, are the times of AMBIGUOUS estimates, which are not part
// of `estimate`. An estimate without any pose is valid input (a tracker that lost the object at once): its coverage is
// 0. The reprojection error needs both `model` and `camera`. Errors: INVALID_ARGUMENT for options, a truth of fewer
// than 2 poses or with the object not in front of the camera, times that do not increase, or an estimate that lies
// entirely outside the truth's time span (naming both).
absl::StatusOr<Evaluation> Evaluate(const Trajectory& truth, const Trajectory& estimate,
                                    const EvaluationOptions& options = {}, const ObjectModel* model = nullptr,
                                    const CameraModel* camera = nullptr, absl::Span<const int64_t> ambiguous_us = {});

}  // namespace evpose

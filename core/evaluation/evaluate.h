// An estimated trajectory against the truth.
#pragma once

#include <optional>

#include "absl/status/statusor.h"
#include "core/geometry/trajectory.h"
#include "core/geometry/camera.h"
#include "core/models/object_model.h"

namespace evpose {

struct EvaluationOptions {
  // A pose is good within both; coverage is the share of truth time covered by good poses.
  double good_position_ratio = 0.05;   // of the true depth
  double good_rotation_rad = 0.1745;   // 10 deg
  int64_t max_gap_us = 20'000;         // an estimate is held for at most this long when coverage is counted
  // Compare modulo the model's symmetries (rotations, identity included).
  std::vector<Eigen::Matrix3d> symmetries;
};

struct Evaluation {
  uint64_t num_poses = 0;             // estimates inside the truth's time span
  double coverage_ratio = 0.0;        // of the truth's time span
  double position_rmse_m = 0.0;       // over all estimates; no alignment: camera frame, absolute
  double position_mean_m = 0.0;
  double position_median_m = 0.0;
  double position_std_m = 0.0;
  double position_rmse_of_depth = 0.0;  // RMSE of |error| / true depth
  double rotation_mean_rad = 0.0;
  double rotation_median_rad = 0.0;
  double rotation_p95_rad = 0.0;
  double rotation_max_rad = 0.0;
  std::optional<double> reprojection_mean_px;  // of the lines' end points; with model and camera
  uint64_t losses = 0;                // times a good estimate was followed by a bad one or by a gap
  double pose_rate_hz = 0.0;
};

// Errors: INVALID_ARGUMENT when the time spans do not overlap, or a trajectory has fewer than 2 poses.
absl::StatusOr<Evaluation> Evaluate(const Trajectory& truth, const Trajectory& estimate,
                                    const EvaluationOptions& options, const ObjectModel* model = nullptr,
                                    const CameraModel* camera = nullptr);

}  // namespace evpose

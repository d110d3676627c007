// SPDX-License-Identifier: Apache-2.0

// Scores of a tracker on a recording of a real sensor. The reference trajectory has an error of about one pixel, so
// that the errors of poses are given as distances in the image (core/experiments/README.md, section 4).
#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"
#include "core/tracking/object/pose_estimate.h"

namespace evpose {

// The distance in the image between the projections of the model at two poses.
class ReprojectionError {
 public:
  // Keeps references: `model` and `camera` must outlive it.
  ReprojectionError(const ObjectModel& model, const CameraModel& camera);

  // Root mean square distance, undistorted pixels, of the end points of the model's lines that the reference projects
  // into the image; of its vertices if it has no line. The estimate may differ by a symmetry of the model. A distance
  // counts as at most the image's diagonal. Nullopt if no point is in view.
  std::optional<double> Px(const RigidTransform& reference, const RigidTransform& estimate) const;

 private:
  const ObjectModel& model_;
  const CameraModel& camera_;
  std::vector<Eigen::Vector3d> points_;  // object frame
};

// A run over a part of a recording.
struct RealRun {
  int64_t start_us = 0;  // sensor time of its first event
  double duration_s = 0.0;
  // Time until TRACKING was reported first: sensor time from the start to the event that caused the report, and the
  // processor time spent until then. NaN if it never was; then the whole processor time is in `compute_s`.
  double wait_s = std::numeric_limits<double>::quiet_NaN();
  double compute_to_tracking_s = std::numeric_limits<double>::quiet_NaN();
  double compute_s = 0.0;
  // Error of the first pose while TRACKING; NaN without one within the reference's time span.
  double first_error_px = std::numeric_limits<double>::quiet_NaN();
  bool is_first_wrong = false;  // whether it is wrong
  // Share of the run for which a right pose was reported, in any state; for which poses were reported with another
  // state than TRACKING; and for which that state was AMBIGUOUS.
  double right_ratio = 0.0;
  double doubtful_ratio = 0.0;
  double ambiguous_ratio = 0.0;
  double tracking_s = 0.0;  // time for which TRACKING was reported
  double wrong_s = 0.0;     // time for which TRACKING was reported with a wrong pose, and the longest such time
  double longest_wrong_s = 0.0;
  double median_error_px = std::numeric_limits<double>::quiet_NaN();  // median error of all reported poses
  double p95_error_px = std::numeric_limits<double>::quiet_NaN();
  uint64_t losses = 0;

  // Largest distance in the image between the reference at the first and at another of its poses in the run; 0 without
  // a reference.
  double motion_px = 0.0;

  bool is_found() const { return wait_s == wait_s; }
};

// Sets the errors, ratios and times of the poses of `run`. The start and the duration of `run` must be set before. A
// pose is valid until the next one, for at most 20 ms; it is right if its error is at most `bound_px`. Without a
// reference every pose is wrong (an object that is absent). Poses outside the reference's time span are ignored.
void ScoreRealPoses(absl::Span<const PoseEstimate> poses, const Trajectory* reference, const ReprojectionError* error,
                    double bound_px, RealRun& run);

}  // namespace evpose

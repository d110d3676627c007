// SPDX-License-Identifier: Apache-2.0

// The source paper's synthetic experiment (Sec. IV-A, Fig. 6; core/experiments/README.md, section 2): events about
// random lines of which it is known, rightly or wrongly, which line each belongs to.
#pragma once

#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/baselines/estimators/line_fit.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

struct SyntheticTrialOptions {
  int num_lines = 25;           // [4, 1000]: three are the least that determine a pose, and may have several
  int events_per_line = 100;    // [1, 10000]
  double noise_px = 2.0;        // standard deviation of an event's distance from its line, [0, 100]
  double outlier_ratio = 0.02;  // of all events: those that are said to belong to another line than theirs, [0, 1]
  // The start is the truth, moved: each component of the axis-angle vector by up to so much, and each coordinate of the
  // position by up to so much of its norm, uniformly. Twice and once what OpenGV, whose way of perturbing the paper
  // cites, does in its own benchmarks: lines start several pixels off.
  double start_rotation_rad = 0.02;       // [0, 3]
  double start_translation_ratio = 0.01;  // [0, 1]

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

struct SyntheticTrial {
  CameraModel camera;
  std::vector<LineEnds> lines;        // object frame
  std::vector<LabelledEvent> events;  // in random order; `line` is what it is said to be
  std::vector<int> true_line;         // of each event
  double noise_px = 0.0;
  RigidTransform camera_from_object;  // truth
  RigidTransform start;
};

// A camera of 640x480 with f = 800 and the principal point in the middle. The ends of a line are seen anywhere in the
// image, uniformly, at depths that are uniform in [5, 10] m; lines that are shorter than 50 px in the image are drawn
// again, because under the largest noise of the experiment (10 px) their events are no line any more. The object's
// attitude is uniform over all, its origin seen in the middle half of the image each way, at [6.5, 8.5] m: in the
// midst of its lines. Events lie uniformly along the line's image, which is inside the image, and the noise is Gaussian
// and at right angles to it. Outliers are as the paper makes them: of events chosen at random, round(ratio x number),
// the line is another one, chosen at random.
//
// The same seed gives the same trial; with other noise or another share of outliers the same lines and pose.
// `options` must be valid.
SyntheticTrial MakeSyntheticTrial(const SyntheticTrialOptions& options, uint64_t seed);

// As the paper defines them (Sec. IV-A).
struct SyntheticError {
  double rotation_deg = 0.0;
  double translation_ratio = 0.0;  // |T - T_truth| / |T_truth|
};
SyntheticError CompareWithTruth(const SyntheticTrial& trial, const RigidTransform& camera_from_object);

// What the events of a trial tell about the pose at the very best.
struct SyntheticBound {
  // Fisher's information about [translation, rotation], left perturbation, of the events whose line is right:
  // F = sigma^-2 sum_j A_j^T (sum_i b_i b_i^T) A_j at the truth (core/experiments/README.md, equation (1)), with b_i
  // the events' places on their lines. The covariance of any unbiased estimate is at least F^-1, the Cramer-Rao bound.
  Matrix6d information = Matrix6d::Zero();
  // The error of the efficient estimator under this trial's own noise, -F^-1 sum_i A_j^T b_i d_i / sigma^2: a step of
  // maximum likelihood that starts at the truth and is told which events are outliers. Over the noise it is distributed
  // by N(0, F^-1), exactly. Other estimators see the same noise, so that in a ratio of errors most of the chance in
  // them cancels.
  Vector6d efficient_error = Vector6d::Zero();
};

// FAILED_PRECONDITION when the events that are right do not determine the pose, or without noise: no bound.
absl::StatusOr<SyntheticBound> ComputeSyntheticBound(const SyntheticTrial& trial);

}  // namespace evpose

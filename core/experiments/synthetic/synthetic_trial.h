// SPDX-License-Identifier: Apache-2.0

// Trials of the synthetic experiment of the paper (Sec. IV-A, Fig. 6; core/experiments/README.md, section 2): events of
// random lines, each with a label, right or wrong, of its line.
#pragma once

#include <cstdint>
#include <vector>

#include "absl/status/statusor.h"
#include "core/baselines/estimators/line_fit.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

// The defaults of lines, events, noise and outliers are those of the paper's synthetic experiment
// (core/experiments/README.md).
struct SyntheticTrialOptions {
  int num_lines = 25;           // [4, 1000]; three lines are the minimum and may allow several poses
  int events_per_line = 100;    // [1, 10000]
  double noise_px = 2.0;        // standard deviation of an event's distance from its line, [0, 100]
  double outlier_ratio = 0.02;  // [0, 1]; share of events with the label of another line
  // The start deviates from the truth by up to this angle in each component of the axis-angle vector, and by up to this
  // ratio of the norm of the position in each coordinate, uniformly distributed. These are twice and once the values of
  // the benchmarks of OpenGV, which the paper cites for its perturbation: lines start with errors of several pixels.
  double start_rotation_rad = 0.02;       // [0, 3]
  double start_translation_ratio = 0.01;  // [0, 1]
};

struct SyntheticTrial {
  CameraModel camera;
  std::vector<LineEnds> lines;        // object frame
  std::vector<LabelledEvent> events;  // in random order; `line` is the label
  std::vector<int> true_line;         // right line of each event
  double noise_px = 0.0;
  RigidTransform camera_from_object;  // true pose
  RigidTransform start;
};

// Makes a trial. The camera has 640 x 480 pixels, f = 800 and the principal point in the centre. The images of the end
// points of a line are uniform in the image, their depths uniform in [5, 10] m. Lines shorter than 50 px in the image
// are drawn again, because with the largest noise of the experiment (10 px) their events no longer form a line. The
// rotation of the object is uniform; its origin is seen in the central half of the image in both directions, at [6.5,
// 8.5] m, among its lines. Events are uniform along the image of their line, inside the image, with Gaussian noise
// perpendicular to it. Outliers as in the paper: round(ratio x number) events, chosen at random, get the label of
// another random line.
//
// Equal seeds give equal trials; with another noise or outlier ratio the lines and the pose stay the same. `options`
// must be valid.
SyntheticTrial MakeSyntheticTrial(const SyntheticTrialOptions& options, uint64_t seed);

// Errors as defined in Sec. IV-A of the paper.
struct SyntheticError {
  double rotation_deg = 0.0;
  double translation_ratio = 0.0;  // |T - T_truth| / |T_truth|
};
SyntheticError CompareWithTruth(const SyntheticTrial& trial, const RigidTransform& camera_from_object);

// Lower bound of the error for the events of a trial.
struct SyntheticBound {
  // Fisher information of [translation, rotation], left perturbation, of the events with right labels: F = sigma^-2
  // sum_j A_j^T (sum_i b_i b_i^T) A_j at the truth (core/experiments/README.md, equation (1)), with the bearings b_i of
  // the events without noise. The covariance of any unbiased estimate is at least F^-1, the Cramer-Rao bound.
  Matrix6d information = Matrix6d::Zero();
  // Error of the efficient estimator for the noise of this trial, -F^-1 sum_i A_j^T b_i d_i / sigma^2: one step of
  // maximum likelihood from the truth with known outliers. Over the noise its distribution is exactly N(0, F^-1). Other
  // estimators get the same noise, so that most of the random variation cancels in a ratio of errors.
  Vector6d efficient_error = Vector6d::Zero();
};

// Computes the bound. FAILED_PRECONDITION if the events with right labels do not determine the pose, or without noise,
// where there is no bound.
absl::StatusOr<SyntheticBound> ComputeSyntheticBound(const SyntheticTrial& trial);

}  // namespace evpose

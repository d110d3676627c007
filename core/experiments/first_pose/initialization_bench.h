// SPDX-License-Identifier: Apache-2.0

// Benchmark of the methods for first poses; all of them get the same segments.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/baselines/first_pose/rotation_bnb.h"
#include "core/simulation/scene.h"

namespace evpose {

struct BenchClutter {
  int num_spurious = 0;
  int num_missing = 0;
};

struct InitializationBenchOptions {
  // Number of trials for each object and each share of clutter; slow methods process only the first ones (max_trials of
  // the method).
  int num_trials = 1000;
  uint64_t seed = 1;      // equal seeds give equal trials
  double noise_px = 0.8;  // pixels, standard deviation of each coordinate of an end point
  std::vector<SimulatedObject> objects = {SimulatedObject::kPlanar, SimulatedObject::kCube, SimulatedObject::kBook,
                                          SimulatedObject::kSpacecraft, SimulatedObject::kCuboid};
  std::vector<BenchClutter> clutter = {{0, 0}, {2, 1}, {4, 2}};
  std::vector<std::string> methods;  // names of InitializationMethods(); empty: all
  // Runs every method on every trial, regardless of its max_trials.
  bool is_unlimited = false;
  // Tests for each pose that was found whether its rotation attains the maximum of the objective of the paper
  // (CertifyPose), with this budget.
  bool certifies = false;
  RotationBnbOptions certificate;

  // INVALID_ARGUMENT names the field or an unknown method.
  absl::Status Validate() const;
};

// Certificates of the poses that a method found (CertifyPose).
struct CertificateCounts {
  int num_maximum = 0;  // proved by equal bounds: no rotation has a larger count
  int num_not_maximum = 0;
  int num_unknown = 0;     // the budget was spent
  double median_ms = 0.0;  // wall clock per certificate; NaN if no pose was found
};

// One method on one object with one clutter.
struct InitializationBenchRow {
  SimulatedObject object = SimulatedObject::kCube;
  BenchClutter clutter;
  std::string method;
  int num_trials = 0;
  int num_right = 0;  // PoseError::is_right
  int num_none = 0;   // trials without a pose
  // Reprojection errors of the end points of the visible lines, pixels. The mean of right poses is the accuracy. The
  // mean over all is the figure of the paper and mainly measures how wrong the wrong poses are (a missing pose counts
  // as the diagonal of the image). NaN without a right pose.
  double reprojection_mean_right_px = 0.0;
  double reprojection_median_px = 0.0;
  double reprojection_mean_px = 0.0;
  double median_ms = 0.0;  // milliseconds of wall clock on one core
  double worst_ms = 0.0;
  // Present if requested, for methods that find the correspondences themselves.
  std::optional<CertificateCounts> certificates;
  // Seeds of the trials without a right pose, for LineTrialGenerator::Make.
  std::vector<uint64_t> failed_seeds;
};

// Runs the benchmark; the rows are in the order of objects, clutter and methods. All but the times is a function of the
// options. `on_row` is called after each row; returning false ends the work with CANCELLED. Other errors: those of
// Validate(), of LineTrialGenerator and of the construction of the methods.
absl::StatusOr<std::vector<InitializationBenchRow>> RunInitializationBench(
    const InitializationBenchOptions& options, const std::function<bool(const InitializationBenchRow&)>& on_row);

}  // namespace evpose

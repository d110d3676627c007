// SPDX-License-Identifier: Apache-2.0

// Methods of the first pose against each other: the same segments for all.
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
  int num_trials = 1000;  // of each object and clutter; slow methods do the first of them (max_trials of the method)
  uint64_t seed = 1;      // the same seed gives the same trials
  double noise_px = 0.8;  // of each coordinate of an end point
  std::vector<SimulatedObject> objects = {SimulatedObject::kPlanar, SimulatedObject::kCube, SimulatedObject::kBook,
                                          SimulatedObject::kSpacecraft, SimulatedObject::kCuboid};
  std::vector<BenchClutter> clutter = {{0, 0}, {2, 1}, {4, 2}};
  std::vector<std::string> methods;  // names; empty: all
  // Every method does every trial, however long it takes.
  bool is_unlimited = false;
  // The pose prior of the methods that need one: standard deviation of each component of the axis-angle vector, and of
  // each coordinate of the position in shares of the depth. A generous guess of a tracker that has just lost its
  // object.
  double prior_rotation_rad = 0.1745;  // 10 deg: the attitude is off by 16 deg in the median
  double prior_translation_ratio = 0.05;
  // Ask of each pose that was found whether its rotation attains the maximum of the published objective (CertifyPose),
  // with this budget.
  bool certifies = false;
  RotationBnbOptions certificate;

  // INVALID_ARGUMENT naming the field, or a method that is not known.
  absl::Status Validate() const;
};

// Of the poses that a method found (CertifyPose).
struct CertificateCounts {
  int num_maximum = 0;  // proved by equal bounds: no rotation has a greater count
  int num_not_maximum = 0;
  int num_unknown = 0;     // the budget was spent
  double median_ms = 0.0;  // wall clock, of one certificate; NaN when no pose was found
};

// One method on one object with one clutter.
struct InitializationBenchRow {
  SimulatedObject object = SimulatedObject::kCube;
  BenchClutter clutter;
  std::string method;
  int num_trials = 0;
  int num_right = 0;  // PoseError::is_right
  int num_none = 0;   // the method gave no pose
  // Of the end points of the visible lines, pixels. The mean of right poses is the accuracy; the mean over all is what
  // the source paper prints, and mostly says how wrong the wrong poses are (no pose counts as the image's diagonal).
  // NaN without a right pose.
  double reprojection_mean_right_px = 0.0;
  double reprojection_median_px = 0.0;
  double reprojection_mean_px = 0.0;
  double median_ms = 0.0;  // wall clock, one core
  double worst_ms = 0.0;
  // When asked for, of a method that finds out by itself which line is which.
  std::optional<CertificateCounts> certificates;
  // LineTrialGenerator::Make gives the trials again that had no right pose.
  std::vector<uint64_t> failed_seeds;
};

// In the order of objects, clutter and methods. All but the times is a function of the options. `on_row` is called
// after each row; returning false stops, with CANCELLED. Errors otherwise as Validate(), and those of
// LineTrialGenerator and of the methods' construction.
absl::StatusOr<std::vector<InitializationBenchRow>> RunInitializationBench(
    const InitializationBenchOptions& options, const std::function<bool(const InitializationBenchRow&)>& on_row);

}  // namespace evpose

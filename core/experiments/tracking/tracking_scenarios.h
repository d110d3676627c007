// SPDX-License-Identifier: Apache-2.0

// Scenarios of the tracking benchmark: those of the paper, with the simulator of this project, and more difficult ones.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/simulation/simulator.h"

namespace evpose {

// Targets of the default estimator with its own first pose, for the mean of the runs; the worst run may have twice the
// errors.
struct TrackingTargets {
  double position_rmse_of_depth = 0.0008;
  double rotation_median_deg = 0.08;
  double rotation_p95_deg = 0.25;
  // Bounds for the median of the normalised estimation error squared (NEES), six degrees of freedom, and for the share
  // of the poses with the truth inside the 95 % ellipsoid. A consistent covariance has 5.3 and 0.95.
  double nees_median_low = 3.0;
  double nees_median_high = 8.0;
  double inside_95_ratio_low = 0.90;
  double inside_95_ratio_high = 0.99;
  double coverage_ratio = 0.995;
  uint64_t losses = 0;
};

struct TrackingScenario {
  std::string name;
  std::string description;
  SimulationOptions simulation;  // the benchmark sets its seeds
  TrackingTargets targets;
};

// Returns all scenarios in the order of the table:
//   - 640 x 480, the table of simulated events in the paper: a spacecraft at its speeds, "normal" (20 s, 0.71 m/s,
//     0.32 rad/s), "fast" (10 s, 1.41, 0.63), "faster" (5 s, 2.83, 1.26), "constant-light" and "changing-light" (10 s,
//     0.77, 0.18). The paper gives neither depths nor sizes: here the object stays in view and produces about the event
//     rates of the paper (for "faster" a third: at a smaller distance it could not move as fast and stay in view).
//   - 1280 x 720, objects of the paper with all of its difficulties at once: 10 % noise, a flickering lamp and a bar in
//     front of the object: "planar", "cube", "book", "spacecraft".
//   - 1280 x 720, one difficulty at a time, each with 5 % noise: "rests", "background-activity", "hot-pixels",
//     "occlusion-40", "bursts", "background-edge", "half-out", "uncalibrated".
std::vector<TrackingScenario> TrackingScenarios();

// Returns the scenarios with these names in the order of the table; all if `names` is empty. Errors: INVALID_ARGUMENT
// lists the known names.
absl::StatusOr<std::vector<TrackingScenario>> FindTrackingScenarios(const std::vector<std::string>& names);

// Returns the simulation of one run. `path` determines the motion, `seed` pixels, noise and textures. The duration is
// at most `max_duration_us`; 0: the duration of the scenario.
SimulationOptions TrackingRun(const TrackingScenario& scenario, uint64_t seed, uint64_t path, int64_t max_duration_us);

}  // namespace evpose

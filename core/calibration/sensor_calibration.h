// SPDX-License-Identifier: Apache-2.0

// Fits the profile of a sensor to the passages of edges at known poses (core/calibration/README.md, section 6).
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/calibration/edge_passages.h"
#include "core/estimation/sensor_profile.h"
#include "core/events/correlated_events.h"

namespace evpose {

// The defaults are validated by sensor_calibration_test: the fitted constants are within their standard errors of the
// truth, and data that do not determine the constants are rejected. In the scenario "uncalibrated" of `evpose bench
// tracking` the fitted profile reduces the position error from 0.075 to 0.042 % (core/experiments/RESULTS.md,
// Tracking).
struct SensorCalibrationOptions {
  // Start of the fit, and the value of each constant that the recordings do not determine.
  SensorProfile initial;
  // Whether the poses come from another source than the events. Poses of the tracker follow the events: a delay that is
  // common to all edges cannot be seen in them, and the two times keep their initial values.
  bool has_independent_poses = true;
  // Smallest |kappa| of a passage of a single edge. The passage of a stripe carries no information about the constants.
  double min_kappa = 0.9;
  // Smallest number of pairs of a line and a direction, and of their passages, for a fit of four constants; both
  // include a margin.
  int min_groups = 8;
  int min_passages = 100;
  // Smallest ratio of the 90th to the 10th percentile of the speeds at which the latency is distinguishable from the
  // lag, and the refractory time from the threshold.
  double min_speed_ratio = 2.0;
  // Standard error, as a share of the constant, above which the constant counts as not determined.
  double max_relative_error = 0.25;
  // Residual error of the model with the best constants, pixels. It limits the weight of a passage: additional events
  // do not reduce it.
  double model_error_px = 0.05;
  // Number of correlated events of an edge that count as one.
  double events_per_information = kCorrelatedEvents;
  // Number of standard deviations above which the weight of a residual is reduced (Huber), because another object may
  // have moved there.
  double robust_sigmas = 2.0;

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// The passages of one recording.
struct CalibrationRecording {
  std::string name;
  std::vector<EdgePassage> passages;
};

// The times of a profile that were fitted. The others have their initial values.
enum class FittedTimes {
  kNone,     // the speeds are nearly equal, or the poses were tracked in the same events and follow their delay
  kLatency,  // the recordings do not determine the refractory time
  kBoth,
};

struct SensorCalibration {
  SensorProfile profile;
  // Standard errors. The passages of a line of one recording in one direction share the model's error of that line, so
  // that the independent units are lines and directions.
  double blur_error_px = 0.0;
  double contrast_threshold_error = 0.0;
  double latency_error_us = 0.0;
  double refractory_error_us = 0.0;
  FittedTimes fitted_times = FittedTimes::kNone;
  double pixel_noise_error_px = 0.0;

  int num_passages = 0;
  int num_groups = 0;  // number of pairs of a line of a recording and a direction
  double num_events = 0.0;
  double slowest_px_per_s = 0.0;  // 10th and 90th percentile of the speeds
  double fastest_px_per_s = 0.0;
  // Root mean square, over the passages, of the displacement of their events, and of its remainder after the
  // correction.
  double uncorrected_rms_px = 0.0;
  double initial_rms_px = 0.0;
  double fitted_rms_px = 0.0;
  // Displacement of an edge with the median contrast and reversals of the passages: to its darker side, and behind the
  // motion.
  double typical_contrast = 0.0;
  double edge_shift_px = 0.0;
  double lag_px = 0.0;
  std::vector<std::string> warnings;
};

// Returns the passages that a fit may use: those of single edges.
std::vector<EdgePassage> StepEdges(absl::Span<const EdgePassage> passages, const SensorCalibrationOptions& options);

// Returns the displacement of a passage's events along its motion that the profile predicts, pixels.
double ExpectedResidualPx(const SensorProfile& profile, const EdgePassage& passage);

// Fits the profile. Errors: INVALID_ARGUMENT for options; FAILED_PRECONDITION, naming the missing data, if the
// recordings do not determine the constants; INTERNAL if the solver fails. Times that they do not determine keep their
// initial values, with a warning.
absl::StatusOr<SensorCalibration> CalibrateSensor(absl::Span<const CalibrationRecording> recordings,
                                                  const SensorCalibrationOptions& options);

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// Fits a sensor's profile to the passages of edges at known poses (core/estimation/README.md, section 3).
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/calibration/edge_passages.h"
#include "core/estimation/sensor_profile.h"

namespace evpose {

struct SensorCalibrationOptions {
  // Where a constant that the recordings do not determine stays, and where the fit begins.
  SensorProfile initial;
  // |kappa| of a passage from which on it is that of one edge; a stripe's says nothing of the constants.
  double min_kappa = 0.9;
  // Lines in a direction, and their passages, that a fit needs: five constants, and a few lines of bad luck.
  int min_groups = 8;
  int min_passages = 100;
  // The 90th percentile of the speeds over the 10th from which on the latency can be told from the lag and
  // the refractory time from the threshold.
  double min_speed_ratio = 2.0;
  // Standard error, as a share of the constant, above which it is not determined.
  double max_relative_error = 0.25;

  absl::Status Validate() const;
};

// One recording's passages.
struct CalibrationRecording {
  std::string name;
  std::vector<EdgePassage> passages;
};

struct SensorCalibration {
  SensorProfile profile;
  // Standard errors; lines of a recording and direction are taken as the independent pieces, for a line's passages
  // share what the model does not know of it.
  double blur_error_px = 0.0;
  double contrast_threshold_error = 0.0;
  double latency_error_us = 0.0;
  double refractory_error_us = 0.0;
  bool are_times_fitted = true;  // latency and refractory time; else they stayed
  double pixel_noise_error_px = 0.0;

  int num_passages = 0;
  int num_groups = 0;  // lines of a recording in a direction
  double num_events = 0.0;
  double slowest_px_per_s = 0.0;  // 10th and 90th percentile of the speeds
  double fastest_px_per_s = 0.0;
  // Root mean square over the passages of where their events lie, and of what is left of it after the correction.
  double uncorrected_rms_px = 0.0;
  double initial_rms_px = 0.0;
  double fitted_rms_px = 0.0;
  // To the darker side and behind the motion, of an edge of the passages' median contrast and turns.
  double typical_contrast = 0.0;
  double edge_shift_px = 0.0;
  double lag_px = 0.0;
  std::vector<std::string> warnings;
};

// Passages that a fit may use: of single edges.
std::vector<EdgePassage> StepEdges(absl::Span<const EdgePassage> passages, const SensorCalibrationOptions& options);

// Where the profile expects a passage's events, along its motion, pixels.
double ExpectedResidualPx(const SensorProfile& profile, const EdgePassage& passage);

// Errors: INVALID_ARGUMENT for options; FAILED_PRECONDITION saying what is missing when the recordings do not determine
// the constants. Times that they do not determine stay and are warned of.
absl::StatusOr<SensorCalibration> CalibrateSensor(absl::Span<const CalibrationRecording> recordings,
                                                  const SensorCalibrationOptions& options);

}  // namespace evpose

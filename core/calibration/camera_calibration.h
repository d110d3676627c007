// SPDX-License-Identifier: Apache-2.0

// Calibrates a camera from recordings of a moving object with a known model, without known poses
// (core/calibration/README.md, sections 2 to 4).
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/calibration/camera_adjustment.h"
#include "core/calibration/tracked_recording.h"
#include "core/events/event.h"
#include "core/recordings/recording_reader.h"

namespace evpose {

// The defaults are validated by calibrate_test (CalibrateFindsTheCameraFromTheTargetAlone). tests/bench/
// self_calibration.py measured errors of at most 2.4 standard errors with three lenses. Two of them were measured
// before the prior and the penalty of the slope were added (core/calibration/README.md, section 4).
struct CameraCalibrationOptions {
  // First guess of the focal length, pixels; nullopt: several are tried on the first recording. Tracking tolerates a
  // guess that is 20 % off.
  std::optional<double> focal_px;
  LensModel lens_model = LensModel::kBrown;
  SensorProfile sensor;
  LineSampleOptions samples;
  AdjustmentOptions adjustment;
  int max_intervals = 300;  // TrackedRecordingOptions::max_intervals
  // Rounds of tracking, association and adjustment: three reach the result from a guess that is 20 % off.
  int max_rounds = 6;
  // The result is final when no parameter changes by more than this share of its standard error.
  double converged_ratio = 0.1;

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

struct CalibratedParameter {
  std::string name;
  double value = 0.0;
  double standard_error = 0.0;
  double bound = 0.0;     // the standard error if all errors were independent (Cramer and Rao)
  bool is_fitted = true;  // false: the data do not determine it, and it has its default
};

// Uncertainty of the projection of a direction, which the true and the estimated camera map to different pixels.
struct ProjectionUncertainty {
  std::string place;  // "centre", "left edge", "upper left corner"
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  double sigma_px = 0.0;            // one standard deviation, along the direction in which it is largest
  double half_difference_px = 0.0;  // between the results of two halves of the data
};

struct CoverageCell {
  int num_samples = 0;
  double rms_px = 0.0;
};
// Cells of the image in which samples are counted, nearly square for an image of 16:9. Smaller cells would have too few
// samples for a root mean square; larger ones would hide an uncovered border.
inline constexpr int kCoverageColumns = 16;
inline constexpr int kCoverageRows = 9;

struct CameraCalibration {
  CameraModel camera;
  std::vector<CalibratedParameter> parameters;
  std::vector<ProjectionUncertainty> uncertainties;
  std::array<std::array<CoverageCell, kCoverageColumns>, kCoverageRows> coverage = {};
  double rms_px = 0.0;
  int num_intervals = 0;
  int num_samples = 0;
  double num_events = 0.0;
  int num_rounds = 0;
  bool is_converged = false;
  std::vector<std::string> warnings;
};

// Opens a recording by its name. It is called for each pass over a recording.
using RecordingOpener = std::function<absl::StatusOr<std::unique_ptr<RecordingReader>>(const std::string& name)>;

// Called with the finished share, from 0 to 1, and what is being done.
using CalibrationProgress = std::function<void(double ratio, const std::string& step)>;

// `recordings` are names for `open`. Errors: INVALID_ARGUMENT for options; those of `open` and of
// RecordingReader::Read(); FAILED_PRECONDITION, stating what to record, if the object is not found or the data do not
// determine the focal length; INTERNAL if the solver fails.
absl::StatusOr<CameraCalibration> CalibrateCamera(absl::Span<const std::string> recordings, const RecordingOpener& open,
                                                  std::shared_ptr<const ObjectModel> model, SensorGeometry sensor,
                                                  const CameraCalibrationOptions& options,
                                                  const CalibrationProgress& on_progress);

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// Bundle adjustment of a camera and the poses of a known object to samples of its lines (core/calibration/README.md,
// section 3).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/calibration/line_samples.h"
#include "core/geometry/camera.h"

namespace evpose {

// Parameters of the adjustment: those of the camera, with the distortion coefficients in the order of the lens model,
// then those of the displacement of the events to the darker side of an edge: at rest, and its change with the speed.
enum CalibrationParameter {
  kFocal,   // fx, px
  kAspect,  // fy / fx
  kCentreX,
  kCentreY,
  kDistortion,                                // the first coefficient
  kEdgeShift = kDistortion + kMaxDistortion,  // px
  kEdgeShiftRate,                             // px at 1000 px/s
  kEdgeShiftDensity,                          // px for one event per px^2 more than kReferenceDensity
  kEdgeLag,                                   // px
  kEdgeLagDensity,                            // px for one event per px^2 more
  kNumCalibrationParameters
};

// Events per px^2 that an edge of ordinary contrast produces: kEdgeShift and kEdgeLag are those at this density.
inline constexpr double kReferenceDensity = 3.0;

struct CalibrationParameters {
  LensModel lens_model = LensModel::kBrown;
  std::array<double, kNumCalibrationParameters> values = {};

  double& operator[](int parameter) { return values[parameter]; }
  double operator[](int parameter) const { return values[parameter]; }
};
using CalibrationCovariance = Eigen::Matrix<double, kNumCalibrationParameters, kNumCalibrationParameters>;
using FreeParameters = std::array<bool, kNumCalibrationParameters>;

// "fx_px", ..., "edge_lag_density"; the coefficients as OpenCV calls them: k1 k2 p1 p2 k3 ..., of a fisheye lens k1 to
// k4.
std::string_view CalibrationParameterName(LensModel lens_model, int parameter);
// All parameters that the lens model has.
FreeParameters AllParameters(LensModel lens_model);

CalibrationParameters ParametersOf(const CameraModel& camera);
// Replaces the lens of `camera`; the size of the image stays.
void SetParameters(const CalibrationParameters& parameters, CameraModel& camera);

// Derivative of the pixel of a bearing (x, y, 1) with respect to the parameters.
Eigen::Matrix<double, 2, kNumCalibrationParameters> ProjectionJacobian(const CalibrationParameters& parameters,
                                                                       const Eigen::Vector2d& bearing);
// The pixel of a bearing.
Eigen::Vector2d ProjectBearing(const CalibrationParameters& parameters, const Eigen::Vector2d& bearing);

// Prior of the parameters, without data: independent values with one standard deviation each.
struct CalibrationPrior {
  CalibrationParameters mean;
  std::array<double, kNumCalibrationParameters> sigma = {};
  // AdjustmentErrors::dispersion: the prior counts as much more as samples overstate their information.
  double dispersion = 1.0;
};

// The defaults are validated by camera_adjustment_test: in samples with errors that are common for 0.5 s, the errors of
// the camera agree with its standard errors. robust_sigmas is not validated separately; tests/bench/self_calibration.py
// runs with it.
struct AdjustmentOptions {
  // Standard errors of a residual above which its weight is reduced (Huber): a normal residual is above in 5 % of the
  // cases. A larger limit gives samples of other edges more influence, a smaller one wastes right samples.
  double robust_sigmas = 2.0;
  int max_iterations = 30;  // bounds the time; the rounds repeat the adjustment in any case
  // Microseconds of a recording whose samples may have common errors, because they are of the same edges on the same
  // pixels: the time in which the object moves by its own size.
  int64_t block_us = 500'000;
  // Keeps parameters that the data hardly determine where they are known to be; nullopt: all values are as likely.
  std::optional<CalibrationPrior> prior;
  // Size of the image, in which the radial distortion has to increase; zero: it may have any form.
  int width_px = 0;
  int height_px = 0;
};

// Minimises equation (3) of the README over the free parameters and the poses of the intervals that have samples.
// Error: INTERNAL if the solver fails.
absl::Status AdjustCamera(absl::Span<const LineSample> samples, const FreeParameters& free,
                          const AdjustmentOptions& options, CalibrationParameters& parameters,
                          absl::Span<CalibrationInterval> intervals);

struct AdjustmentErrors {
  // Covariance by equation (6) of the README, or by (6a) if there are fewer than twice as many blocks as free
  // parameters; infinite for fewer than three blocks; zero for parameters that are not free.
  CalibrationCovariance covariance = CalibrationCovariance::Zero();
  // The same if the errors of samples were independent: the bound of Cramer and Rao.
  CalibrationCovariance bound = CalibrationCovariance::Zero();
  // Mean ratio of the variance of the blocks' gradients to that of independent samples, at least 1.
  double dispersion = 1.0;
  double rms_px = 0.0;  // of the residuals of the samples, those of reduced weight included in proportion
  int num_blocks = 0;
};
// Parts of the recordings, of `block_us`, that have samples.
int NumBlocks(absl::Span<const LineSample> samples, absl::Span<const CalibrationInterval> intervals, int64_t block_us);

// Errors of the result of AdjustCamera() with the same arguments.
AdjustmentErrors ComputeErrors(absl::Span<const LineSample> samples, const FreeParameters& free,
                               const AdjustmentOptions& options, const CalibrationParameters& parameters,
                               absl::Span<const CalibrationInterval> intervals);

// The distance of each sample from its line, across it, pixels.
std::vector<double> ResidualsPx(absl::Span<const LineSample> samples, const CalibrationParameters& parameters,
                                absl::Span<const CalibrationInterval> intervals);

// Multiplies the expected standard errors of samples of similar speed by the robust standard deviation of their
// residuals: slow edges have more noise among their events, and the sensor is not known.
void ScaleErrors(const CalibrationParameters& parameters, absl::Span<const CalibrationInterval> intervals,
                 absl::Span<LineSample> samples);

// Removes the samples of intervals that do not determine a pose: fewer than 12 samples, or fewer than three lines.
void RemoveWeakIntervals(std::vector<LineSample>& samples);

}  // namespace evpose

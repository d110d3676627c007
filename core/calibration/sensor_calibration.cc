// SPDX-License-Identifier: Apache-2.0
#include "core/calibration/sensor_calibration.h"

#include <ceres/ceres.h>

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <tuple>
#include <utility>

#include "absl/strings/str_format.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

// Internal unit of time, in which all constants are of the order of one.
constexpr double kTimeUnitUs = 100.0;
// Blur, contrast threshold, latency, refractory time. The two times are observable only if the speeds differ.
constexpr int kNumConstants = 4;
constexpr int kNumAtAnySpeed = 2;
// Bounds of the constants in these units. No sensor is near a bound of blur (px) or threshold (log), so that a fit that
// reaches one has wrong data.
constexpr double kLow[] = {0.05, 0.02, -100.0, 0.0};
constexpr double kHigh[] = {5.0, 2.0, 100.0, 50.0};
constexpr int kMaxIterations = 100;  // bounds the work of a fit that does not converge

struct WeightedPassage {
  EdgePassage passage;
  double sigma_px = 1.0;
  int group = 0;
};

// SensorProfile::uncertainty of a calibrated profile. The standard errors of the constants are smaller, but the model
// of the pixel holds to some hundredths of a pixel only (README, equation (9)): 0.3 of SystematicOptions::lag_px.
constexpr double kCalibratedUncertainty = 0.3;

SensorProfile WithConstants(SensorProfile profile, const double* constants) {
  profile.blur_px = constants[0];
  profile.contrast_threshold = constants[1];
  profile.latency_us = constants[2] * kTimeUnitUs;
  profile.refractory_us = constants[3] * kTimeUnitUs;
  return profile;
}

double Residual(const WeightedPassage& weighted, const double* constants) {
  const SensorProfile profile = WithConstants({}, constants);
  return (weighted.passage.residual_px - ExpectedResidualPx(profile, weighted.passage)) / weighted.sigma_px;
}

struct PassageCost {
  const WeightedPassage* weighted;
  bool operator()(const double* constants, double* residual) const {
    *residual = Residual(*weighted, constants);
    return true;
  }
};

using Constants = std::array<double, kNumConstants>;
using Covariance = Eigen::Matrix<double, kNumConstants, kNumConstants>;
using Row = Eigen::Matrix<double, kNumConstants, 1>;

// Minimises equation (9) of the README over the first constants; the others keep their initial values.
absl::StatusOr<Constants> Minimise(const std::vector<WeightedPassage>& passages,
                                   const SensorCalibrationOptions& calibration_options, int num_free) {
  const SensorProfile& initial = calibration_options.initial;
  Constants constants = {initial.blur_px, initial.contrast_threshold, initial.latency_us / kTimeUnitUs,
                         initial.refractory_us / kTimeUnitUs};
  ceres::Problem problem;
  for (const WeightedPassage& weighted : passages) {
    problem.AddResidualBlock(
        new ceres::NumericDiffCostFunction<PassageCost, ceres::CENTRAL, 1, kNumConstants>(new PassageCost{&weighted}),
        new ceres::HuberLoss(calibration_options.robust_sigmas), constants.data());
  }
  for (int i = 0; i < kNumConstants; ++i) {
    problem.SetParameterLowerBound(constants.data(), i, kLow[i]);
    problem.SetParameterUpperBound(constants.data(), i, kHigh[i]);
  }
  std::vector<int> fixed;
  for (int i = num_free; i < kNumConstants; ++i) fixed.push_back(i);
  if (!fixed.empty()) problem.SetManifold(constants.data(), new ceres::SubsetManifold(kNumConstants, fixed));
  ceres::Solver::Options options;
  options.logging_type = ceres::SILENT;
  options.max_num_iterations = kMaxIterations;
  options.num_threads = 1;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  if (!summary.IsSolutionUsable()) return absl::InternalError("the fit failed: " + summary.message);
  for (int i = 0; i < kNumAtAnySpeed; ++i) {
    if (constants[i] > kLow[i] * (1.0 + 1e-6) && constants[i] < kHigh[i] * (1.0 - 1e-6)) continue;
    return absl::FailedPreconditionError(
        "no sensor explains the residuals; check that the truth, its clock, the model and the camera belong to the "
        "recording");
  }
  return constants;
}

// Covariance of the constants from the curvature and from the scatter of the gradients of the groups, which are
// independent (sandwich estimator; Liang and Zeger 1986).
Covariance GroupedCovariance(const std::vector<WeightedPassage>& passages, const Constants& constants,
                             double robust_sigmas, int num_free, int num_groups) {
  Covariance curvature = Covariance::Zero();
  std::vector<Row> gradients(num_groups, Row::Zero());
  for (const WeightedPassage& weighted : passages) {
    const double residual = Residual(weighted, constants.data());
    const double weight = std::min(1.0, robust_sigmas / std::max(std::abs(residual), 1e-9));
    Row row = Row::Zero();
    for (int i = 0; i < num_free; ++i) {
      constexpr double kStep = 1e-3;  // of constants of the order of one
      Constants up = constants, down = constants;
      up[i] += kStep;
      down[i] -= kStep;
      row[i] = (Residual(weighted, up.data()) - Residual(weighted, down.data())) / (2.0 * kStep);
    }
    curvature += weight * row * row.transpose();
    gradients[weighted.group] += weight * residual * row;
  }
  for (int i = num_free; i < kNumConstants; ++i) curvature(i, i) = 1.0;
  Covariance scatter = Covariance::Zero();
  for (const Row& gradient : gradients) scatter += gradient * gradient.transpose();
  const Covariance inverse = curvature.inverse();
  // The factor matters with few groups: the gradients sum to zero at the minimum, which costs one degree of freedom per
  // constant.
  const double groups = num_groups;
  return groups / std::max(1.0, groups - kNumConstants) * inverse * scatter * inverse;
}

template <typename Value>
double QuantileOf(const std::vector<WeightedPassage>& passages, double ratio, Value value) {
  std::vector<double> values;
  for (const WeightedPassage& weighted : passages) values.push_back(value(weighted.passage));
  return UpperQuantile(values, ratio);
}

double RmsPx(const std::vector<WeightedPassage>& passages, const SensorProfile* profile) {
  double sum = 0.0;
  for (const WeightedPassage& weighted : passages) {
    const double expected = profile != nullptr ? ExpectedResidualPx(*profile, weighted.passage) : 0.0;
    sum += (weighted.passage.residual_px - expected) * (weighted.passage.residual_px - expected);
  }
  return std::sqrt(sum / static_cast<double>(passages.size()));
}

std::vector<WeightedPassage> Gather(absl::Span<const CalibrationRecording> recordings,
                                    const SensorCalibrationOptions& options, int& num_groups) {
  std::vector<WeightedPassage> gathered;
  std::map<std::tuple<size_t, int, bool>, int> groups;
  for (size_t r = 0; r < recordings.size(); ++r) {
    for (const EdgePassage& passage : StepEdges(recordings[r].passages, options)) {
      const auto key = std::make_tuple(r, passage.model_line, passage.direction > 0.0);
      const int group = groups.emplace(key, static_cast<int>(groups.size())).first->second;
      const double counted =
          passage.spread_px * passage.spread_px * options.events_per_information / passage.num_events;
      gathered.push_back({passage, std::sqrt(counted + options.model_error_px * options.model_error_px), group});
    }
  }
  num_groups = static_cast<int>(groups.size());
  return gathered;
}

// Computes the standard deviation of the events about the mean of their passage, and its standard error over the
// groups.
void FitPixelNoise(const std::vector<WeightedPassage>& passages, SensorCalibration& calibration) {
  std::vector<double> squares(calibration.num_groups, 0.0), events(calibration.num_groups, 0.0);
  double all_squares = 0.0, all_events = 0.0;
  for (const auto& [passage, sigma_px, group] : passages) {
    squares[group] += passage.num_events * passage.spread_px * passage.spread_px;
    events[group] += passage.num_events;
    all_squares += passage.num_events * passage.spread_px * passage.spread_px;
    all_events += passage.num_events;
  }
  const double variance = all_squares / all_events;
  double scatter = 0.0;
  for (size_t g = 0; g < squares.size(); ++g) {
    const double off = (squares[g] - variance * events[g]) / all_events;
    scatter += off * off;
  }
  calibration.profile.pixel_noise_px = std::sqrt(variance);
  calibration.pixel_noise_error_px = 0.5 * std::sqrt(scatter / variance);
}

void DescribeTypicalEdge(const std::vector<WeightedPassage>& passages, SensorCalibration& calibration) {
  const SensorProfile& profile = calibration.profile;
  EdgeRates typical;
  typical.events_per_px2 = QuantileOf(passages, 0.5, [](const EdgePassage& p) { return p.rates.events_per_px2; });
  typical.reversals_per_px2 = QuantileOf(passages, 0.5, [](const EdgePassage& p) { return p.rates.reversals_per_px2; });
  typical.recent_reversals_per_px2 = typical.reversals_per_px2;
  typical.kappa = 1.0;
  const EdgeOffsets offsets = ExpectedEdgeOffsets(profile, typical);
  const double brighter = offsets.along_px;
  const double darker = -offsets.against_px;
  calibration.typical_contrast = profile.contrast_threshold * (typical.events_per_px2 + typical.reversals_per_px2);
  calibration.edge_shift_px = 0.5 * (brighter - darker);
  calibration.lag_px = -0.5 * (brighter + darker);
}

absl::Status CheckEnough(const std::vector<WeightedPassage>& passages, int num_groups,
                         const SensorCalibrationOptions& options) {
  if (static_cast<int>(passages.size()) >= options.min_passages && num_groups >= options.min_groups) {
    return absl::OkStatus();
  }
  return absl::FailedPreconditionError(absl::StrFormat(
      "too little data to fit a sensor profile: %d passages of %d pairs of an edge and a direction; needed are %d of "
      "%d. "
      "A passage is a motion of an edge across itself by some pixels, in view and at least %.0f px away from other "
      "edges; record more motion, in both directions, and nearer to the camera",
      passages.size(), num_groups, options.min_passages, options.min_groups, kAlonePx));
}

absl::Status CheckDetermined(const char* field, double value, double error, const SensorCalibrationOptions& options) {
  if (error <= options.max_relative_error * value) return absl::OkStatus();  // false for NaN
  return absl::FailedPreconditionError(
      absl::StrFormat("the recordings do not determine %s: %.3g +- %.2g; record edges of several contrasts that move "
                      "in both directions",
                      field, value, error));
}

// Fits the constants, with their standard errors, to the profile of `result`.
absl::Status FitConstants(const std::vector<WeightedPassage>& passages, const SensorCalibrationOptions& options,
                          bool has_speeds, SensorCalibration& result) {
  // With tracked poses, the fitted latency contains only the part of the common delay that the tracker's profile does
  // not correct.
  int num_free = !has_speeds                                 ? kNumAtAnySpeed
                 : result.fitted_times == FittedTimes::kBoth ? kNumConstants
                                                             : kNumAtAnySpeed + 1;
  EVPOSE_ASSIGN_OR_RETURN(Constants constants, Minimise(passages, options, num_free));
  Covariance covariance = GroupedCovariance(passages, constants, options.robust_sigmas, num_free, result.num_groups);
  if (result.fitted_times == FittedTimes::kBoth) {
    const double error_us = std::sqrt(covariance(3, 3)) * kTimeUnitUs;
    // A time near zero is determined by an error that is small against the initial value.
    const double value_us = std::max(constants[3] * kTimeUnitUs, options.initial.refractory_us);
    if (!(error_us <= options.max_relative_error * value_us)) {  // also for NaN
      result.warnings.push_back(
          absl::StrFormat("refractory_us stays at %g: the recordings do not determine it, %.3g +- %.2g; record fast "
                          "motion of strong edges",
                          options.initial.refractory_us, constants[3] * kTimeUnitUs, error_us));
      result.fitted_times = FittedTimes::kLatency;
      num_free = kNumAtAnySpeed + 1;
      EVPOSE_ASSIGN_OR_RETURN(constants, Minimise(passages, options, num_free));
      covariance = GroupedCovariance(passages, constants, options.robust_sigmas, num_free, result.num_groups);
    }
  }
  result.profile = WithConstants(options.initial, constants.data());
  const bool is_latency_fitted = result.fitted_times != FittedTimes::kNone;
  const bool is_refractory_fitted = result.fitted_times == FittedTimes::kBoth;
  if (!is_latency_fitted) result.profile.latency_us = options.initial.latency_us;
  if (!is_refractory_fitted) result.profile.refractory_us = options.initial.refractory_us;
  result.profile.uncertainty = kCalibratedUncertainty;
  result.blur_error_px = std::sqrt(covariance(0, 0));
  result.contrast_threshold_error = std::sqrt(covariance(1, 1));
  if (is_latency_fitted) result.latency_error_us = std::sqrt(covariance(2, 2)) * kTimeUnitUs;
  if (is_refractory_fitted) result.refractory_error_us = std::sqrt(covariance(3, 3)) * kTimeUnitUs;
  EVPOSE_RETURN_IF_ERROR(CheckDetermined("blur_px", constants[0], result.blur_error_px, options));
  return CheckDetermined("contrast_threshold", constants[1], result.contrast_threshold_error, options);
}

}  // namespace

absl::Status SensorCalibrationOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(initial.Validate());
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorCalibrationOptions.min_kappa", min_kappa, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorCalibrationOptions.min_groups", min_groups, kNumConstants + 1, 1e6));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorCalibrationOptions.min_passages", min_passages, kNumConstants + 1, 1e6));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorCalibrationOptions.min_speed_ratio", min_speed_ratio, 1.0, 1e3));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorCalibrationOptions.max_relative_error", max_relative_error, 0.0, 10.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorCalibrationOptions.model_error_px", model_error_px, 1e-4, 10.0));
  EVPOSE_RETURN_IF_ERROR(
      CheckRange("SensorCalibrationOptions.events_per_information", events_per_information, 1.0, 1e4));
  return CheckRange("SensorCalibrationOptions.robust_sigmas", robust_sigmas, 0.1, 100.0);
}

std::vector<EdgePassage> StepEdges(absl::Span<const EdgePassage> passages, const SensorCalibrationOptions& options) {
  std::vector<EdgePassage> edges;
  for (const EdgePassage& passage : passages) {
    if (std::abs(passage.rates.kappa) >= options.min_kappa) edges.push_back(passage);
  }
  return edges;
}

double ExpectedResidualPx(const SensorProfile& profile, const EdgePassage& passage) {
  EdgeRates rates = passage.rates;
  rates.events_per_px2 /= LiveAreaPx2(profile, 1.0, rates.events_per_px2, passage.speed_px_per_s);
  return passage.direction * ExpectedEdgeOffsets(profile, rates).At(passage.direction) -
         1e-6 * profile.latency_us * passage.speed_px_per_s;
}

absl::StatusOr<SensorCalibration> CalibrateSensor(absl::Span<const CalibrationRecording> recordings,
                                                  const SensorCalibrationOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  SensorCalibration result;
  const std::vector<WeightedPassage> passages = Gather(recordings, options, result.num_groups);
  EVPOSE_RETURN_IF_ERROR(CheckEnough(passages, result.num_groups, options));
  result.num_passages = static_cast<int>(passages.size());
  for (const WeightedPassage& weighted : passages) result.num_events += weighted.passage.num_events;
  const auto speed = [](const EdgePassage& passage) { return passage.speed_px_per_s; };
  result.slowest_px_per_s = QuantileOf(passages, 0.1, speed);
  result.fastest_px_per_s = QuantileOf(passages, 0.9, speed);

  const bool has_speeds = result.fastest_px_per_s >= options.min_speed_ratio * result.slowest_px_per_s;
  if (has_speeds && options.has_independent_poses) result.fitted_times = FittedTimes::kBoth;
  if (!options.has_independent_poses) {
    result.warnings.push_back(
        absl::StrFormat("latency_us stays at %g and refractory_us at %g: poses that were tracked in the same events "
                        "follow their delay; "
                        "only poses of another source determine it (--truth)",
                        options.initial.latency_us, options.initial.refractory_us));
  } else if (!has_speeds) {
    result.warnings.push_back(
        absl::StrFormat("latency_us stays at %g: most speeds are nearly equal, %.0f to %.0f px/s, so that the latency "
                        "cannot be distinguished from the lag; record slow and fast motion",
                        options.initial.latency_us, result.slowest_px_per_s, result.fastest_px_per_s));
  }
  EVPOSE_RETURN_IF_ERROR(FitConstants(passages, options, has_speeds, result));
  FitPixelNoise(passages, result);
  result.uncorrected_rms_px = RmsPx(passages, nullptr);
  result.initial_rms_px = RmsPx(passages, &options.initial);
  result.fitted_rms_px = RmsPx(passages, &result.profile);
  DescribeTypicalEdge(passages, result);
  EVPOSE_RETURN_IF_ERROR(result.profile.Validate());
  return result;
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/calibration/camera_adjustment.h"

#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <map>
#include <set>
#include <utility>

namespace evpose {
namespace {

constexpr int kNumPose = 6;
constexpr double kFewestBlocks = 3.0;  // for a standard error
constexpr double kSpeedUnit = 1e-3;    // of kEdgeShiftRate

// The distorted point of (x, y), the map of core/geometry/lens_models.h; `d` are the coefficients.
template <typename T>
Eigen::Matrix<T, 2, 1> DistortPoint(LensModel lens_model, const T* d, const T& x, const T& y) {
  using std::atan;
  using std::sqrt;
  const T r2 = x * x + y * y;
  if (lens_model == LensModel::kFisheye) {
    if (r2 < 1e-16) return {x, y};
    const T r = sqrt(r2), angle = atan(r), a2 = angle * angle;
    const T scale = angle * (1.0 + a2 * (d[0] + a2 * (d[1] + a2 * (d[2] + a2 * d[3])))) / r;
    return {scale * x, scale * y};
  }
  T radial = 1.0 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]));
  if (lens_model == LensModel::kRational) radial /= 1.0 + r2 * (d[5] + r2 * (d[6] + r2 * d[7]));
  return {x * radial + 2.0 * d[2] * x * y + d[3] * (r2 + 2.0 * x * x),
          y * radial + d[2] * (r2 + 2.0 * y * y) + 2.0 * d[3] * x * y};
}

// The pixel of the bearing (x, y, 1).
template <typename T>
Eigen::Matrix<T, 2, 1> ProjectWith(LensModel lens_model, const T* parameters, const T& x, const T& y) {
  const Eigen::Matrix<T, 2, 1> point = DistortPoint(lens_model, parameters + kDistortion, x, y);
  return {parameters[kFocal] * point.x() + parameters[kCentreX],
          parameters[kFocal] * parameters[kAspect] * point.y() + parameters[kCentreY]};
}

// Equation (2) of the README; `change` is a tangent [translation, rotation] at the pose.
struct SampleCost {
  LensModel lens_model;
  const LineSample* sample;
  Eigen::Vector3d rotated;  // R X
  Eigen::Vector3d translation;

  template <typename T>
  bool operator()(const T* parameters, const T* change, T* residual) const {
    const T rotated_object[3] = {T(rotated.x()), T(rotated.y()), T(rotated.z())};
    T point[3];
    ceres::AngleAxisRotatePoint(change + 3, rotated_object, point);
    for (int i = 0; i < 3; ++i) point[i] += translation[i] + change[i];
    if (point[2] < 1e-6) return false;
    const Eigen::Matrix<T, 2, 1> pixel =
        ProjectWith(lens_model, parameters, T(point[0] / point[2]), T(point[1] / point[2]));
    const double density = sample->events_per_px2 - kReferenceDensity;
    const T shift = parameters[kEdgeShift] + kSpeedUnit * sample->speed_px_per_s * parameters[kEdgeShiftRate] +
                    density * parameters[kEdgeShiftDensity];
    const T lag = parameters[kEdgeLag] + density * parameters[kEdgeLagDensity];
    *residual =
        (sample->normal.x() * (pixel.x() - sample->pixel.x()) + sample->normal.y() * (pixel.y() - sample->pixel.y()) +
         sample->dark_side * shift - sample->motion * lag) /
        sample->sigma_px;
    return true;
  }
};

// The distances of the parameters from their prior, in its standard deviations; zero for those that are not free.
struct PriorCost {
  const CalibrationPrior* prior;
  FreeParameters free;

  template <typename T>
  bool operator()(const T* parameters, T* residuals) const {
    for (int i = 0; i < kNumCalibrationParameters; ++i) {
      residuals[i] =
          free[i] ? std::sqrt(prior->dispersion) * (parameters[i] - prior->mean[i]) / prior->sigma[i] : T(0.0);
    }
    return true;
  }
};

// Derivative of the distorted radius by the undistorted one; of a fisheye lens, by the angle to the axis.
template <typename T>
T RadialSlope(LensModel lens_model, const T* d, double at) {
  const double s = at * at;
  if (lens_model == LensModel::kFisheye) {
    return 1.0 + s * (3.0 * d[0] + s * (5.0 * d[1] + s * (7.0 * d[2] + s * 9.0 * d[3])));
  }
  const T above = 1.0 + s * (d[0] + s * (d[1] + s * d[4]));
  const T above_slope = 2.0 * s * (d[0] + s * (2.0 * d[1] + s * 3.0 * d[4]));
  if (lens_model != LensModel::kRational) return above + above_slope;
  const T below = 1.0 + s * (d[5] + s * (d[6] + s * d[7]));
  const T below_slope = 2.0 * s * (d[5] + s * (2.0 * d[6] + s * 3.0 * d[7]));
  return (above + above_slope - above * below_slope / below) / below;
}

// Least derivative of the distorted radius (README, section 4), and the number of radii up to the farthest corner at
// which it is tested.
constexpr double kMinRadialSlope = 0.1;
constexpr int kSlopeRadii = 12;

// Penalty for radial distortion that hardly increases: parts of the image without samples would have a lens that maps
// two directions to one pixel.
struct SlopeCost {
  LensModel lens_model;
  std::array<double, kSlopeRadii> radii;

  template <typename T>
  bool operator()(const T* parameters, T* residuals) const {
    constexpr double kSigma = 0.001;  // a hundredth of the least slope, so that the penalty acts as a bound
    for (int i = 0; i < kSlopeRadii; ++i) {
      const T missing = kMinRadialSlope - RadialSlope(lens_model, parameters + kDistortion, radii[i]);
      residuals[i] = missing > 0.0 ? missing / kSigma : T(0.0);
    }
    return true;
  }
};

// Radii, or angles, up to that of the corner that is farthest from the centre.
std::array<double, kSlopeRadii> RadiiOfImage(const CalibrationParameters& parameters,
                                             const AdjustmentOptions& options) {
  constexpr double kStep = 0.005, kMaxAngle = 1.5, kMaxRadius = 8.0;  // to 86 and 83 degrees off the axis
  double corner = 0.0;
  for (const double x : {0.0, options.width_px - 1.0}) {
    for (const double y : {0.0, options.height_px - 1.0}) {
      corner = std::max(corner, std::hypot((x - parameters[kCentreX]) / parameters[kFocal],
                                           (y - parameters[kCentreY]) / (parameters[kFocal] * parameters[kAspect])));
    }
  }
  const double limit = parameters.lens_model == LensModel::kFisheye ? kMaxAngle : kMaxRadius;
  double distorted = 0.0, at = 0.0;
  for (; distorted < corner && at < limit; at += kStep) {
    const double slope = RadialSlope(parameters.lens_model, parameters.values.data() + kDistortion, at);
    distorted += kStep * std::max(slope, kMinRadialSlope);
  }
  std::array<double, kSlopeRadii> radii;
  for (int i = 0; i < kSlopeRadii; ++i) radii[i] = at * (i + 1) / kSlopeRadii;
  return radii;
}

using BlockKey = std::pair<int, int64_t>;

BlockKey BlockOf(const CalibrationInterval& interval, int64_t block_us) {
  return {interval.recording, interval.t_us / block_us};
}

SampleCost CostOf(LensModel lens_model, const LineSample& sample, const RigidTransform& pose) {
  return {lens_model, &sample, pose.rotation * sample.point, pose.translation_m};
}

struct SampleRow {
  double residual = 0.0;
  double weight = 1.0;  // Huber's
  Eigen::Matrix<double, kNumCalibrationParameters, 1> parameters;
  Vector6d pose;
};

SampleRow RowOf(const LineSample& sample, const RigidTransform& pose, const CalibrationParameters& parameters,
                double robust_sigmas) {
  using Jet = ceres::Jet<double, kNumCalibrationParameters + kNumPose>;
  Jet at[kNumCalibrationParameters], change[kNumPose], residual;
  for (int i = 0; i < kNumCalibrationParameters; ++i) at[i] = Jet(parameters[i], i);
  for (int i = 0; i < kNumPose; ++i) change[i] = Jet(0.0, kNumCalibrationParameters + i);
  SampleRow row;
  if (!CostOf(parameters.lens_model, sample, pose)(at, change, &residual)) {
    row.weight = 0.0;
    row.parameters.setZero();
    row.pose.setZero();
    return row;
  }
  row.residual = residual.a;
  row.weight = std::min(1.0, robust_sigmas / std::max(std::abs(residual.a), 1e-12));
  row.parameters = residual.v.head<kNumCalibrationParameters>();
  row.pose = residual.v.tail<kNumPose>();
  return row;
}

// The inverse of the rows and columns of free parameters; zero elsewhere.
CalibrationCovariance InverseOfFree(CalibrationCovariance matrix, const FreeParameters& free) {
  for (int i = 0; i < kNumCalibrationParameters; ++i) {
    if (free[i]) continue;
    matrix.row(i).setZero();
    matrix.col(i).setZero();
    matrix(i, i) = 1.0;
  }
  CalibrationCovariance inverse = matrix.ldlt().solve(CalibrationCovariance::Identity());
  for (int i = 0; i < kNumCalibrationParameters; ++i) {
    if (!free[i]) inverse(i, i) = 0.0;
  }
  return inverse;
}

// Equations (6) and (6a): `curvature` is A, and `scatter` the sum over errors.num_blocks blocks.
void SetCovariance(const FreeParameters& free, const std::optional<CalibrationPrior>& prior,
                   const CalibrationCovariance& curvature, const CalibrationCovariance& scatter,
                   AdjustmentErrors& errors) {
  CalibrationCovariance of_prior = CalibrationCovariance::Zero();
  int num_free = 0;
  for (int i = 0; i < kNumCalibrationParameters; ++i) {
    num_free += free[i];
    if (free[i] && prior) of_prior(i, i) = prior->dispersion / std::pow(prior->sigma[i], 2);
  }
  const double blocks = errors.num_blocks;
  if (blocks < kFewestBlocks || num_free == 0) {
    if (num_free > 0) errors.covariance.setConstant(std::numeric_limits<double>::infinity());
    return;
  }
  const CalibrationCovariance inverse = InverseOfFree(curvature + of_prior, free);
  errors.bound = inverse;
  errors.dispersion =
      std::max(1.0, blocks / (blocks - 1.0) * (inverse * scatter).trace() / (inverse * curvature).trace());
  if (blocks < 2.0 * num_free) {
    errors.covariance = errors.dispersion * inverse;
  } else {
    const CalibrationCovariance middle = blocks / (blocks - num_free) * scatter + errors.dispersion * of_prior;
    errors.covariance = inverse * middle * inverse;
  }
}

}  // namespace

std::string_view CalibrationParameterName(LensModel lens_model, int parameter) {
  constexpr std::string_view kNames[] = {"fx_px",
                                         "fy_fx",
                                         "cx_px",
                                         "cy_px",
                                         "k1",
                                         "k2",
                                         "p1",
                                         "p2",
                                         "k3",
                                         "k4",
                                         "k5",
                                         "k6",
                                         "edge_shift_px",
                                         "edge_shift_rate",
                                         "edge_shift_density",
                                         "edge_lag_px",
                                         "edge_lag_density"};
  static_assert(std::size(kNames) == kNumCalibrationParameters);
  constexpr std::string_view kFisheyeNames[] = {"k1", "k2", "k3", "k4"};
  const int coefficient = parameter - kDistortion;
  const bool is_fisheye = lens_model == LensModel::kFisheye && coefficient >= 0 && coefficient < 4;
  return is_fisheye ? kFisheyeNames[coefficient] : kNames[parameter];
}

FreeParameters AllParameters(LensModel lens_model) {
  FreeParameters all;
  all.fill(true);
  for (int i = NumCoefficients(lens_model); i < kMaxDistortion; ++i) all[kDistortion + i] = false;
  return all;
}

CalibrationParameters ParametersOf(const CameraModel& camera) {
  CalibrationParameters parameters{camera.lens_model};
  parameters[kFocal] = camera.fx_px;
  parameters[kAspect] = camera.fy_px / camera.fx_px;
  parameters[kCentreX] = camera.cx_px;
  parameters[kCentreY] = camera.cy_px;
  for (int i = 0; i < kMaxDistortion; ++i) parameters[kDistortion + i] = camera.distortion[i];
  return parameters;
}

void SetParameters(const CalibrationParameters& parameters, CameraModel& camera) {
  camera.lens_model = parameters.lens_model;
  camera.fx_px = parameters[kFocal];
  camera.fy_px = parameters[kFocal] * parameters[kAspect];
  camera.cx_px = parameters[kCentreX];
  camera.cy_px = parameters[kCentreY];
  for (int i = 0; i < kMaxDistortion; ++i) camera.distortion[i] = parameters[kDistortion + i];
}

Eigen::Vector2d ProjectBearing(const CalibrationParameters& parameters, const Eigen::Vector2d& bearing) {
  return ProjectWith(parameters.lens_model, parameters.values.data(), bearing.x(), bearing.y());
}

Eigen::Matrix<double, 2, kNumCalibrationParameters> ProjectionJacobian(const CalibrationParameters& parameters,
                                                                       const Eigen::Vector2d& bearing) {
  using Jet = ceres::Jet<double, kNumCalibrationParameters>;
  Jet at[kNumCalibrationParameters];
  for (int i = 0; i < kNumCalibrationParameters; ++i) at[i] = Jet(parameters[i], i);
  const Eigen::Matrix<Jet, 2, 1> pixel = ProjectWith(parameters.lens_model, at, Jet(bearing.x()), Jet(bearing.y()));
  Eigen::Matrix<double, 2, kNumCalibrationParameters> jacobian;
  jacobian << pixel.x().v.transpose(), pixel.y().v.transpose();
  return jacobian;
}

void RemoveWeakIntervals(std::vector<LineSample>& samples) {
  // Twice the six unknowns of a pose, which three lines determine.
  constexpr size_t kMinSamples = 12, kMinLines = 3;
  std::map<int, std::pair<size_t, std::set<int>>> intervals;
  for (const LineSample& sample : samples) {
    auto& [count, lines] = intervals[sample.interval];
    ++count;
    lines.insert(sample.line);
  }
  std::erase_if(samples, [&](const LineSample& sample) {
    const auto& [count, lines] = intervals[sample.interval];
    return count < kMinSamples || lines.size() < kMinLines;
  });
}

absl::Status AdjustCamera(absl::Span<const LineSample> samples, const FreeParameters& free,
                          const AdjustmentOptions& adjustment_options, CalibrationParameters& parameters,
                          absl::Span<CalibrationInterval> intervals) {
  std::vector<std::array<double, kNumPose>> changes(intervals.size(), std::array<double, kNumPose>{});
  ceres::Problem problem;
  auto* order = new ceres::ParameterBlockOrdering;
  for (const LineSample& sample : samples) {
    using Cost = ceres::AutoDiffCostFunction<SampleCost, 1, kNumCalibrationParameters, kNumPose>;
    double* change = changes[sample.interval].data();
    problem.AddResidualBlock(
        new Cost(new SampleCost(CostOf(parameters.lens_model, sample, intervals[sample.interval].camera_from_object))),
        new ceres::HuberLoss(adjustment_options.robust_sigmas), parameters.values.data(), change);
    order->AddElementToGroup(change, 0);
  }
  order->AddElementToGroup(parameters.values.data(), 1);
  if (adjustment_options.prior) {
    using Cost = ceres::AutoDiffCostFunction<PriorCost, kNumCalibrationParameters, kNumCalibrationParameters>;
    problem.AddResidualBlock(new Cost(new PriorCost{&*adjustment_options.prior, free}), nullptr,
                             parameters.values.data());
  }
  if (adjustment_options.width_px > 0) {
    using Cost = ceres::AutoDiffCostFunction<SlopeCost, kSlopeRadii, kNumCalibrationParameters>;
    const auto radii = RadiiOfImage(parameters, adjustment_options);
    problem.AddResidualBlock(new Cost(new SlopeCost{parameters.lens_model, radii}), nullptr, parameters.values.data());
  }
  std::vector<int> fixed;
  for (int i = 0; i < kNumCalibrationParameters; ++i) {
    if (!free[i]) fixed.push_back(i);
  }
  if (!fixed.empty()) {
    problem.SetManifold(parameters.values.data(), new ceres::SubsetManifold(kNumCalibrationParameters, fixed));
  }
  ceres::Solver::Options options;
  options.logging_type = ceres::SILENT;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.linear_solver_ordering.reset(order);
  options.max_num_iterations = adjustment_options.max_iterations;
  options.function_tolerance = 1e-7;  // far below a tenth of a standard error
  options.num_threads = 1;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  if (!summary.IsSolutionUsable()) return absl::InternalError("the bundle adjustment failed: " + summary.message);
  for (size_t i = 0; i < intervals.size(); ++i) {
    RigidTransform& pose = intervals[i].camera_from_object;
    const std::array<double, kNumPose>& change = changes[i];
    pose = Perturb(pose, Vector6d(change.data()));
  }
  return absl::OkStatus();
}

int NumBlocks(absl::Span<const LineSample> samples, absl::Span<const CalibrationInterval> intervals, int64_t block_us) {
  std::set<BlockKey> blocks;
  for (const LineSample& sample : samples) blocks.insert(BlockOf(intervals[sample.interval], block_us));
  return static_cast<int>(blocks.size());
}

AdjustmentErrors ComputeErrors(absl::Span<const LineSample> samples, const FreeParameters& free,
                               const AdjustmentOptions& options, const CalibrationParameters& parameters,
                               absl::Span<const CalibrationInterval> intervals) {
  using Vector = Eigen::Matrix<double, kNumCalibrationParameters, 1>;
  AdjustmentErrors errors;
  CalibrationCovariance curvature = CalibrationCovariance::Zero();
  std::map<BlockKey, Vector> gradients;
  double weights = 0.0, squares = 0.0;
  // Samples are in the order of their intervals.
  for (size_t begin = 0; begin < samples.size();) {
    size_t end = begin;
    const CalibrationInterval& interval = intervals[samples[begin].interval];
    std::vector<SampleRow> rows;
    Matrix6d of_pose = Matrix6d::Zero();
    Eigen::Matrix<double, kNumPose, kNumCalibrationParameters> mixed;
    mixed.setZero();
    for (; end < samples.size() && samples[end].interval == samples[begin].interval; ++end) {
      SampleRow row = RowOf(samples[end], interval.camera_from_object, parameters, options.robust_sigmas);
      for (int i = 0; i < kNumCalibrationParameters; ++i) {
        if (!free[i]) row.parameters[i] = 0.0;
      }
      of_pose += row.weight * row.pose * row.pose.transpose();
      mixed += row.weight * row.pose * row.parameters.transpose();
      weights += row.weight;
      squares += row.weight * std::pow(row.residual * samples[end].sigma_px, 2);
      rows.push_back(row);
    }
    const Eigen::Matrix<double, kNumPose, kNumCalibrationParameters> eliminated = of_pose.ldlt().solve(mixed);
    auto [gradient, is_new] = gradients.try_emplace(BlockOf(interval, options.block_us), Vector::Zero());
    for (const SampleRow& row : rows) {
      const Vector reduced = row.parameters - eliminated.transpose() * row.pose;
      curvature += row.weight * reduced * reduced.transpose();
      gradient->second += row.weight * row.residual * reduced;
    }
    begin = end;
  }
  errors.rms_px = std::sqrt(squares / std::max(weights, 1e-12));
  errors.num_blocks = static_cast<int>(gradients.size());
  CalibrationCovariance scatter = CalibrationCovariance::Zero();
  for (const auto& [block, gradient] : gradients) scatter += gradient * gradient.transpose();
  SetCovariance(free, options.prior, curvature, scatter, errors);
  return errors;
}

std::vector<double> ResidualsPx(absl::Span<const LineSample> samples, const CalibrationParameters& parameters,
                                absl::Span<const CalibrationInterval> intervals) {
  std::vector<double> residuals;
  const Vector6d no_change = Vector6d::Zero();
  for (const LineSample& sample : samples) {
    double residual = 0.0;
    CostOf(parameters.lens_model, sample, intervals[sample.interval].camera_from_object)(parameters.values.data(),
                                                                                         no_change.data(), &residual);
    residuals.push_back(residual * sample.sigma_px);
  }
  return residuals;
}

void ScaleErrors(const CalibrationParameters& parameters, absl::Span<const CalibrationInterval> intervals,
                 absl::Span<LineSample> samples) {
  // Classes of speed (README, section 3); the scale of 50 residuals is known to about a tenth.
  constexpr size_t kBins = 12, kMinInBin = 50;
  const std::vector<double> residuals_px = ResidualsPx(samples, parameters, intervals);
  std::vector<size_t> order(samples.size());
  for (size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::stable_sort(order.begin(), order.end(),
                   [&](size_t a, size_t b) { return samples[a].speed_px_per_s < samples[b].speed_px_per_s; });
  const size_t bins = std::clamp<size_t>(order.size() / kMinInBin, 1, kBins);
  for (size_t bin = 0; bin < bins; ++bin) {
    const size_t begin = bin * order.size() / bins, end = (bin + 1) * order.size() / bins;
    std::vector<double> relative;
    for (size_t i = begin; i < end; ++i) relative.push_back(residuals_px[order[i]] / samples[order[i]].sigma_px);
    // Residuals of zero, as of made samples without noise, have no scale.
    constexpr double kMinScale = 1e-3;
    const double scale = std::max(kMinScale, MadScale(relative));
    for (size_t i = begin; i < end; ++i) samples[order[i]].sigma_px *= scale;
  }
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/calibration/hand_eye.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/calibration/hand_eye_problem.h"
#include "core/calibration/time_offset.h"
#include "core/numerics/math.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// 95 % of the squared, normalised residuals of six numbers are below: larger ones lose weight (Cauchy).
constexpr double kCauchy2 = 12.6;
// Probability 3e-7, five standard deviations of one number.
constexpr double kOutlier2 = 41.0;
constexpr double kMedianOfNorm3 = 1.538;  // of the norm of three standard normal numbers
// Scale of residuals, metres and radians: no camera and no robot is more exact, nor is the interpolation between
// samples.
constexpr double kLeastScale = 5e-5;
// Bounds of the iterations. The scales of the residuals and the fit depend on each other, and a fit that has converged
// ends before its bound. The correlation of the speeds may have its highest maximum at a wrong offset, so that the
// highest three are tried (README, section 7).
constexpr int kScaleUpdates = 4;
constexpr int kIterations = 30;
constexpr int kOffsetCandidates = 3;
// Damping of Levenberg and Marquardt's iteration, relative to the diagonal of the equations: at first and its bounds.
// It changes by the factor 10; above the upper bound a step no longer changes the cost.
constexpr double kFirstDamping = 1e-4, kLeastDamping = 1e-9, kLargestDamping = 1e8, kDampingFactor = 10.0;
// A fit has converged when a step decreases its cost by less than this share of the cost.
constexpr double kConverged = 1e-10;
// Autocorrelation below which residuals count as uncorrelated (README, section 7).
constexpr double kUncorrelated = 0.1;
// Standard errors above it, metres and radians, are reported: such a transform misses the object by centimetres.
constexpr double kLargeError = 0.05;
// Outliers are reported if they are more than one in this number of poses. By chance there are 3e-7 (kOutlier2).
constexpr int kPosesPerOutlier = 20;
// Residuals above this share of the motion do not explain it; motions below these (metres, radians) may be noise.
constexpr double kUnexplained = 0.5;
constexpr double kLeastMotionM = 0.01, kLeastMotionRad = 0.02;
// Factors of the reference's translations beyond it, or below its inverse, are another unit and no wrong model.
constexpr double kOtherUnit = 2.0;
// Two fits have the same offset if their offsets differ by less than this, seconds. It is half of the interval over
// which time_offset.cc measures the motion.
constexpr double kSameOffsetS = 0.05;
// Another offset or mount whose residuals are not larger by this factor is reported.
constexpr double kClearRatio = 1.5;

// The fit from one start.
struct HandEyeFit {
  HandEyeState state;
  HandEyeMount mount = HandEyeMount::kBeside;
  double position_scale_m = 1.0;
  double rotation_scale_rad = 1.0;
  std::vector<HandEyePair> pairs;

  // Comparable among fits of the same poses.
  double LogScale() const { return 0.5 * (std::log(position_scale_m) + std::log(rotation_scale_rad)); }
};

// The parameters that are estimated.
struct HandEyeFree {
  bool has_transforms = true;
  bool has_offset = true;

  bool Has(int parameter) const { return parameter < 12 ? has_transforms : has_offset; }
  int count() const { return (has_transforms ? 12 : 0) + (has_offset ? 1 : 0); }
};

Vector6d Whitened(const HandEyeFit& fit, const Vector6d& residual) {
  Vector6d white;
  white << residual.head<3>() / fit.position_scale_m, residual.tail<3>() / fit.rotation_scale_rad;
  return white;
}

void UpdateScales(HandEyeFit& fit) {
  std::vector<double> positions, rotations;
  for (const HandEyePair& pair : fit.pairs) {
    const Vector6d r = ResidualOf(pair, fit.state).value;
    positions.push_back(r.head<3>().norm());
    rotations.push_back(r.tail<3>().norm());
  }
  fit.position_scale_m = std::max(kLeastScale, UpperMedian(positions) / kMedianOfNorm3);
  fit.rotation_scale_rad = std::max(kLeastScale, UpperMedian(rotations) / kMedianOfNorm3);
}

double MeanCost(const HandEyeFit& fit, const std::vector<HandEyePair>& pairs, const HandEyeState& state) {
  double sum = 0.0;
  for (const HandEyePair& pair : pairs) {
    sum += std::log1p(Whitened(fit, ResidualOf(pair, state).value).squaredNorm() / kCauchy2);
  }
  return sum / static_cast<double>(pairs.size());
}

struct NormalEquations {
  Matrix13d h = Matrix13d::Zero();
  Vector13d g = Vector13d::Zero();
  std::vector<Vector13d> scores;  // the terms of g
};

NormalEquations MakeEquations(const HandEyeFit& fit, const HandEyeFree& free) {
  NormalEquations equations;
  Vector6d weights;
  weights << Eigen::Vector3d::Constant(1.0 / fit.position_scale_m),
      Eigen::Vector3d::Constant(1.0 / fit.rotation_scale_rad);
  for (const HandEyePair& pair : fit.pairs) {
    HandEyeResidual residual = ResidualOf(pair, fit.state);
    for (int i = 0; i < kHandEyeParameters; ++i) {
      if (!free.Has(i)) residual.jacobian.col(i).setZero();
    }
    residual.jacobian = weights.asDiagonal() * residual.jacobian;
    residual.value = weights.asDiagonal() * residual.value;
    const double weight = 1.0 / (1.0 + residual.value.squaredNorm() / kCauchy2);
    const Vector13d score = -weight * residual.jacobian.transpose() * residual.value;
    equations.h += weight * residual.jacobian.transpose() * residual.jacobian;
    equations.g += score;
    equations.scores.push_back(score);
  }
  return equations;
}

// Levenberg and Marquardt's iteration at fixed scales. Returns false if too few poses have a reference.
bool Iterate(const Trajectory& poses, const MovingReference& reference, const HandEyeFree& free, size_t min_poses,
             HandEyeFit& fit) {
  double damping = kFirstDamping;
  double cost = MeanCost(fit, fit.pairs, fit.state);
  for (int i = 0; i < kIterations; ++i) {
    const NormalEquations equations = MakeEquations(fit, free);
    Matrix13d damped = equations.h;
    // The small constant leaves fixed and undetermined parameters where they are.
    damped.diagonal() += damping * equations.h.diagonal() + Vector13d::Constant(1e-9 * equations.h.trace() + 1e-300);
    const Vector13d step = damped.ldlt().solve(equations.g);
    HandEyeState next = fit.state;
    next.Step(step);
    std::vector<HandEyePair> pairs = free.has_offset ? PairPoses(poses, reference, next.time_offset_s) : fit.pairs;
    const double next_cost = pairs.size() < min_poses ? kInfinity : MeanCost(fit, pairs, next);
    if (!(next_cost <= cost)) {
      damping *= kDampingFactor;
      if (damping > kLargestDamping) break;
      continue;
    }
    const bool is_done = cost - next_cost <= kConverged * cost;
    fit.state = next;
    fit.pairs = std::move(pairs);
    cost = next_cost;
    damping = std::max(kLeastDamping, 0.1 * damping);
    if (is_done) break;
  }
  return fit.pairs.size() >= min_poses;
}

std::optional<HandEyeFit> Fit(const Trajectory& poses, const Trajectory& reference, HandEyeMount mount, double offset_s,
                              const HandEyeFree& free, const HandEyeOptions& options) {
  const MovingReference moving(reference, mount == HandEyeMount::kInHand);
  const auto min_poses = static_cast<size_t>(options.min_poses);
  HandEyeFit fit{.state = {.time_offset_s = offset_s}, .mount = mount};
  fit.pairs = PairPoses(poses, moving, offset_s);
  if (fit.pairs.size() < min_poses) return std::nullopt;
  if (free.has_transforms) StartHandEye(fit.pairs, fit.state);
  for (int i = 0; i < kScaleUpdates; ++i) {
    UpdateScales(fit);
    if (!Iterate(poses, moving, free, min_poses, fit)) return std::nullopt;
  }
  UpdateScales(fit);
  return fit;
}

// The first lag at which all six residuals are nearly uncorrelated, and the number of successive poses that count as
// one: 1 + 2 times the sum of the autocorrelation, the largest of the six.
std::pair<size_t, double> Correlation(const HandEyeFit& fit) {
  std::vector<Vector6d> whites;
  for (const HandEyePair& pair : fit.pairs) {
    Vector6d white = Whitened(fit, ResidualOf(pair, fit.state).value);
    if (white.squaredNorm() > kOutlier2) white.setZero();
    whites.push_back(white);
  }
  Vector6d variance = Vector6d::Constant(1e-300);
  for (const Vector6d& white : whites) variance += white.cwiseAbs2();
  Vector6d sum = Vector6d::Ones();
  Eigen::Array<bool, 6, 1> ended = Eigen::Array<bool, 6, 1>::Constant(false);
  size_t lag = 1;
  for (; lag < whites.size() / 4 && !ended.all(); ++lag) {
    Vector6d product = Vector6d::Zero();
    for (size_t i = lag; i < whites.size(); ++i) product += whites[i].cwiseProduct(whites[i - lag]);
    const Vector6d correlation = product.cwiseQuotient(variance);
    ended = ended || correlation.array() < kUncorrelated;
    for (int k = 0; k < 6; ++k) {
      if (!ended(k)) sum(k) += 2.0 * correlation(k);
    }
  }
  return {lag, sum.maxCoeff()};
}

// The sum of the scores' covariances with Bartlett's weights (Newey and West, Econometrica 1987).
Matrix13d ScoreCovariance(const std::vector<Vector13d>& scores, size_t max_lag) {
  Matrix13d sum = Matrix13d::Zero();
  for (size_t lag = 0; lag <= max_lag && lag < scores.size(); ++lag) {
    Matrix13d product = Matrix13d::Zero();
    for (size_t i = lag; i < scores.size(); ++i) product += scores[i] * scores[i - lag].transpose();
    const double weight = 1.0 - static_cast<double>(lag) / static_cast<double>(max_lag + 1);
    sum += lag == 0 ? product : (weight * (product + product.transpose())).eval();
  }
  return sum;
}

// H^-1 S H^-1 with the scores' covariance S. Parameters in a direction without information have infinite variances.
Matrix13d ParameterCovariance(const NormalEquations& equations, const Matrix13d& scores) {
  const Vector13d scale = equations.h.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const Matrix13d scaled = scale.asDiagonal() * equations.h * scale.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Matrix13d> solver(scaled);
  Vector13d inverse = Vector13d::Zero();
  Vector13d undetermined = Vector13d::Zero();  // shares of the parameters in directions without information
  for (int i = 0; i < kHandEyeParameters; ++i) {
    if (solver.eigenvalues()(i) > 1e-12) {
      inverse(i) = 1.0 / solver.eigenvalues()(i);
    } else {
      undetermined += solver.eigenvectors().col(i).cwiseAbs2();
    }
  }
  const Matrix13d h_inverse = scale.asDiagonal() * solver.eigenvectors() * inverse.asDiagonal() *
                              solver.eigenvectors().transpose() * scale.asDiagonal();
  Matrix13d covariance = h_inverse * scores * h_inverse;
  for (int i = 0; i < kHandEyeParameters; ++i) {
    if (undetermined(i) > 1e-6) covariance(i, i) = kInfinity;
  }
  return covariance;
}

void AddErrors(const HandEyeFit& fit, const HandEyeFree& free, HandEye& result) {
  const NormalEquations equations = MakeEquations(fit, free);
  const auto [lag, correlated] = Correlation(fit);
  result.correlated_poses = correlated;
  // Independent poses beyond the parameters: six numbers each.
  const double independent = 6.0 * static_cast<double>(fit.pairs.size()) / correlated;
  const double excess = independent - free.count();
  const double small_sample = excess > 0.0 ? independent / excess : kInfinity;
  const Matrix13d covariance =
      ParameterCovariance(equations, ScoreCovariance(equations.scores, 2 * lag)) * small_sample;
  const Vector13d errors = covariance.diagonal().cwiseSqrt();
  result.left_covariance = covariance.topLeftCorner<6, 6>();
  result.left_errors = free.has_transforms ? errors.head<6>() : Vector6d(Vector6d::Zero());
  result.right_errors = free.has_transforms ? errors.segment<6>(6) : Vector6d(Vector6d::Zero());
  if (free.has_offset) result.time_offset_error_s = errors(12);
}

void AddResiduals(const HandEyeFit& fit, HandEye& result) {
  double positions = 0.0, rotations = 0.0;
  int count = 0;
  for (const HandEyePair& pair : fit.pairs) {
    const Vector6d r = ResidualOf(pair, fit.state).value;
    if (Whitened(fit, r).squaredNorm() > kOutlier2) {
      ++result.num_outliers;
      continue;
    }
    positions += r.head<3>().squaredNorm();
    rotations += r.tail<3>().squaredNorm();
    ++count;
  }
  result.num_poses = static_cast<int>(fit.pairs.size());
  result.position_rms_m = std::sqrt(positions / std::max(count, 1));
  result.rotation_rms_rad = std::sqrt(rotations / std::max(count, 1));
}

// Standard deviations of the orientations about the principal axes of their spread.
std::array<double, 3> AxesOf(const std::vector<HandEyePair>& pairs) {
  const Eigen::Matrix3d& centre = pairs[pairs.size() / 2].reference.pose.rotation;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  Eigen::Matrix3d square = Eigen::Matrix3d::Zero();
  for (const HandEyePair& pair : pairs) {
    const Eigen::Vector3d turn = LogSo3(centre.transpose() * pair.reference.pose.rotation);
    mean += turn;
    square += turn * turn.transpose();
  }
  const auto n = static_cast<double>(pairs.size());
  const Eigen::Matrix3d spread = square / n - (mean / n) * (mean / n).transpose();
  const Eigen::Vector3d values = Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(spread).eigenvalues();
  return {std::sqrt(std::max(0.0, values(2))), std::sqrt(std::max(0.0, values(1))),
          std::sqrt(std::max(0.0, values(0)))};
}

void AddWarnings(const HandEyeFree& free, const HandEyeOptions& options, HandEye& result) {
  const auto warn = [&result](const std::string& text) { result.warnings.push_back(text); };
  if (free.has_transforms && result.axes_rad[1] < options.min_second_axis_rad) {
    result.has_second_axis = false;
    warn(absl::StrFormat(
        "the orientations of the reference spread by %.1f deg about one axis and by %.1f deg about a second one: with "
        "fewer than two axes the transforms are not determined; turn about a second axis, too",
        result.axes_rad[0] * kDegreesPerRadian, result.axes_rad[1] * kDegreesPerRadian));
  }
  const double worst_rad = std::max(result.left_errors.tail<3>().maxCoeff(), result.right_errors.tail<3>().maxCoeff());
  const double worst_m = std::max(result.left_errors.head<3>().maxCoeff(), result.right_errors.head<3>().maxCoeff());
  if (free.has_transforms && (worst_rad > kLargeError || worst_m > kLargeError)) {
    warn("a standard error exceeds 50 mm or 0.05 rad: the poses hardly determine that number");
  }
  if (result.other_mount_ratio && *result.other_mount_ratio < kClearRatio) {
    warn(absl::StrFormat(
        "the other mount fits nearly as well (residuals larger by a factor of %.2f): give the mount, or move more",
        *result.other_mount_ratio));
  }
  if (result.num_outliers * kPosesPerOutlier > result.num_poses) {
    warn(absl::StrFormat("%d of %d poses are outliers, beyond 5 standard deviations", result.num_outliers,
                         result.num_poses));
  }
}

// Compares the residuals with the motion of the poses, both of one axis.
void CheckMotion(const HandEyeFit& fit, HandEye& result) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero(), square = Eigen::Vector3d::Zero();
  for (const HandEyePair& pair : fit.pairs) {
    mean += pair.camera_from_object.translation_m;
    square += pair.camera_from_object.translation_m.cwiseAbs2();
  }
  const auto n = static_cast<double>(fit.pairs.size());
  const double motion_m = std::sqrt(std::max(0.0, (square / n - (mean / n).cwiseAbs2()).sum() / 3.0));
  const double motion_rad = std::hypot(result.axes_rad[0], result.axes_rad[1], result.axes_rad[2]) / std::sqrt(3.0);
  const bool has_positions = motion_m < kLeastMotionM || fit.position_scale_m <= kUnexplained * motion_m;
  const bool has_rotations = motion_rad < kLeastMotionRad || fit.rotation_scale_rad <= kUnexplained * motion_rad;
  result.explains_motion = has_positions && has_rotations;
  if (result.explains_motion) return;
  const std::optional<double> factor = ReferenceScale(fit.pairs);
  if (factor && (*factor > kOtherUnit || *factor < 1.0 / kOtherUnit)) {
    result.warnings.insert(
        result.warnings.begin(),
        absl::StrFormat("the poses move %.3g times as far as the reference: both must be in metres, and so must the "
                        "model of the object",
                        *factor));
    return;
  }
  result.warnings.insert(
      result.warnings.begin(),
      absl::StrFormat("the residuals of %.3g mm and %.2f deg are as large as the motion of %.3g mm and %.1f deg: are "
                      "both trajectories of "
                      "the same motion, in metres, with quaternions in the order x y z w, and is the mount right?",
                      1e3 * fit.position_scale_m, fit.rotation_scale_rad * kDegreesPerRadian, 1e3 * motion_m,
                      motion_rad * kDegreesPerRadian));
}

// Returns at most `max_poses` of the poses, at equal steps of the index.
Trajectory Thinned(const Trajectory& poses, int max_poses) {
  const size_t stride = (poses.size() + static_cast<size_t>(max_poses) - 1) / static_cast<size_t>(max_poses);
  Trajectory thinned;
  for (size_t i = 0; i < poses.size(); i += std::max<size_t>(1, stride)) thinned.push_back(poses[i]);
  return thinned;
}

absl::StatusOr<std::vector<double>> Offsets(const Trajectory& poses, const Trajectory& reference,
                                            const HandEyeOptions& options) {
  if (options.time_offset_s) return std::vector<double>{*options.time_offset_s};
  const std::vector<OffsetCandidate> found = FindTimeOffsets(poses, reference, kOffsetCandidates);
  if (found.empty() || found.front().correlation < options.min_correlation) {
    return absl::FailedPreconditionError(absl::StrFormat(
        "no time offset was found: at the best one the speeds of both trajectories have a correlation of %.2f, and "
        "%.2f is needed; do both show the same motion, with times in seconds, and with pauses or changes of speed? "
        "Otherwise give the offset",
        found.empty() ? 0.0 : found.front().correlation, options.min_correlation));
  }
  std::vector<double> offsets;
  for (const OffsetCandidate& candidate : found) offsets.push_back(candidate.offset_s);
  return offsets;
}

// The fits of all mounts and offsets, the best one first.
std::vector<HandEyeFit> FitAll(const Trajectory& poses, const Trajectory& reference, const std::vector<double>& offsets,
                               const HandEyeFree& free, const HandEyeOptions& options) {
  std::vector<HandEyeFit> fits;
  for (const HandEyeMount mount : {HandEyeMount::kBeside, HandEyeMount::kInHand}) {
    if (options.mount != HandEyeMount::kAuto && options.mount != mount) continue;
    // Both trajectories are camera_from_object then.
    if (options.has_same_frames && mount == HandEyeMount::kInHand) continue;
    for (const double offset_s : offsets) {
      if (auto fit = Fit(poses, reference, mount, offset_s, free, options)) fits.push_back(*std::move(fit));
    }
  }
  std::stable_sort(fits.begin(), fits.end(),
                   [](const HandEyeFit& a, const HandEyeFit& b) { return a.LogScale() < b.LogScale(); });
  return fits;
}

void AddAlternatives(const std::vector<HandEyeFit>& fits, HandEye& result) {
  const HandEyeFit& best = fits.front();
  for (const HandEyeFit& fit : fits) {
    const double ratio = std::exp(fit.LogScale() - best.LogScale());
    if (fit.mount != best.mount) {
      if (!result.other_mount_ratio) result.other_mount_ratio = ratio;
      continue;
    }
    const double apart_s = std::abs(fit.state.time_offset_s - best.state.time_offset_s);
    if (apart_s < kSameOffsetS || ratio >= kClearRatio) continue;
    result.warnings.push_back(absl::StrFormat(
        "a time offset of %.3f s fits nearly as well (residuals larger by a factor of %.2f): is the motion periodic?",
        fit.state.time_offset_s, ratio));
  }
}

}  // namespace

const char* HandEyeMountName(HandEyeMount mount) {
  for (const auto& [value, name] : kHandEyeMountNames) {
    if (value == mount) return name;
  }
  return "";
}

absl::Status HandEyeOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_poses", max_poses, 100, 100'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_poses", min_poses, 4, 1000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_correlation", min_correlation, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_second_axis_rad", min_second_axis_rad, 0.0, 1.0));
  if (!time_offset_s) return absl::OkStatus();
  return CheckRange("time_offset_s", *time_offset_s, -4e9, 4e9);  // up to Unix time against time since start
}

RigidTransform HandEye::Predict(const RigidTransform& reference_pose) const {
  return left * (mount == HandEyeMount::kInHand ? reference_pose.Inverse() : reference_pose) * right;
}

Trajectory HandEye::Aligned(const Trajectory& reference) const {
  Trajectory aligned;
  const int64_t offset_us = std::llround(time_offset_s * 1e6);
  for (const StampedPose& pose : reference) {
    aligned.push_back({pose.t_us - offset_us, Predict(pose.camera_from_object)});
  }
  return aligned;
}

absl::StatusOr<HandEye> SolveHandEye(const Trajectory& camera_from_object, const Trajectory& reference,
                                     const HandEyeOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  if (static_cast<int64_t>(camera_from_object.size()) < options.min_poses || reference.size() < 2) {
    return absl::FailedPreconditionError(
        absl::StrFormat("at least %d poses and 2 of the reference are needed; there are %d and %d", options.min_poses,
                        camera_from_object.size(), reference.size()));
  }
  const HandEyeFree free{.has_transforms = !options.has_same_frames, .has_offset = !options.time_offset_s};
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<double> offsets, Offsets(camera_from_object, reference, options));
  const std::vector<HandEyeFit> fits =
      FitAll(Thinned(camera_from_object, options.max_poses), reference, offsets, free, options);
  if (fits.empty()) {
    return absl::FailedPreconditionError(
        absl::StrFormat("fewer than %d poses have a reference at their times; with the offset the reference spans %.3f "
                        "to %.3f s of the sensor's clock, the poses %.3f to %.3f s; the offset is the clock of the "
                        "reference minus that of the sensor, and without one it is estimated from the motion",
                        options.min_poses, reference.front().t_us * 1e-6 - offsets.front(),
                        reference.back().t_us * 1e-6 - offsets.front(), camera_from_object.front().t_us * 1e-6,
                        camera_from_object.back().t_us * 1e-6));
  }
  const HandEyeFit& best = fits.front();
  HandEye result{.mount = best.mount, .left = best.state.left, .right = best.state.right};
  result.time_offset_s = best.state.time_offset_s;
  AddAlternatives(fits, result);
  AddErrors(best, free, result);
  AddResiduals(best, result);
  result.axes_rad = AxesOf(best.pairs);
  AddWarnings(free, options, result);
  if (free.has_transforms) CheckMotion(best, result);
  return result;
}

}  // namespace evpose

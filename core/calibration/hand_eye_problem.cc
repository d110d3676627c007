// SPDX-License-Identifier: Apache-2.0
#include "core/calibration/hand_eye_problem.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "core/calibration/time_offset.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

// Rotations of relative motions near a half turn have an axis of unknown sign.
constexpr double kMaxMotionAngleRad = 2.5;
// Below this root mean square of the relative rotations, radians, the translations determine the rotation of `left`.
constexpr double kMinMotionAngleRad = 0.02;
constexpr int kReweightings = 5;  // reduce the weight of outliers; the result is only a start

// A relative motion of both trajectories: camera = left * reference * left^-1.
struct RelativeMotion {
  RigidTransform camera;
  RigidTransform reference;
  Eigen::Vector3d camera_rotation;
  Eigen::Vector3d reference_rotation;
  double weight = 1.0;
};

std::vector<RelativeMotion> RelativeMotions(const std::vector<HandEyePair>& pairs) {
  std::vector<RelativeMotion> motions;
  const size_t n = pairs.size();
  // Over several times: a large rotation determines the axis better than a small one, but above kMaxMotionAngleRad it
  // is not used.
  for (const size_t lag : {n / 16, n / 8, n / 4, n / 2}) {
    for (size_t i = 0; lag > 0 && i + lag < n; ++i) {
      const HandEyePair &a = pairs[i], &b = pairs[i + lag];
      RelativeMotion motion{.camera = b.camera_from_object * a.camera_from_object.Inverse(),
                            .reference = b.reference.pose * a.reference.pose.Inverse()};
      motion.camera_rotation = LogSo3(motion.camera.rotation);
      motion.reference_rotation = LogSo3(motion.reference.rotation);
      const double larger = std::max(motion.camera_rotation.norm(), motion.reference_rotation.norm());
      if (larger <= kMaxMotionAngleRad) motions.push_back(motion);
    }
  }
  return motions;
}

// The rotation R that minimises the weighted sum of |to - R from|^2 (Kabsch, Acta Crystallographica A32, 1976), by its
// matrix sum of to from^T.
Eigen::Matrix3d NearestRotation(const Eigen::Matrix3d& sum) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(sum, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d sign = Eigen::Matrix3d::Identity();
  if ((svd.matrixU() * svd.matrixV().transpose()).determinant() < 0.0) sign(2, 2) = -1.0;
  return svd.matrixU() * sign * svd.matrixV().transpose();
}

// Cauchy's weights for the residuals, with their median as scale.
template <typename Residual>
void Reweight(std::vector<RelativeMotion>& motions, const Residual& residual) {
  std::vector<double> values;
  for (const RelativeMotion& motion : motions) values.push_back(residual(motion));
  std::vector<double> sorted = values;
  const double scale = std::max(1e-12, 2.0 * UpperMedian(sorted));
  for (size_t i = 0; i < motions.size(); ++i) motions[i].weight = 1.0 / (1.0 + values[i] * values[i] / (scale * scale));
}

Eigen::Matrix3d LeftRotation(std::vector<RelativeMotion>& motions) {
  double sum2 = 0.0;
  for (const RelativeMotion& motion : motions) sum2 += motion.reference_rotation.squaredNorm();
  const bool turns = sum2 >= kMinMotionAngleRad * kMinMotionAngleRad * static_cast<double>(motions.size());
  const auto to = [turns](const RelativeMotion& m) -> Eigen::Vector3d {
    return turns ? m.camera_rotation : m.camera.translation_m;
  };
  const auto from = [turns](const RelativeMotion& m) -> Eigen::Vector3d {
    return turns ? m.reference_rotation : m.reference.translation_m;
  };
  // The lengths must agree whatever the rotation.
  Reweight(motions, [&](const RelativeMotion& m) { return std::abs(to(m).norm() - from(m).norm()); });
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  for (int i = 0; i < kReweightings; ++i) {
    Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
    for (const RelativeMotion& m : motions) sum += m.weight * to(m) * from(m).transpose();
    rotation = NearestRotation(sum);
    Reweight(motions, [&](const RelativeMotion& m) { return (to(m) - rotation * from(m)).norm(); });
  }
  return rotation;
}

Eigen::Vector3d LeftTranslation(std::vector<RelativeMotion>& motions, const Eigen::Matrix3d& rotation) {
  const auto residual = [&rotation](const RelativeMotion& m, const Eigen::Vector3d& translation) -> Eigen::Vector3d {
    return (m.camera.rotation - Eigen::Matrix3d::Identity()) * translation + m.camera.translation_m -
           rotation * m.reference.translation_m;
  };
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  for (int i = 0; i < kReweightings; ++i) {
    Eigen::Matrix3d h = Eigen::Matrix3d::Zero();
    Eigen::Vector3d g = Eigen::Vector3d::Zero();
    for (const RelativeMotion& m : motions) {
      const Eigen::Matrix3d a = m.camera.rotation - Eigen::Matrix3d::Identity();
      h += m.weight * a.transpose() * a;
      g -= m.weight * a.transpose() * residual(m, Eigen::Vector3d::Zero());
    }
    // The ridge keeps components without information at zero.
    h += (1e-9 * h.trace() + 1e-300) * Eigen::Matrix3d::Identity();
    translation = h.ldlt().solve(g);
    Reweight(motions, [&](const RelativeMotion& m) { return residual(m, translation).norm(); });
  }
  return translation;
}

RigidTransform RightTransform(const std::vector<HandEyePair>& pairs, const RigidTransform& left) {
  Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
  std::array<std::vector<double>, 3> positions;
  for (const HandEyePair& pair : pairs) {
    const RigidTransform right = pair.reference.pose.Inverse() * left.Inverse() * pair.camera_from_object;
    sum += right.rotation;
    for (int i = 0; i < 3; ++i) positions[static_cast<size_t>(i)].push_back(right.translation_m(i));
  }
  return {NearestRotation(sum), {UpperMedian(positions[0]), UpperMedian(positions[1]), UpperMedian(positions[2])}};
}

// The positions of the poses as left.t + left.R G.R right.t + factor left.R G.t, which are linear in the unknowns
// left.t, right.t and the factor: it and its standard error, and the median residual.
struct PositionFit {
  double factor = 1.0;
  double factor_error = 0.0;
  double residual_m = 0.0;
};

PositionFit FitPositions(const std::vector<HandEyePair>& pairs, const Eigen::Matrix3d& left) {
  using Matrix7d = Eigen::Matrix<double, 7, 7>;
  double unit = 1e-12;  // of the reference's positions, so that all unknowns are of the order of one
  for (const HandEyePair& pair : pairs) unit = std::max(unit, pair.reference.pose.translation_m.norm());
  std::vector<double> residuals(pairs.size(), 0.0);
  PositionFit fit;
  for (int i = 0; i < kReweightings; ++i) {
    std::vector<double> sorted = residuals;
    const double scale = std::max(1e-12, 2.0 * UpperMedian(sorted));
    Matrix7d h = Matrix7d::Zero();
    Eigen::Matrix<double, 7, 1> g = Eigen::Matrix<double, 7, 1>::Zero();
    Eigen::Matrix<double, 3, 7> row;
    row.leftCols<3>().setIdentity();
    const auto set_row = [&](const RigidTransform& reference) {
      row.middleCols<3>(3) = left * reference.rotation;
      row.col(6) = left * reference.translation_m / unit;
    };
    for (size_t k = 0; k < pairs.size(); ++k) {
      set_row(pairs[k].reference.pose);
      const double weight = 1.0 / (1.0 + residuals[k] * residuals[k] / (scale * scale));
      h += weight * row.transpose() * row;
      g += weight * row.transpose() * pairs[k].camera_from_object.translation_m;
    }
    h += 1e-9 * h.trace() * Matrix7d::Identity();  // keeps unknowns without information at zero
    const Eigen::Matrix<double, 7, 1> unknowns = h.ldlt().solve(g);
    for (size_t k = 0; k < pairs.size(); ++k) {
      set_row(pairs[k].reference.pose);
      residuals[k] = (pairs[k].camera_from_object.translation_m - row * unknowns).norm();
    }
    sorted = residuals;
    fit.residual_m = UpperMedian(sorted);
    fit.factor = unknowns(6) / unit;
    // As if there were 20 independent poses: successive errors are correlated.
    const double information = h.inverse()(6, 6) * static_cast<double>(pairs.size()) / 20.0;
    fit.factor_error = fit.residual_m * std::sqrt(information) / unit;
  }
  return fit;
}

// The time between the poses before and after t_us; 0 if there is none before or none after.
int64_t GapAt(const Trajectory& trajectory, int64_t t_us) {
  const auto after = std::lower_bound(trajectory.begin(), trajectory.end(), t_us,
                                      [](const StampedPose& pose, int64_t t) { return pose.t_us < t; });
  if (after == trajectory.end() || after == trajectory.begin()) return 0;
  return after->t_us - (after - 1)->t_us;
}

}  // namespace

MovingReference::MovingReference(const Trajectory& reference, bool is_inverted)
    : reference_(reference),
      is_inverted_(is_inverted),
      interval_us_(MedianIntervalUs(reference)),
      max_gap_us_(kGapIntervals * interval_us_) {}

std::optional<MovingPose> MovingReference::At(int64_t t_us) const {
  if (GapAt(reference_, t_us) > max_gap_us_) return std::nullopt;
  const auto pose = Interpolate(reference_, t_us);
  if (!pose.ok()) return std::nullopt;
  // The derivative over the time of a typical interval, at the ends of the trajectory one-sided.
  const int64_t half_us = std::max<int64_t>(1, interval_us_ / 2);
  const int64_t begin_us = std::max(reference_.front().t_us, t_us - half_us);
  const int64_t end_us = std::min(reference_.back().t_us, t_us + half_us);
  const auto begin = Interpolate(reference_, begin_us), end = Interpolate(reference_, end_us);
  if (!begin.ok() || !end.ok() || end_us <= begin_us) return std::nullopt;
  const auto moving = [this](const RigidTransform& at) { return is_inverted_ ? at.Inverse() : at; };
  return MovingPose{moving(*pose),
                    Difference(moving(*end), moving(*begin)) / (1e-6 * static_cast<double>(end_us - begin_us))};
}

void HandEyeState::Step(const Vector13d& step) {
  left = Perturb(left, step.head<6>());
  right = Perturb(right, step.segment<6>(6));
  time_offset_s += step(12);
}

std::vector<HandEyePair> PairPoses(const Trajectory& poses, const MovingReference& reference, double time_offset_s) {
  std::vector<HandEyePair> pairs;
  const int64_t offset_us = std::llround(time_offset_s * 1e6);
  for (const StampedPose& pose : poses) {
    const std::optional<MovingPose> moving = reference.At(pose.t_us + offset_us);
    if (moving) pairs.push_back({pose.camera_from_object, *moving});
  }
  return pairs;
}

HandEyeResidual ResidualOf(const HandEyePair& pair, const HandEyeState& state) {
  const RigidTransform& g = pair.reference.pose;
  const Eigen::Matrix3d& left = state.left.rotation;
  const Eigen::Matrix3d left_g = left * g.rotation;
  const Eigen::Vector3d moved = g.rotation * state.right.translation_m;
  HandEyeResidual residual;
  residual.value = Difference(pair.camera_from_object, state.left * g * state.right);
  // Jacobian of the prediction; that of the residual is its negative (to first order in the rotation).
  auto& j = residual.jacobian;
  j.block<3, 3>(0, 0).setIdentity();
  j.block<3, 3>(0, 3) = -Hat(left * (moved + g.translation_m));
  j.block<3, 3>(3, 3).setIdentity();
  j.block<3, 3>(0, 6) = left_g;
  j.block<3, 3>(3, 9) = left_g;
  const Eigen::Vector3d angular = pair.reference.twist.tail<3>();
  j.block<3, 1>(0, 12) = left * (angular.cross(moved) + pair.reference.twist.head<3>());
  j.block<3, 1>(3, 12) = left * angular;
  j = -j;
  return residual;
}

std::optional<double> ReferenceScale(const std::vector<HandEyePair>& pairs) {
  std::vector<RelativeMotion> motions = RelativeMotions(pairs);
  if (motions.empty()) return std::nullopt;
  const PositionFit fit = FitPositions(pairs, LeftRotation(motions));
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const HandEyePair& pair : pairs) mean += pair.camera_from_object.translation_m;
  mean /= static_cast<double>(pairs.size());
  std::vector<double> motion;
  for (const HandEyePair& pair : pairs) motion.push_back((pair.camera_from_object.translation_m - mean).norm());
  const bool is_determined = fit.factor_error < 0.1 * std::abs(fit.factor);
  const bool fits = fit.residual_m < 0.2 * UpperMedian(motion);
  return is_determined && fits ? std::optional(fit.factor) : std::nullopt;
}

void StartHandEye(const std::vector<HandEyePair>& pairs, HandEyeState& state) {
  std::vector<RelativeMotion> motions = RelativeMotions(pairs);
  if (!motions.empty()) {
    state.left.rotation = LeftRotation(motions);
    state.left.translation_m = LeftTranslation(motions, state.left.rotation);
  }
  state.right = RightTransform(pairs, state.left);
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/rivals.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/base/yield_point.h"
#include "core/geometry/half_turn.h"
#include "core/models/continuous_symmetry.h"

namespace evpose {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// The unit vector from the camera to a point of the object, in the object frame.
Vector3d RayTo(const RigidTransform& camera_from_object, const Vector3d& point) {
  return camera_from_object.rotation.transpose() * (camera_from_object * point).normalized();
}

// Covariance of a rival: the pose is uncertain as a first pose is, because its refinement must find depth and position
// again. The velocities were measured with the other pose.
void SetRivalCovariance(const MotionState& from, double focal_px, const InitialPoseOptions& options,
                        MotionState& rival) {
  constexpr double kTwistFactor = 4.0;  // twice the standard deviation
  const MotionState initial = InitialMotionState(rival.camera_from_object, rival.t_us, focal_px, options);
  rival.covariance.setZero();
  rival.covariance.topLeftCorner<6, 6>() = initial.covariance.topLeftCorner<6, 6>();
  rival.covariance.bottomRightCorner<6, 6>() = kTwistFactor * from.covariance.bottomRightCorner<6, 6>();
}

// Integrals over the edges or the surface of a model.
struct Moments {
  double measure = 0.0;  // length or area
  Vector3d first = Vector3d::Zero();
  Matrix3d second = Matrix3d::Zero();  // sum of x x^T

  void AddSegment(const Vector3d& p, const Vector3d& q) {
    const double length = (q - p).norm();
    const Vector3d sum = p + q;
    measure += length;
    first += length / 2.0 * sum;
    second += length / 6.0 * (sum * sum.transpose() + p * p.transpose() + q * q.transpose());
  }
  void AddTriangle(const Vector3d& p, const Vector3d& q, const Vector3d& r) {
    const double area = 0.5 * (q - p).cross(r - p).norm();
    const Vector3d sum = p + q + r;
    measure += area;
    first += area / 3.0 * sum;
    second += area / 12.0 * (sum * sum.transpose() + p * p.transpose() + q * q.transpose() + r * r.transpose());
  }
};

// Returns the moments of the surface if the model has contours, because contours move over all of it; else of the
// edges.
Moments MomentsOf(const ObjectModel& model) {
  Moments moments;
  if (model.surface.empty() && model.facet_edges.empty()) {
    for (size_t i = 0; i < model.lines.size(); ++i) {
      YieldPoint(i);
      moments.AddSegment(model.lines[i].p1, model.lines[i].p2);
    }
    for (const EdgeCurve& curve : model.curves) {
      for (size_t i = 1; i < curve.points.size(); ++i) {
        YieldPoint(i);
        moments.AddSegment(curve.points[i - 1], curve.points[i]);
      }
    }
    return moments;
  }
  for (size_t i = 0; i < model.triangles.size(); ++i) {
    YieldPoint(i);
    const auto& [a, b, c] = model.triangles[i];
    moments.AddTriangle(model.vertices[a], model.vertices[b], model.vertices[c]);
  }
  return moments;
}

}  // namespace

MotionState MirroredState(const MotionState& state, const Vector3d& point, const Vector3d& normal, double focal_px,
                          const InitialPoseOptions& options) {
  const RigidTransform& pose = state.camera_from_object;
  const Vector3d angular = state.twist.tail<3>();
  const Vector3d centre = pose * point;
  const double distance_m = centre.norm();
  const Vector3d ray = centre / distance_m;
  const Vector3d direction = pose.rotation * normal;
  const Vector3d centre_velocity = state.twist.head<3>() + angular.cross(Vector3d(centre - pose.translation_m));
  const Vector3d ray_velocity = (centre_velocity - centre_velocity.dot(ray) * ray) / distance_m;

  MotionState mirrored = state;
  // README, equation (9): the product of two reflections is the rotation in the plane of both vectors.
  const Vector3d across = ray - ray.dot(direction) * direction;
  const Vector3d other = Reflection(ray) * direction;
  // With a smaller `across`, the normal is along the ray, and the mirrored pose is the pose itself.
  if (across.norm() > 1e-9) {
    mirrored.camera_from_object.rotation = Reflection(ray) * Reflection(across.normalized()) * pose.rotation;
  }
  mirrored.camera_from_object.translation_m = centre - mirrored.camera_from_object.rotation * point;
  // Equation (10).
  const Vector3d velocity = Reflection(ray) * angular.cross(direction) -
                            2.0 * (ray.dot(direction) * ray_velocity + ray_velocity.dot(direction) * ray);
  const Vector3d turn = other.cross(velocity) + angular.dot(direction) * other;
  const Vector3d arm = centre - mirrored.camera_from_object.translation_m;
  mirrored.twist << centre_velocity - turn.cross(arm), turn;
  SetRivalCovariance(state, focal_px, options, mirrored);
  // The rate of the inclination may have been measured with events that belong to the other side. A normal along the
  // ray has no inclination.
  const Vector3d hinge = direction.cross(ray);
  if (hinge.norm() > 1e-9) {
    const Vector3d about = hinge.normalized();
    const double rate = turn.dot(about) - angular.dot(about);
    mirrored.covariance.bottomRightCorner<3, 3>() += rate * rate * about * about.transpose();
  }
  return mirrored;
}

MotionState MovedState(const MotionState& state, const RigidTransform& object_from_object, double focal_px,
                       const InitialPoseOptions& options) {
  MotionState moved = state;
  moved.camera_from_object = state.camera_from_object * object_from_object;
  const Vector3d angular = state.twist.tail<3>();
  const Vector3d shift = moved.camera_from_object.translation_m - state.camera_from_object.translation_m;
  moved.twist.head<3>() += angular.cross(shift);
  SetRivalCovariance(state, focal_px, options, moved);
  return moved;
}

TurnedFaceDetector::TurnedFaceDetector(const ModelEdges& edges, double inclined_rad)
    : edges_(edges), inclined_sine_(inclined_rad), sides_(edges.face_planes().size(), Side::kUnknown) {}

void TurnedFaceDetector::Reset() { std::fill(sides_.begin(), sides_.end(), Side::kUnknown); }

std::optional<size_t> TurnedFaceDetector::Update(const RigidTransform& camera_from_object, double focal_px) {
  const Vector3d eye = camera_from_object.Inverse().translation_m;
  std::optional<size_t> due;
  for (size_t i = 0; i < sides_.size(); ++i) {
    const ModelEdges::FacePlane& plane = edges_.face_planes()[i];
    const Vector3d to_eye = eye - plane.point;
    const double distance_m = to_eye.norm();
    if (!(distance_m > 0.0) || edges_.IsNarrow(plane, distance_m, focal_px)) {
      sides_[i] = Side::kUnknown;
      continue;
    }
    const double sine = plane.normal.dot(to_eye) / distance_m;
    const Side before = sides_[i];
    if (std::abs(sine) < 0.5 * inclined_sine_) {
      sides_[i] = Side::kEdgeOn;
    } else if (std::abs(sine) > inclined_sine_) {
      sides_[i] = sine > 0.0 ? Side::kFront : Side::kBack;
    }
    const bool has_left = sides_[i] != before && sides_[i] != Side::kEdgeOn && before != Side::kUnknown;
    if (has_left && !due) due = i;
  }
  return due;
}

bool TiltTestTrigger::Update(const RigidTransform& camera_from_object, const Vector3d& point, double residual_px) {
  constexpr double kNewest = 0.125;  // weight of the latest residual: the mean follows within about 10 windows
  const Vector3d ray = RayTo(camera_from_object, point);
  if (test_) {
    SinceTiltTest& test = *test_;
    test.mean_residual_px += kNewest * (residual_px - test.mean_residual_px);
    test.least_residual_px = std::min(test.least_residual_px, test.mean_residual_px);
    const double cosine = test.ray.dot(ray);
    const bool has_grown = test.mean_residual_px > growth_ * test.least_residual_px;
    if (cosine > (has_grown ? partly_turned_cosine_ : turned_cosine_)) return false;
  }
  const double mean_px = test_ ? test_->mean_residual_px : residual_px;
  test_ = SinceTiltTest{ray, mean_px, mean_px};
  return true;
}

RivalGenerator::RivalGenerator(const ObjectModel& model) : model_(model) {
  // Eigenvalues of the second moments that differ by less, relative to the largest, do not determine their axes: the
  // object is nearly a cube, or turns into itself.
  constexpr double kDistinct = 0.02;
  // Relative difference of the two moments across an axis below which a quarter turn about it is a rival: the widths
  // then differ by less than an eighth, as those of a square bar with grooves in two of its sides.
  constexpr double kEqualWidth = 0.25;
  const Moments moments = MomentsOf(model);
  if (!(moments.measure > 0.0)) return;
  centroid_ = moments.first / moments.measure;
  const Eigen::SelfAdjointEigenSolver<Matrix3d> solver(moments.second / moments.measure -
                                                       centroid_ * centroid_.transpose());
  const Vector3d& values = solver.eigenvalues();
  for (int k = 0; k < 3; ++k) {
    double gap = values[2];
    for (int j = 0; j < 3; ++j) gap = j == k ? gap : std::min(gap, std::abs(values[j] - values[k]));
    if (gap <= kDistinct * values[2]) continue;
    axes_.push_back(solver.eigenvectors().col(k));
    const auto [least, most] = std::minmax(values[(k + 1) % 3], values[(k + 2) % 3]);
    if (most - least > kEqualWidth * most) continue;
    for (const double angle : {0.5 * std::numbers::pi, -0.5 * std::numbers::pi}) {
      quarter_turns_.push_back(RotationAbout(centroid_, ExpSo3(angle * axes_.back())));
    }
  }
  const auto add_half_turn = [this](const Vector3d& axis) {
    half_turns_.push_back(RotationAbout(centroid_, HalfTurn(axis)));
  };
  for (const Vector3d& axis : axes_) add_half_turn(axis);
  // The principal axes across the axis of a round object are not determined, but all half turns about them are equal.
  const auto& symmetry = model.continuous_symmetry;
  if (symmetry && symmetry->kind == ContinuousSymmetry::Kind::kAxis) add_half_turn(symmetry->axis.unitOrthogonal());
}

std::vector<MotionState> RivalGenerator::RivalsOf(const MotionState& state, double focal_px,
                                                  const InitialPoseOptions& options, double merge_rad) const {
  std::vector<MotionState> rivals;
  const auto add = [&](const MotionState& rival) {
    YieldPoint();
    const auto is_same = [&](const MotionState& other) { return IsSame(rival, other, merge_rad); };
    if (!is_same(state) && std::none_of(rivals.begin(), rivals.end(), is_same)) rivals.push_back(rival);
  };
  for (const RigidTransform& turn : half_turns_) add(MovedState(state, turn, focal_px, options));
  for (const RigidTransform& turn : quarter_turns_) add(MovedState(state, turn, focal_px, options));
  for (const Vector3d& axis : axes_) {
    const MotionState mirrored = MirroredState(state, centroid_, axis, focal_px, options);
    add(mirrored);
    for (const RigidTransform& turn : half_turns_) add(MovedState(mirrored, turn, focal_px, options));
  }
  return rivals;
}

std::vector<MotionState> RivalGenerator::TiltedRivalsOf(const MotionState& state, double tilt_rad, double focal_px,
                                                        const InitialPoseOptions& options, double merge_rad) const {
  const Vector3d ray = RayTo(state.camera_from_object, centroid_);
  const Vector3d across = ray.unitOrthogonal();
  const Vector3d other = ray.cross(across);
  std::vector<MotionState> rivals;
  for (const Vector3d& axis : {across, other, Vector3d(-across), Vector3d(-other)}) {
    const MotionState rival = MovedState(state, RotationAbout(centroid_, ExpSo3(tilt_rad * axis)), focal_px, options);
    if (!IsSame(rival, state, merge_rad)) rivals.push_back(rival);
  }
  return rivals;
}

bool RivalGenerator::IsSame(const MotionState& a, const MotionState& b, double merge_rad) const {
  const RigidTransform nearest = NearestEquivalent(a.camera_from_object, model_, b.camera_from_object);
  return RotationAngle(nearest.rotation, b.camera_from_object.rotation) < merge_rad;
}

}  // namespace evpose

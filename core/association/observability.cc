// SPDX-License-Identifier: Apache-2.0
#include "core/association/observability.h"

#include <Eigen/Cholesky>
#include <algorithm>

namespace evpose {

Matrix6d OutlineMotions(const CameraModel& camera, const RigidTransform& camera_from_object,
                        const Eigen::Vector3d& centre, double radius_m) {
  const double distance_m = (camera_from_object * centre).z();
  const double across_m = distance_m / camera.MaxFocalPx();
  Matrix6d motions = Matrix6d::Zero();
  motions.diagonal() << across_m, across_m, across_m * distance_m / radius_m, 0.0, 0.0, 0.0;
  // A rotation about the centre moves the object's origin, about which the tangent rotates.
  const Eigen::Vector3d from_centre = camera_from_object.translation_m - camera_from_object * centre;
  for (int axis = 0; axis < 3; ++axis) {
    const Eigen::Vector3d turn = across_m / radius_m * Eigen::Vector3d::Unit(axis);
    motions.col(3 + axis) << turn.cross(from_centre), turn;
  }
  return motions;
}

Eigen::Matrix3Xd FreeRotations(const ObjectModel& model, const Eigen::Matrix3d& rotation) {
  if (!model.continuous_symmetry) return Eigen::Matrix3Xd(3, 0);
  if (model.continuous_symmetry->kind == ContinuousSymmetry::Kind::kSphere) return Eigen::Matrix3d::Identity();
  return rotation * model.continuous_symmetry->axis;
}

void AddInformation(const CameraModel& camera, const ImageLine& line, double events, const Matrix6d& motions,
                    Matrix6d& information) {
  const auto add = [&](double fraction, double count) {
    const Vector6d row = motions.transpose() * (line.jacobian.transpose() * BearingOf(camera, line.PointAt(fraction)));
    information += count * row * row.transpose();
  };
  if (line.is_element) {
    add(0.5, events);
    return;
  }
  // At these two places the mean and the mean square of the position are those along the line.
  constexpr double kFraction = 0.21132486540518713;  // (1 - 1 / sqrt(3)) / 2
  add(kFraction, 0.5 * events);
  add(1.0 - kFraction, 0.5 * events);
}

namespace {

// Whether all eigenvalues are positive, those of the free rotations left out.
bool IsPositive(Matrix6d matrix, double largest, const Eigen::Matrix3Xd& free_rotations) {
  matrix.bottomRightCorner<3, 3>() += (1.0 + largest) * free_rotations * free_rotations.transpose();
  return Eigen::LLT<Matrix6d>(matrix).info() == Eigen::Success;
}

}  // namespace

bool IsDetermined(const Matrix6d& information, const Eigen::Matrix3Xd& free_rotations, double max_deviation_px) {
  // The square of the relative error of the derivatives, 0.5 %. The normals of a coarse tessellation differ from those
  // of the surface by some degrees, so that the outline of a cylinder seems to move when it turns about its axis.
  constexpr double kErrorRatio = 2.5e-5;
  const double trace = information.trace();
  const double least = std::max(1.0 / (max_deviation_px * max_deviation_px), kErrorRatio * trace);
  return IsPositive(information - least * Matrix6d::Identity(), least + trace, free_rotations);
}

bool IsAtLeast(const Matrix6d& part, double share, const Matrix6d& whole, const Eigen::Matrix3Xd& free_rotations) {
  const double rounding = 1e-6 * whole.trace();
  return IsPositive(part - share * whole + rounding * Matrix6d::Identity(), whole.trace(), free_rotations);
}

}  // namespace evpose

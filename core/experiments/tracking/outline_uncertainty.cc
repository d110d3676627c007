// SPDX-License-Identifier: Apache-2.0
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>

#include "core/experiments/tracking/model_bench.h"

namespace evpose {
namespace {

using Eigen::Vector3d;

// The motions [translation of `centre`, rotation], object frame, that leave the surface in place, as columns.
Eigen::Matrix<double, 6, Eigen::Dynamic> FreeMotions(const ContinuousSymmetry& symmetry, const Vector3d& centre) {
  const bool is_sphere = symmetry.kind == ContinuousSymmetry::Kind::kSphere;
  Eigen::Matrix<double, 6, Eigen::Dynamic> motions(6, is_sphere ? 3 : 1);
  for (Eigen::Index i = 0; i < motions.cols(); ++i) {
    const Vector3d axis = is_sphere ? Vector3d(Vector3d::Unit(i)) : symmetry.axis;
    motions.col(i) << axis.cross(centre - symmetry.centre), axis;
  }
  return motions;
}

}  // namespace

OutlineUncertainty::OutlineUncertainty(const ObjectModel& model, double focal_px) : model_(model), focal_px_(focal_px) {
  Eigen::AlignedBox3d box;
  for (const Vector3d& vertex : model.vertices) box.extend(vertex);
  for (const ModelLine& line : model.lines) box.extend(line.p1).extend(line.p2);
  centre_ = box.center();
}

double OutlineUncertainty::LargestSigmaPx(const PoseEstimate& pose) const {
  const Eigen::Matrix3d& rotation = pose.camera_from_object.rotation;
  const double depth_m = std::max((pose.camera_from_object * centre_).z(), 1e-9);
  const double radius_m = 0.5 * model_.diameter_m;
  // The tangent with the translation of the centre instead of the origin.
  Matrix6d to_centre = Matrix6d::Identity();
  to_centre.topRightCorner<3, 3>() = -Hat(rotation * centre_);
  // The scale to pixels at the outline is equation (2) of the README.
  const double px_per_m = focal_px_ / depth_m;
  Vector6d scale = Vector6d::Constant(px_per_m * radius_m);
  scale.head<2>().setConstant(px_per_m);
  scale[2] = px_per_m * radius_m / depth_m;
  const Matrix6d to_pixels = scale.asDiagonal() * to_centre;
  Matrix6d covariance = to_pixels * pose.covariance * to_pixels.transpose();
  if (model_.continuous_symmetry) {
    Matrix6d to_camera = Matrix6d::Zero();
    to_camera.topLeftCorner<3, 3>() = rotation;
    to_camera.bottomRightCorner<3, 3>() = rotation;
    const auto free = FreeMotions(*model_.continuous_symmetry, centre_);
    const Eigen::Matrix<double, 6, Eigen::Dynamic> columns = scale.asDiagonal() * (to_camera * free);
    const Eigen::HouseholderQR<Eigen::Matrix<double, 6, Eigen::Dynamic>> qr(columns);
    const Matrix6d all = qr.householderQ();
    const auto basis = all.leftCols(columns.cols());
    const Matrix6d rest = Matrix6d::Identity() - basis * basis.transpose();
    covariance = rest * covariance * rest;
  }
  const Eigen::SelfAdjointEigenSolver<Matrix6d> solver(covariance, Eigen::EigenvaluesOnly);
  return std::sqrt(std::max(0.0, solver.eigenvalues().maxCoeff()));
}

}  // namespace evpose

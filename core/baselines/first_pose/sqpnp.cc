// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/sqpnp.h"

#include <limits>
#include <opencv2/calib3d.hpp>
#include <vector>

#include "absl/strings/str_cat.h"

namespace evpose {
namespace {

// Mean squared reprojection error, pixels^2; infinite if a point lies behind the camera.
double Residual(const CameraModel& camera, absl::Span<const PointMatch> matches, const RigidTransform& pose) {
  double sum = 0.0;
  for (const PointMatch& match : matches) {
    const Eigen::Vector3d point = pose * match.point;
    if (point.z() <= 0.0) return std::numeric_limits<double>::infinity();
    sum += (camera.Project(point) - match.pixel).squaredNorm();
  }
  return sum / static_cast<double>(matches.size());
}

std::vector<RigidTransform> Solve(const CameraModel& camera, absl::Span<const PointMatch> matches) {
  std::vector<cv::Point3d> points;
  std::vector<cv::Point2d> pixels;
  for (const PointMatch& match : matches) {
    points.emplace_back(match.point.x(), match.point.y(), match.point.z());
    pixels.emplace_back(match.pixel.x(), match.pixel.y());
  }
  const cv::Matx33d matrix(camera.fx_px, 0, camera.cx_px, 0, camera.fy_px, camera.cy_px, 0, 0, 1);
  std::vector<cv::Mat> rotations;
  std::vector<cv::Mat> translations;
  cv::solvePnPGeneric(points, pixels, matrix, cv::noArray(), rotations, translations, false, cv::SOLVEPNP_SQPNP);
  std::vector<RigidTransform> poses;
  for (size_t i = 0; i < rotations.size(); ++i) {
    const cv::Vec3d r = rotations[i];
    const cv::Vec3d t = translations[i];
    poses.push_back({ExpSo3({r[0], r[1], r[2]}), {t[0], t[1], t[2]}});
  }
  return poses;
}

}  // namespace

absl::StatusOr<RigidTransform> EstimatePoseBySqpnp(const CameraModel& camera, absl::Span<const PointMatch> matches) {
  if (matches.size() < 3) {
    return absl::InvalidArgumentError(absl::StrCat("SQPnP needs three points: there are ", matches.size()));
  }
  std::vector<RigidTransform> poses;
  try {
    poses = Solve(camera, matches);
  } catch (const cv::Exception& error) {
    return absl::NotFoundError(absl::StrCat("SQPnP: ", error.what()));
  }
  double best = std::numeric_limits<double>::infinity();
  const RigidTransform* chosen = nullptr;
  for (const RigidTransform& pose : poses) {
    const double residual = Residual(camera, matches, pose);
    if (!(residual < best)) continue;
    best = residual;
    chosen = &pose;
  }
  if (chosen == nullptr) return absl::NotFoundError("SQPnP: no pose in front of the camera");
  return *chosen;
}

}  // namespace evpose

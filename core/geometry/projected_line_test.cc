// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/projected_line.h"

#include <ceres/jet.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

namespace evpose {
namespace {

using Jet = ceres::Jet<double, 6>;
using JetVector = Eigen::Matrix<Jet, 3, 1>;

CameraModel TestCamera() {
  CameraModel camera;
  camera.width_px = 1280;
  camera.height_px = 720;
  camera.fx_px = 1020.0;
  camera.fy_px = 870.0;
  camera.cx_px = 655.0;
  camera.cy_px = 341.0;
  return camera;
}

class RandomScene {
 public:
  double Uniform(double low, double high) { return std::uniform_real_distribution<double>(low, high)(engine_); }
  Eigen::Vector3d Point(double scale) {
    return {Uniform(-scale, scale), Uniform(-scale, scale), Uniform(-scale, scale)};
  }
  RigidTransform Pose() { return {ExpSo3(Point(2.0)), {Uniform(-0.2, 0.2), Uniform(-0.2, 0.2), Uniform(0.05, 2.0)}}; }

 private:
  std::mt19937_64 engine_{7};
};

// The line's coefficients from the definition: the pixel line through the two images, divided by the length of its
// normal. xi enters to first order, which suffices for a derivative at 0.
JetVector LineByAutomaticDifferentiation(const CameraModel& camera, const RigidTransform& pose,
                                         const Eigen::Vector3d& p1, const Eigen::Vector3d& p2) {
  const Jet zero(0.0);
  const JetVector dt(Jet(0.0, 0), Jet(0.0, 1), Jet(0.0, 2));
  const JetVector dtheta(Jet(0.0, 3), Jet(0.0, 4), Jet(0.0, 5));
  const auto transform = [&](const Eigen::Vector3d& point) -> JetVector {
    const JetVector rotated = (pose.rotation * point).cast<Jet>();
    const JetVector translation = pose.translation_m.cast<Jet>();
    return rotated + dtheta.cross(rotated) + translation + dt;
  };
  const auto pixel = [&](const JetVector& point) -> JetVector {
    return {Jet(camera.fx_px) * point.x() + Jet(camera.cx_px) * point.z(),
            Jet(camera.fy_px) * point.y() + Jet(camera.cy_px) * point.z(), point.z()};
  };
  const JetVector line = pixel(transform(p1)).cross(pixel(transform(p2)));
  const Jet length = sqrt(line.x() * line.x() + line.y() * line.y());
  // d = line . (u, v, 1) / length with (u, v, 1) = K b, so a = K^T line / length.
  return {Jet(camera.fx_px) * line.x() / length, Jet(camera.fy_px) * line.y() / length,
          (Jet(camera.cx_px) * line.x() + Jet(camera.cy_px) * line.y() + line.z()) / length};
}

TEST(ProjectedLineTest, JacobianEqualsAutomaticDifferentiation) {
  const CameraModel camera = TestCamera();
  RandomScene random;
  int projected = 0, cut = 0;
  for (int i = 0; i < 20000; ++i) {
    const RigidTransform pose = random.Pose();
    const Eigen::Vector3d p1 = random.Point(0.5), p2 = random.Point(0.5);
    const auto line = ProjectLine(camera, pose, p1, p2);
    if (!line) continue;
    ++projected;
    cut += (pose * p1).z() < 1e-3 || (pose * p2).z() < 1e-3;
    const JetVector expected = LineByAutomaticDifferentiation(camera, pose, p1, p2);
    // The reference's own rounding grows where the image line is far away: a.z is then huge.
    for (int row = 0; row < 3; ++row) {
      EXPECT_NEAR(line->a[row], expected[row].a, 1e-9 * line->a.norm());
      EXPECT_LT((line->jacobian.row(row).transpose() - expected[row].v).norm(), 1e-9 * line->jacobian.norm());
    }
  }
  EXPECT_GT(projected, 10000);
  EXPECT_GT(cut, 1000);
}

TEST(ProjectedLineTest, VelocityJacobianEqualsDifferences) {
  const CameraModel camera = TestCamera();
  RandomScene random;
  for (int i = 0; i < 200; ++i) {
    const RigidTransform pose{ExpSo3(random.Point(2.0)), {0.1, -0.1, 1.5}};
    const Eigen::Vector3d p1 = random.Point(0.5), p2 = random.Point(0.5);
    Vector6d twist;
    twist << random.Point(1.0), random.Point(3.0);
    const Eigen::Matrix<double, 3, 6> jacobian = LineVelocityJacobian(camera, pose, p1, p2, twist);
    const auto velocity = [&](const Vector6d& xi) -> Eigen::Vector3d {
      return ProjectLine(camera, Perturb(pose, xi), p1, p2)->jacobian * twist;
    };
    for (int k = 0; k < 6; ++k) {
      constexpr double kStep = 1e-5;
      const Vector6d xi = kStep * Vector6d::Unit(k);
      const Eigen::Vector3d expected = (velocity(xi) - velocity(-xi)) / (2.0 * kStep);
      EXPECT_LT((jacobian.col(k) - expected).norm(), 1e-6 * jacobian.norm()) << "column " << k;
    }
  }
}

TEST(ProjectedLineTest, DistanceIsInPixels) {
  const CameraModel camera = TestCamera();
  RandomScene random;
  for (int i = 0; i < 1000; ++i) {
    const auto line =
        ProjectLine(camera, {ExpSo3(random.Point(2.0)), {0, 0, 1.5}}, random.Point(0.5), random.Point(0.5));
    ASSERT_TRUE(line);
    const Eigen::Vector2d direction = (line->p2_px - line->p1_px).normalized();
    const Eigen::Vector2d pixel{random.Uniform(0, 1280), random.Uniform(0, 720)};
    const Eigen::Vector3d bearing((pixel.x() - camera.cx_px) / camera.fx_px, (pixel.y() - camera.cy_px) / camera.fy_px,
                                  1);
    const Eigen::Vector2d offset = pixel - line->p1_px;
    const double cross = direction.x() * offset.y() - direction.y() * offset.x();
    EXPECT_NEAR(line->a.dot(bearing), cross, 1e-9 * std::max(1.0, offset.norm()));
  }
}

TEST(ProjectedLineTest, CutAtTheNearPlaneKeepsTheInfiniteLine) {
  const CameraModel camera = TestCamera();
  const Eigen::Vector3d front(0.1, 0.05, 1.0), further(0.05, 0.1, 0.4), behind(-0.1, 0.25, -1.4);
  const auto whole = ProjectLine(camera, {}, front, further);
  const auto cut = ProjectLine(camera, {}, front, behind, 0.01);
  ASSERT_TRUE(whole && cut);
  EXPECT_LT((whole->a - cut->a).norm(), 1e-9 * whole->a.norm());
  EXPECT_EQ(cut->p1_px, camera.Project(front));
  const Eigen::Vector3d expected = front + (1.0 - 0.01) / 2.4 * (behind - front);
  EXPECT_LT((cut->p2_px - camera.Project(expected)).norm(), 1e-6);
  const auto reversed = ProjectLine(camera, {}, behind, front, 0.01);
  ASSERT_TRUE(reversed);
  EXPECT_LT((reversed->a + cut->a).norm(), 1e-9 * cut->a.norm());
  EXPECT_EQ(reversed->p1_px, cut->p2_px);
}

TEST(ProjectedLineTest, NothingToProject) {
  const CameraModel camera = TestCamera();
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(ProjectLine(camera, {}, {0, 0, -1}, {1, 0, -2}));        // behind
  EXPECT_FALSE(ProjectLine(camera, {}, {-1, 0.1, 0}, {1, 0.1, 0}));     // in the plane z = 0
  EXPECT_FALSE(ProjectLine(camera, {}, {0.1, 0.2, 1}, {0.2, 0.4, 2}));  // parallel to the line of sight
  EXPECT_FALSE(ProjectLine(camera, {}, {0, 0, -1}, {0, 0, 1}));         // through the camera's centre
  EXPECT_FALSE(ProjectLine(camera, {}, {0.1, 0.2, 1}, {0.1, 0.2, 1}));  // no length
  EXPECT_FALSE(ProjectLine(camera, {}, {nan, 0, 1}, {1, 0, 1}));
  EXPECT_FALSE(ProjectLine(camera, {}, {0, 0, 1}, {1, 0, nan}));
}

// Speed in pixels per second at which the line passes the bearing b = (x, y, 1), positive to the side where d = a . b
// is positive. a . b stays 0 for a point on the moving line, so that its speed is a . b_dot = -a_dot . b.
double NormalVelocity(const ProjectedLine& line, const Vector6d& twist, const Eigen::Vector3d& bearing) {
  return -bearing.dot(line.jacobian * twist);
}

TEST(ProjectedLineTest, NormalVelocityIsTheSpeedOfAPointOnTheLine) {
  const CameraModel camera = TestCamera();
  RandomScene random;
  const double dt_s = 1e-6;
  for (int i = 0; i < 200; ++i) {
    const RigidTransform pose{ExpSo3(random.Point(2.0)), {0.1, -0.1, 1.5}};
    const Eigen::Vector3d p1 = random.Point(0.5), p2 = random.Point(0.5);
    Vector6d twist;
    twist << random.Point(1.0), random.Point(3.0);
    const auto line = ProjectLine(camera, pose, p1, p2);
    ASSERT_TRUE(line);

    const Eigen::Vector3d point = 0.3 * p1 + 0.7 * p2;
    const Eigen::Vector2d before = camera.Project(Perturb(pose, -dt_s * twist) * point);
    const Eigen::Vector2d after = camera.Project(Perturb(pose, dt_s * twist) * point);
    const Eigen::Vector2d normal(line->a.x() / camera.fx_px, line->a.y() / camera.fy_px);
    EXPECT_NEAR(normal.norm(), 1.0, 1e-12);
    const double expected = normal.dot(after - before) / (2 * dt_s);

    const Eigen::Vector3d camera_point = pose * point;
    EXPECT_NEAR(NormalVelocity(*line, twist, camera_point / camera_point.z()), expected,
                1e-4 * (1 + std::abs(expected)));
  }
}

TEST(ProjectedLineTest, NormalVelocityOfAKnownMotion) {
  CameraModel camera = TestCamera();
  // A vertical line from top to bottom, 2 m away, moving to the right at 1 m/s: fx / 2 px/s. The distance grows to the
  // left.
  const auto line = ProjectLine(camera, {}, {0, -1, 2}, {0, 1, 2});
  ASSERT_TRUE(line);
  Vector6d twist = Vector6d::Zero();
  twist[0] = 1.0;
  EXPECT_LT(line->a.dot(Eigen::Vector3d(0.1, 0, 1)), 0.0);
  EXPECT_NEAR(NormalVelocity(*line, twist, {0, 0, 1}), -0.5 * camera.fx_px, 1e-9);
}

}  // namespace
}  // namespace evpose

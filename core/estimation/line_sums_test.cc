// SPDX-License-Identifier: Apache-2.0

// Compares the equations from the sums with a plain loop over the events and automatic differentiation.
#include "core/estimation/line_sums.h"

#include <ceres/jet.h>
#include <gtest/gtest.h>

#include <vector>

#include "core/association/association.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

using testing::MakeCamera;
using testing::MakePose;
using Jet = ceres::Jet<double, 12>;
using Vector3J = Eigen::Matrix<Jet, 3, 1>;

// The symmetric matrix with this lower triangle.
Matrix12d Whole(const Matrix12d& lower) { return lower.selfadjointView<Eigen::Lower>(); }

struct TestEvent {
  double bx, by, tau_s, weight;
};

// a + tau a_dot of core/estimation/README.md, equation (6), from n = P1 x P2 and the velocities of the end points, at
// the left perturbation xi and the twist V. xi is included to first order, which suffices for the derivative at 0.
Vector3J LineAt(const CameraModel& camera, const MotionState& state, const TrackedLine& line, double tau_s) {
  Vector3J shift, turn, v, w;
  for (int k = 0; k < 3; ++k) {
    shift[k] = Jet(0.0, k);
    turn[k] = Jet(0.0, k + 3);
    v[k] = Jet(state.twist[k], k + 6);
    w[k] = Jet(state.twist[k + 3], k + 9);
  }
  Vector3J points[2], velocities[2];
  for (const int end : {0, 1}) {
    const Vector3J arm = (state.camera_from_object.rotation * (end == 0 ? line.p1 : line.p2)).cast<Jet>();
    const Vector3J turned = arm + turn.cross(arm);
    points[end] = turned + state.camera_from_object.translation_m.cast<Jet>() + shift;
    velocities[end] = v + w.cross(turned);
  }
  const Vector3J n = points[0].cross(points[1]);
  const Vector3J n_dot = velocities[0].cross(points[1]) + points[0].cross(velocities[1]);
  const Jet fx2(camera.fx_px * camera.fx_px), fy2(camera.fy_px * camera.fy_px);
  const Jet rho = sqrt(n.x() * n.x() / fx2 + n.y() * n.y() / fy2);
  const Jet rho_dot = (n.x() * n_dot.x() / fx2 + n.y() * n_dot.y() / fy2) / rho;
  return n / rho + Jet(tau_s) * (n_dot / rho - n * (rho_dot / (rho * rho)));
}

TEST(LineSums, NormalEquationsEqualAutomaticDifferentiation) {
  CameraModel camera = MakeCamera(1280, 720, 1000.0);
  camera.fy_px = 980.0;
  MotionState state;
  state.camera_from_object = MakePose({0.05, -0.03, 0.8}, {0.4, -0.7, 0.2});
  state.twist << 0.3, -0.2, 0.1, 1.0, -2.0, 0.5;
  const TrackedLine line{0, {-0.07, 0.03, 0.07}, {0.07, 0.02, -0.05}};
  std::vector<ImageLine> image;
  ProjectLines(camera, state, {line}, image);
  ProjectVelocityJacobians(camera, state, {line}, absl::MakeSpan(image));

  Random random(1);
  std::vector<TestEvent> events;
  LineSums sums;
  for (int i = 0; i < 200; ++i) {
    const TestEvent event{random.Uniform(-0.2, 0.2), random.Uniform(-0.2, 0.2), random.Uniform(-5e-3, 5e-3),
                          random.Uniform()};
    events.push_back(event);
    sums.Add(event.bx, event.by, event.tau_s, event.weight);
  }
  Matrix12d hessian = Matrix12d::Zero();
  Vector12d gradient = Vector12d::Zero();
  LineEquations(sums, image[0], 1.0).AddTo(&hessian, gradient);
  hessian = Whole(hessian);

  Matrix12d expected_hessian = Matrix12d::Zero();
  Vector12d expected_gradient = Vector12d::Zero();
  for (const TestEvent& event : events) {
    const Vector3J a = LineAt(camera, state, line, event.tau_s);
    const Jet distance = a.x() * event.bx + a.y() * event.by + a.z();
    const Vector12d row = distance.v;
    const double d = distance.a;
    expected_hessian += event.weight * row * row.transpose();
    expected_gradient += event.weight * row * d;
  }
  EXPECT_LT((hessian - expected_hessian).norm(), 1e-8 * expected_hessian.norm());
  EXPECT_LT((gradient - expected_gradient).norm(), 1e-8 * expected_gradient.norm());
  EXPECT_NEAR(sums.weight(), sums.Moment(0)(2, 2), 1e-12);
}

// Marginalising the displacement gives the same pose as a joint estimate of pose and displacement.
TEST(LineSums, ADisplacementIsMarginalised) {
  const CameraModel camera = MakeCamera(1280, 720, 1000.0);
  MotionState state;
  state.camera_from_object = MakePose({0.05, -0.03, 0.8}, {0.4, -0.7, 0.2});
  state.twist << 0.3, -0.2, 0.1, 1.0, -2.0, 0.5;
  std::vector<ImageLine> image;
  const TrackedLine tracked = {0, {-0.07, 0.03, 0.07}, {0.07, 0.02, -0.05}};
  ProjectLines(camera, state, {tracked}, image);
  ProjectVelocityJacobians(camera, state, {tracked}, absl::MakeSpan(image));
  const ImageLine& line = image[0];
  LineDisplacement displacement;
  displacement.basis << 0.0, 3.0, 0.0, -2.0, 1.0, 0.25;
  displacement.sigma_px = 0.3;
  constexpr double kScale = 4.0;

  Random random(2);
  LineSums sums;
  Eigen::Matrix<double, 14, 14> joint = Eigen::Matrix<double, 14, 14>::Zero();
  Eigen::Matrix<double, 14, 1> joint_gradient = Eigen::Matrix<double, 14, 1>::Zero();
  for (int i = 0; i < 200; ++i) {
    const Eigen::Vector3d bearing{random.Uniform(-0.2, 0.2), random.Uniform(-0.2, 0.2), 1.0};
    const double tau_s = random.Uniform(-5e-3, 5e-3);
    const double weight = random.Uniform();
    sums.Add(bearing.x(), bearing.y(), tau_s, weight);
    Eigen::Matrix<double, 14, 1> row;
    row << (line.jacobian + tau_s * line.a_dot_jacobian).transpose() * bearing,
        tau_s * line.jacobian.transpose() * bearing, displacement.basis.transpose() * bearing;
    joint += kScale * weight * row * row.transpose();
    joint_gradient += kScale * weight * (line.a + tau_s * line.a_dot).dot(bearing) * row;
  }
  // Independent ends: the prior of (middle, half of the difference).
  joint.bottomRightCorner<2, 2>().diagonal().array() += 2.0 / (0.3 * 0.3);
  const Eigen::Matrix<double, 12, 2> cross = joint.topRightCorner<12, 2>();
  const Eigen::Matrix2d inverse = joint.bottomRightCorner<2, 2>().inverse();
  const Matrix12d expected = joint.topLeftCorner<12, 12>() - cross * inverse * cross.transpose();
  const Vector12d expected_gradient = joint_gradient.head<12>() - cross * (inverse * joint_gradient.tail<2>());

  Matrix12d hessian = Matrix12d::Zero();
  Vector12d gradient = Vector12d::Zero();
  LineEquations equations(sums, line, kScale);
  Matrix12d before = Matrix12d::Zero();
  equations.AddTo(&before, gradient);
  Vector12d gradient_alone = Vector12d::Zero();
  equations.AddTo(nullptr, gradient_alone);
  EXPECT_EQ(gradient_alone, gradient);
  gradient.setZero();
  equations.Marginalise(displacement);
  equations.AddTo(&hessian, gradient);
  hessian = Whole(hessian);
  EXPECT_LT((hessian - expected).norm(), 1e-9 * expected.norm());
  EXPECT_LT((gradient - expected_gradient).norm(), 1e-9 * joint_gradient.norm());
  const double left = (hessian.topLeftCorner<6, 6>()).trace() / (before.topLeftCorner<6, 6>()).trace();
  EXPECT_LT(left, 0.5) << "the displacement matters here";
}

// The elements of an arc share one displacement. The events are on their elements, where the Jacobian is exact.
TEST(LineSums, ADisplacementOfAnArcIsMarginalisedOnce) {
  const CameraModel camera = MakeCamera(1280, 720, 1000.0);
  MotionState state;
  state.camera_from_object = MakePose({0.05, -0.03, 0.8}, {0.4, -0.7, 0.2});
  state.twist << 0.3, -0.2, 0.1, 1.0, -2.0, 0.5;
  const std::vector<TrackedLine> tracked = {{0, {-0.07, 0.03, 0.07}, {0.0, 0.025, 0.01}},
                                            {0, {0.0, 0.025, 0.01}, {0.07, 0.0, -0.05}}};
  std::vector<ImageLine> image;
  ProjectLines(camera, state, tracked, image);
  constexpr double kScale = 4.0, kSigmaPx = 0.3;
  Random random(2);
  Eigen::Matrix<double, 14, 14> joint = Eigen::Matrix<double, 14, 14>::Zero();
  Eigen::Matrix<double, 14, 1> joint_gradient = Eigen::Matrix<double, 14, 1>::Zero();
  ArcEquations equations;
  const double arc_px = image[0].length_px + image[1].length_px;
  double begin_px = 0.0;
  for (ImageLine& line : image) {
    line.a_expected.z() += 0.7;
    const double half_length = line.length_px / arc_px;
    const double position = 2.0 * begin_px / arc_px - 1.0 + half_length;
    begin_px += line.length_px;
    LineSums sums;
    for (int i = 0; i < 100; ++i) {
      const double along = random.Uniform(-1.0, 1.0);
      const Eigen::Vector3d bearing = BearingOf(camera, line.PointAt(0.5 + 0.5 * along));
      const double tau_s = random.Uniform(-5e-3, 5e-3), weight = random.Uniform();
      sums.Add(bearing.x(), bearing.y(), tau_s, weight);
      Eigen::Matrix<double, 14, 1> row;
      row << line.jacobian.transpose() * bearing, tau_s * line.jacobian.transpose() * bearing, 1.0,
          position + half_length * along;
      joint += kScale * weight * row * row.transpose();
      joint_gradient += kScale * weight * (line.a_expected + tau_s * line.a_dot).dot(bearing) * row;
    }
    equations.Add(camera, sums, line, kScale, position, half_length);
  }
  Matrix12d hessian = Matrix12d::Zero();
  Vector12d gradient = Vector12d::Zero();
  equations.AddTo(kSigmaPx, &hessian, gradient);
  hessian = Whole(hessian);
  Vector12d gradient_alone = Vector12d::Zero();
  equations.AddTo(kSigmaPx, nullptr, gradient_alone);
  EXPECT_EQ(gradient_alone, gradient);
  joint.bottomRightCorner<2, 2>().diagonal().array() += 2.0 / (kSigmaPx * kSigmaPx);
  const Eigen::Matrix<double, 12, 2> cross = joint.topRightCorner<12, 2>();
  const Eigen::Matrix2d inverse = joint.bottomRightCorner<2, 2>().inverse();
  const Matrix12d expected = joint.topLeftCorner<12, 12>() - cross * inverse * cross.transpose();
  const Vector12d expected_gradient = joint_gradient.head<12>() - cross * (inverse * joint_gradient.tail<2>());
  EXPECT_LT((hessian - expected).norm(), 1e-9 * expected.norm());
  EXPECT_LT((gradient - expected_gradient).norm(), 1e-9 * joint_gradient.norm());
}

}  // namespace
}  // namespace evpose

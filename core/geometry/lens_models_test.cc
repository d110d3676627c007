// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/lens_models.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <opencv2/calib3d.hpp>
#include <string>
#include <vector>

namespace evpose {
namespace {

struct Lens {
  LensModel model;
  Distortion distortion;
  double largest_tangent;  // of the directions that are tested
};

const std::vector<Lens>& Lenses() {
  static const auto& lenses = *new std::vector<Lens>{
      {LensModel::kBrown, {-0.35, 0.15, 0.001, -0.0007, -0.03}, 0.9},
      {LensModel::kBrown, {0.2, -0.05, -0.002, 0.001, 0.0}, 0.9},
      // A lens of 120 degrees, as the calibration of a depth camera gives it.
      {LensModel::kRational, {0.42, -2.1, 0.0007, -0.0003, 1.4, 0.31, -1.95, 1.33}, 0.9},
      {LensModel::kRational, {3.2, 1.1, 1e-4, -2e-4, 0.03, 3.5, 2.0, 0.25}, 1.8},
      {LensModel::kFisheye, {0, 0, 0, 0}, 11.0},
      {LensModel::kFisheye, {-0.02, 0.006, -0.004, 0.0006}, 6.0},
      {LensModel::kFisheye, {0.08, -0.01, 0.003, 0.0}, 11.0},
  };
  return lenses;
}

class LensModelsTest : public ::testing::TestWithParam<int> {
 protected:
  const Lens lens_ = Lenses()[GetParam()];

  std::vector<Eigen::Vector2d> Points() const {
    std::vector<Eigen::Vector2d> points = {{0.0, 0.0}, {1e-13, 0.0}};
    for (int ring = 1; ring <= 10; ++ring) {
      for (int turn = 0; turn < 12; ++turn) {
        const double angle = std::atan(lens_.largest_tangent) * ring / 10.0;
        const double around = 0.1 + turn * 0.5236;
        points.emplace_back(std::tan(angle) * std::cos(around), std::tan(angle) * std::sin(around));
      }
    }
    return points;
  }
  DistortedPoint Distort(const Eigen::Vector2d& point) const {
    return DistortNormalised(lens_.model, lens_.distortion, point);
  }
};

TEST_P(LensModelsTest, EqualsOpenCv) {
  std::vector<cv::Point2d> directions;
  std::vector<cv::Point3d> points;
  for (const Eigen::Vector2d& point : Points()) {
    directions.emplace_back(point.x(), point.y());
    points.emplace_back(point.x(), point.y(), 1.0);
  }
  const std::vector<double> coefficients(lens_.distortion.begin(),
                                         lens_.distortion.begin() + NumCoefficients(lens_.model));
  std::vector<cv::Point2d> expected;
  if (lens_.model == LensModel::kFisheye) {
    cv::fisheye::distortPoints(directions, expected, cv::Matx33d::eye(), coefficients);
  } else {
    cv::projectPoints(points, cv::Vec3d(), cv::Vec3d(), cv::Matx33d::eye(), coefficients, expected);
  }
  for (size_t i = 0; i < directions.size(); ++i) {
    const DistortedPoint distorted = Distort({directions[i].x, directions[i].y});
    EXPECT_TRUE(distorted.is_regular) << directions[i];
    EXPECT_NEAR(distorted.point.x(), expected[i].x, 1e-12);
    EXPECT_NEAR(distorted.point.y(), expected[i].y, 1e-12);
  }
}

TEST_P(LensModelsTest, JacobianIsTheDerivative) {
  for (const Eigen::Vector2d& point : Points()) {
    const DistortedPoint distorted = Distort(point);
    const double step = 1e-6;
    const Eigen::Vector2d by_x =
        (Distort(point + Eigen::Vector2d(step, 0)).point - Distort(point - Eigen::Vector2d(step, 0)).point) /
        (2.0 * step);
    const Eigen::Vector2d by_y =
        (Distort(point + Eigen::Vector2d(0, step)).point - Distort(point - Eigen::Vector2d(0, step)).point) /
        (2.0 * step);
    EXPECT_NEAR(distorted.xx, by_x.x(), 1e-8) << point.transpose();
    EXPECT_NEAR(distorted.xy, by_x.y(), 1e-8);
    EXPECT_NEAR(distorted.xy, by_y.x(), 1e-8);
    EXPECT_NEAR(distorted.yy, by_y.y(), 1e-8);
  }
}

TEST_P(LensModelsTest, UndistortInverts) {
  for (const Eigen::Vector2d& point : Points()) {
    const auto back = UndistortNormalised(lens_.model, lens_.distortion, Distort(point).point);
    ASSERT_TRUE(back.has_value()) << point.transpose();
    // One unit of rounding in the distorted point is larger in the point itself, far from the axis.
    EXPECT_LT((*back - point).norm(), 1e-9 * (1.0 + point.squaredNorm()));
  }
}

INSTANTIATE_TEST_SUITE_P(All, LensModelsTest, ::testing::Range(0, 7));

TEST(LensModelsTest, BeyondAFoldThereIsNoDirection) {
  // r (1 - r^2) grows up to r = 0.577, where it is 0.385.
  const Distortion folded = {-1.0};
  EXPECT_TRUE(UndistortNormalised(LensModel::kBrown, folded, {0.38, 0.0}).has_value());
  EXPECT_FALSE(UndistortNormalised(LensModel::kBrown, folded, {0.39, 0.0}).has_value());
  EXPECT_FALSE(DistortNormalised(LensModel::kBrown, folded, {0.6, 0.0}).is_regular);
  // t (1 - 0.3 t^2) grows up to t = 1.054.
  const Distortion fisheye = {-0.3};
  EXPECT_TRUE(DistortNormalised(LensModel::kFisheye, fisheye, {std::tan(1.05), 0.0}).is_regular);
  EXPECT_FALSE(DistortNormalised(LensModel::kFisheye, fisheye, {std::tan(1.06), 0.0}).is_regular);
  EXPECT_FALSE(UndistortNormalised(LensModel::kFisheye, fisheye, {0.71, 0.0}).has_value());
  // Behind the pole of the radial factor, at r = 1, the image is mirrored.
  const Distortion pole = {0, 0, 0, 0, 0, -1.0};
  EXPECT_TRUE(DistortNormalised(LensModel::kRational, pole, {0.9, 0.0}).is_regular);
  EXPECT_FALSE(DistortNormalised(LensModel::kRational, pole, {1.1, 0.0}).is_regular);
}

TEST(LensModelsTest, SecondBranches) {
  // The slope 1 - 1.5 r^2 + 0.5 r^4 is zero at r = 1 and sqrt(2).
  EXPECT_NEAR(SecondBranchRadius(LensModel::kBrown, {-0.5, 0.1, 0.01, 0.01}), std::sqrt(2.0), 1e-3);
  // Poles at r = 1 and sqrt(2); the image between them is mirrored, and beyond sqrt(2) the factor first decreases from
  // infinity. The slope of r (1 + 0.1 r^6) / (1 - 1.5 r^2 + 0.5 r^4) is positive again far outside.
  EXPECT_GT(SecondBranchRadius(LensModel::kRational, {0, 0, 0, 0, 0.1, -1.5, 0.5}), std::sqrt(2.0));
  EXPECT_LT(SecondBranchRadius(LensModel::kRational, {0, 0, 0, 0, 0.1, -1.5, 0.5}), 5.0);
  // With s = t^2, the slope 1 - 2.7 s + 1.5 s^2 is zero at s = 0.52 and 1.28.
  EXPECT_NEAR(SecondBranchRadius(LensModel::kFisheye, {-0.9, 0.3}),
              std::tan(std::sqrt(0.9 + std::sqrt(0.81 - 2.0 / 3.0))), 3e-3);
  for (const Lens& lens : Lenses()) EXPECT_GT(SecondBranchRadius(lens.model, lens.distortion), lens.largest_tangent);
  EXPECT_EQ(SecondBranchRadius(LensModel::kFisheye, {}), std::numeric_limits<double>::infinity());
}

TEST(LensModelsTest, AFisheyeLensEndsAt85Degrees) {
  const double edge = 85.0 / 180.0 * M_PI;
  EXPECT_TRUE(DistortNormalised(LensModel::kFisheye, {}, {std::tan(edge - 1e-6), 0.0}).is_regular);
  EXPECT_FALSE(DistortNormalised(LensModel::kFisheye, {}, {std::tan(edge + 1e-6), 0.0}).is_regular);
  EXPECT_TRUE(UndistortNormalised(LensModel::kFisheye, {}, {0.0, edge - 1e-6}).has_value());
  EXPECT_FALSE(UndistortNormalised(LensModel::kFisheye, {}, {0.0, edge + 1e-6}).has_value());
  EXPECT_FALSE(UndistortNormalised(LensModel::kFisheye, {}, {3.0, 3.0}).has_value());
}

}  // namespace
}  // namespace evpose

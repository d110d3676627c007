// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/synthetic/synthetic_trial.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>

#include "core/geometry/projected_line.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

double DistancePx(const SyntheticTrial& trial, const RigidTransform& pose, size_t event, int line) {
  const auto projected = ProjectLine(trial.camera, pose, trial.lines[line].p1, trial.lines[line].p2);
  return projected->a.dot(Eigen::Vector3d(trial.events[event].bx, trial.events[event].by, 1.0));
}

TEST(SyntheticTrialTest, LinesAreInTheImageAndTheDepthRange) {
  SyntheticTrialOptions options;
  options.num_lines = 200;
  const SyntheticTrial trial = MakeSyntheticTrial(options, 1);
  ASSERT_EQ(trial.lines.size(), 200u);
  double nearest_m = 100.0, farthest_m = 0.0;
  for (const LineEnds& line : trial.lines) {
    for (const Eigen::Vector3d& end : {line.p1, line.p2}) {
      const Eigen::Vector3d point = trial.camera_from_object * end;
      nearest_m = std::min(nearest_m, point.z());
      farthest_m = std::max(farthest_m, point.z());
      EXPECT_TRUE(trial.camera.IsInImage(trial.camera.Project(point)));
    }
  }
  EXPECT_GE(nearest_m, 5.0);
  EXPECT_LT(nearest_m, 5.2);
  EXPECT_LE(farthest_m, 10.0);
  EXPECT_GT(farthest_m, 9.8);
}

TEST(SyntheticTrialTest, NoiseIsNormalAboutTheTrueLines) {
  SyntheticTrialOptions options;
  options.noise_px = 3.0;
  options.outlier_ratio = 0.3;
  const SyntheticTrial trial = MakeSyntheticTrial(options, 2);
  ASSERT_EQ(trial.events.size(), 2500u);
  double sum = 0.0, squares = 0.0, fourth_powers = 0.0;
  for (size_t i = 0; i < trial.events.size(); ++i) {
    const double d = DistancePx(trial, trial.camera_from_object, i, trial.true_line[i]);
    sum += d;
    squares += d * d;
    fourth_powers += d * d * d * d;
  }
  // Four standard deviations of each quantity.
  EXPECT_NEAR(sum / 2500.0, 0.0, 4.0 * 3.0 / 50.0);
  EXPECT_NEAR(std::sqrt(squares / 2500.0), 3.0, 4.0 * 3.0 / std::sqrt(5000.0));
  EXPECT_NEAR(fourth_powers / 2500.0 / 81.0, 3.0, 4.0 * std::sqrt(96.0 / 2500.0));
}

TEST(SyntheticTrialTest, TheNumberOfOutliersIsExact) {
  for (const double ratio : {0.0, 0.02, 0.5, 1.0}) {
    SyntheticTrialOptions options;
    options.outlier_ratio = ratio;
    const SyntheticTrial trial = MakeSyntheticTrial(options, 3);
    int num_outliers = 0;
    for (size_t i = 0; i < trial.events.size(); ++i) num_outliers += trial.events[i].line != trial.true_line[i];
    EXPECT_EQ(num_outliers, std::lround(2500 * ratio));
  }
}

TEST(SyntheticTrialTest, SeedsAndOptions) {
  SyntheticTrialOptions options;
  const SyntheticTrial trial = MakeSyntheticTrial(options, 4);
  const SyntheticTrial same = MakeSyntheticTrial(options, 4);
  const SyntheticTrial other = MakeSyntheticTrial(options, 5);
  EXPECT_EQ(trial.events.back().bx, same.events.back().bx);
  EXPECT_NE(trial.events.back().bx, other.events.back().bx);
  EXPECT_NE(trial.camera_from_object.translation_m, other.camera_from_object.translation_m);
  options.noise_px = 0.0;
  options.outlier_ratio = 0.4;
  const SyntheticTrial clean = MakeSyntheticTrial(options, 4);
  EXPECT_EQ(trial.lines[7].p2, clean.lines[7].p2);
  EXPECT_EQ(trial.start.translation_m, clean.start.translation_m);
  for (size_t i = 0; i < clean.events.size(); ++i) {
    EXPECT_NEAR(DistancePx(clean, clean.camera_from_object, i, clean.true_line[i]), 0.0, 1e-9);
  }
}

TEST(SyntheticTrialTest, StartIsTheTruthMovedByTheGivenAmount) {
  SyntheticTrialOptions options;
  double farthest_rad = 0.0, farthest_ratio = 0.0;
  for (uint64_t seed = 0; seed < 100; ++seed) {
    const SyntheticTrial trial = MakeSyntheticTrial(options, seed);
    const Vector6d moved = Difference(trial.start, trial.camera_from_object);
    farthest_rad = std::max(farthest_rad, moved.tail<3>().lpNorm<Eigen::Infinity>());
    farthest_ratio = std::max(
        farthest_ratio, moved.head<3>().lpNorm<Eigen::Infinity>() / trial.camera_from_object.translation_m.norm());
  }
  EXPECT_LE(farthest_rad, 0.02 * (1.0 + 1e-9));
  EXPECT_GT(farthest_rad, 0.019);
  EXPECT_LE(farthest_ratio, 0.01 * (1.0 + 1e-9));
  EXPECT_GT(farthest_ratio, 0.0095);
}

TEST(SyntheticTrialTest, ErrorsAreThePapers) {
  const SyntheticTrial trial = MakeSyntheticTrial({}, 6);
  const RigidTransform& truth = trial.camera_from_object;
  const RigidTransform turned = {ExpSo3({0.0, 0.03, 0.0}) * truth.rotation, 1.01 * truth.translation_m};
  const SyntheticError error = CompareWithTruth(trial, turned);
  EXPECT_NEAR(error.rotation_deg, 0.03 * 180.0 / M_PI, 1e-9);
  EXPECT_NEAR(error.translation_ratio, 0.01, 1e-12);
}

TEST(SyntheticTrialTest, InformationIsThatOfTheDistances) {
  SyntheticTrialOptions options;
  options.num_lines = 5;
  options.events_per_line = 8;
  options.outlier_ratio = 0.25;
  // The noise is so small that the positions on the lines are those of the events.
  options.noise_px = 1e-4;
  const SyntheticTrial trial = MakeSyntheticTrial(options, 7);
  const absl::StatusOr<SyntheticBound> bound = ComputeSyntheticBound(trial);
  ASSERT_TRUE(bound.ok()) << bound.status();
  Matrix6d expected = Matrix6d::Zero();
  for (size_t i = 0; i < trial.events.size(); ++i) {
    if (trial.events[i].line != trial.true_line[i]) continue;
    Vector6d gradient;
    for (int k = 0; k < 6; ++k) {
      const Vector6d step = 1e-6 * Vector6d::Unit(k);
      gradient[k] = (DistancePx(trial, Perturb(trial.camera_from_object, step), i, trial.true_line[i]) -
                     DistancePx(trial, Perturb(trial.camera_from_object, -step), i, trial.true_line[i])) /
                    2e-6;
    }
    expected += gradient * gradient.transpose() / (options.noise_px * options.noise_px);
  }
  EXPECT_LT((bound->information - expected).norm(), 1e-5 * expected.norm());
}

TEST(SyntheticTrialTest, EfficientErrorHasTheBoundsCovariance) {
  SyntheticTrialOptions options;
  options.outlier_ratio = 0.3;
  constexpr int kTrials = 400;
  double sum = 0.0;
  Vector6d mean = Vector6d::Zero();
  for (uint64_t seed = 0; seed < kTrials; ++seed) {
    const absl::StatusOr<SyntheticBound> bound = ComputeSyntheticBound(MakeSyntheticTrial(options, seed));
    ASSERT_TRUE(bound.ok()) << bound.status();
    sum += bound->efficient_error.dot(bound->information * bound->efficient_error);
    mean += bound->information.llt().matrixU() * bound->efficient_error / kTrials;
  }
  // Chi-square with six degrees of freedom, and standard normal: four standard deviations of the means.
  EXPECT_NEAR(sum / kTrials, 6.0, 4.0 * std::sqrt(12.0 / kTrials));
  EXPECT_LT(mean.lpNorm<Eigen::Infinity>(), 4.0 / std::sqrt(kTrials));
}

TEST(SyntheticTrialTest, EfficientErrorIsOneStepFromTheTruth) {
  SyntheticTrialOptions options;
  options.noise_px = 0.01;
  options.outlier_ratio = 0.2;
  const SyntheticTrial trial = MakeSyntheticTrial(options, 8);
  const absl::StatusOr<SyntheticBound> bound = ComputeSyntheticBound(trial);
  ASSERT_TRUE(bound.ok());
  const auto squares = [&](const Vector6d& moved) {
    double sum = 0.0;
    for (size_t i = 0; i < trial.events.size(); ++i) {
      if (trial.events[i].line != trial.true_line[i]) continue;
      const double d = DistancePx(trial, Perturb(trial.camera_from_object, moved), i, trial.true_line[i]);
      sum += d * d;
    }
    return sum;
  };
  const double at_estimate = squares(bound->efficient_error);
  for (int k = 0; k < 6; ++k) {
    for (const double side : {-0.1, 0.1}) {
      const double sigma = std::sqrt(bound->information.inverse()(k, k));
      EXPECT_LT(at_estimate, squares(bound->efficient_error + side * sigma * Vector6d::Unit(k)));
    }
  }
}

TEST(SyntheticTrialTest, NoBoundWithoutNoiseOrWithoutEvents) {
  SyntheticTrialOptions options;
  options.noise_px = 0.0;
  EXPECT_EQ(ComputeSyntheticBound(MakeSyntheticTrial(options, 9)).status().code(),
            absl::StatusCode::kFailedPrecondition);
  options.noise_px = 2.0;
  options.outlier_ratio = 1.0;
  EXPECT_THAT(ComputeSyntheticBound(MakeSyntheticTrial(options, 9)).status().message(), HasSubstr("determine"));
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/evaluation/evaluate.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "core/models/continuous_symmetry.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

constexpr double kDegree = M_PI / 180.0;

StampedPose Pose(int64_t t_us, const Eigen::Vector3d& t, const Eigen::Vector3d& rotation = Eigen::Vector3d::Zero()) {
  return {t_us, {ExpSo3(rotation), t}};
}

// The object is at rest 2 m in front of the camera for 100 ms.
Trajectory TruthAtRest() { return {Pose(0, {0, 0, 2}), Pose(100'000, {0, 0, 2})}; }

Evaluation EvaluateOk(const Trajectory& truth, const Trajectory& estimate, const EvaluationOptions& options = {}) {
  const auto evaluation = Evaluate(truth, estimate, options);
  EXPECT_TRUE(evaluation.ok()) << evaluation.status();
  return evaluation.value_or(Evaluation{});
}

TEST(Evaluate, StatisticsEqualThoseComputedByHand) {
  Trajectory estimate;
  const double degrees[] = {0, 1, 2, 3, 10};
  for (int i = 0; i < 5; ++i) {
    estimate.push_back(Pose(int64_t{20'000} * i, {0.01 * i, 0, 2}, {0, 0, degrees[i] * kDegree}));
  }
  const Evaluation e = EvaluateOk(TruthAtRest(), estimate);
  EXPECT_EQ(e.num_poses, 5u);
  EXPECT_NEAR(e.position_mean_m, 0.02, 1e-12);
  EXPECT_NEAR(e.position_median_m, 0.02, 1e-12);
  EXPECT_NEAR(e.position_rmse_m, 0.01 * std::sqrt(6.0), 1e-12);  // (0 + 1 + 4 + 9 + 16) / 5 = 6
  EXPECT_NEAR(e.position_std_m, 0.01 * std::sqrt(2.0), 1e-12);   // 6 - 2^2
  EXPECT_NEAR(e.position_rmse_of_depth, 0.005 * std::sqrt(6.0), 1e-12);
  EXPECT_NEAR(e.rotation_mean_rad, 3.2 * kDegree, 1e-9);
  EXPECT_NEAR(e.rotation_median_rad, 2.0 * kDegree, 1e-9);
  EXPECT_NEAR(e.rotation_p95_rad, 8.6 * kDegree, 1e-9);  // at 3.8 of 4: 3 + 0.8 (10 - 3)
  EXPECT_NEAR(e.rotation_max_rad, 10.0 * kDegree, 1e-9);
  EXPECT_NEAR(e.pose_rate_hz, 50.0, 1e-9);
  EXPECT_FALSE(e.reprojection_mean_px.has_value());
}

TEST(Evaluate, MedianOfAnEvenNumber) {
  const Evaluation e = EvaluateOk(
      TruthAtRest(), {Pose(0, {0, 0, 2}), Pose(1, {0.01, 0, 2}), Pose(2, {0.03, 0, 2}), Pose(3, {0.09, 0, 2})});
  EXPECT_NEAR(e.position_median_m, 0.02, 1e-12);
}

TEST(Evaluate, TruthIsInterpolatedAndDepthIsTheTrueOne) {
  const Trajectory truth = {Pose(0, {0, 0, 1}), Pose(100'000, {0.1, 0, 3})};
  EXPECT_NEAR(EvaluateOk(truth, {Pose(25'000, {0.025, 0, 1.5})}).position_rmse_m, 0.0, 1e-12);
  const Evaluation e = EvaluateOk(truth, {Pose(25'000, {0.025, 0.015, 1.5}), Pose(100'000, {0.1, 0.03, 3})});
  EXPECT_NEAR(e.position_rmse_of_depth, 0.01, 1e-12);
}

TEST(Evaluate, CoverageAndLosses) {
  EvaluationOptions options;
  options.max_gap_us = 10'000;
  const Eigen::Vector3d good(0, 0, 2), far(0.2, 0, 2);
  // Good for [10, 20), bad for [20, 30), good for [30, 35) and [35, 45) and then a gap, good for [90, 100).
  const Trajectory estimate = {Pose(10'000, good), Pose(20'000, far), Pose(30'000, good), Pose(35'000, good),
                               Pose(90'000, good)};
  const Evaluation e = EvaluateOk(TruthAtRest(), estimate, options);
  EXPECT_NEAR(e.coverage_ratio, 0.35, 1e-12);
  EXPECT_EQ(e.losses, 2u);
  // The end of the truth ends the last good period without a loss; a gap limit that is 1 ms shorter adds a loss.
  options.max_gap_us = 9'000;
  EXPECT_EQ(EvaluateOk(TruthAtRest(), estimate, options).losses, 3u);
}

TEST(Evaluate, AmbiguousEstimatesAreNeitherTrackedNorLost) {
  EvaluationOptions options;
  options.max_gap_us = 10'000;
  const Eigen::Vector3d good(0, 0, 2);
  // Good for [10, 20), ambiguous for [20, 40), good for [40, 50), ambiguous for [50, 60) and then a gap, which ends the
  // period that was good.
  const Trajectory estimate = {Pose(10'000, good), Pose(40'000, good)};
  const std::vector<int64_t> ambiguous_us = {20'000, 30'000, 50'000};
  const auto e = Evaluate(TruthAtRest(), estimate, options, nullptr, nullptr, ambiguous_us);
  ASSERT_TRUE(e.ok()) << e.status();
  EXPECT_EQ(e->num_poses, 2u);
  EXPECT_NEAR(e->coverage_ratio, 0.2, 1e-12);
  EXPECT_NEAR(e->ambiguous_ratio, 0.3, 1e-12);
  EXPECT_THAT(e->losses_at_us, ::testing::ElementsAre(40'000));
  // Without them, the first good period ends, too.
  EXPECT_THAT(EvaluateOk(TruthAtRest(), estimate, options).losses_at_us, ::testing::ElementsAre(10'000, 40'000));
}

TEST(Evaluate, AmbiguousEstimatesAlone) {
  const auto e = Evaluate(TruthAtRest(), {}, {}, nullptr, nullptr, std::vector<int64_t>{0, 20'000, 40'000});
  ASSERT_TRUE(e.ok()) << e.status();
  EXPECT_EQ(e->num_poses, 0u);
  EXPECT_EQ(e->losses, 0u);
  EXPECT_NEAR(e->ambiguous_ratio, 0.6, 1e-12);
}

TEST(Evaluate, GoodMeansPositionAndRotation) {
  const auto coverage = [](const StampedPose& pose) {
    EvaluationOptions options;
    options.max_gap_us = 100'000;
    return EvaluateOk(TruthAtRest(), {pose}, options).coverage_ratio;
  };
  EXPECT_EQ(coverage(Pose(0, {0.099, 0, 2}, {0.17, 0, 0})), 1.0);
  EXPECT_EQ(coverage(Pose(0, {0.101, 0, 2}, {0.17, 0, 0})), 0.0);
  EXPECT_EQ(coverage(Pose(0, {0.099, 0, 2}, {0.18, 0, 0})), 0.0);
}

TEST(Evaluate, ReprojectionOfEndPoints) {
  CameraModel camera;
  camera.width_px = 400;
  camera.height_px = 300;
  camera.fx_px = camera.fy_px = 1000.0;
  ObjectModel model;
  model.lines.push_back({{0, 0, 0}, {0.1, 0, 0}, {}});
  model.lines.push_back({{0, 0, 0}, {0, 0, -1}, {}});  // its far end is at a distance of 1 m
  const auto reprojection = [&](const Trajectory& truth, const StampedPose& pose) {
    return Evaluate(truth, {pose}, {}, &model, &camera)->reprojection_mean_px.value();
  };
  // 10 mm correspond to 5 px at 2 m and to 10 px at 1 m.
  EXPECT_NEAR(reprojection(TruthAtRest(), Pose(0, {0.01, 0, 2})), (5 + 5 + 5 + 10) / 4.0, 1e-9);
  // A point that only the estimate places behind the camera counts with the image's diagonal.
  EXPECT_NEAR(reprojection(TruthAtRest(), Pose(0, {0, 0, -2})), 500.0, 1e-9);
  EXPECT_NEAR(reprojection(TruthAtRest(), Pose(0, {100, 0, 2})), 500.0, 1e-9);
  // At half a metre, the last point is truly behind the camera and is ignored.
  const Trajectory near = {Pose(0, {0, 0, 0.5}), Pose(100'000, {0, 0, 0.5})};
  EXPECT_NEAR(reprojection(near, Pose(0, {0.01, 0, 0.5})), 20.0, 1e-9);
}

TEST(Evaluate, SymmetriesGivenByTheCaller) {
  const Trajectory turned = {Pose(0, {0.02, 0, 2}, {0, 0, 91 * kDegree})};
  EXPECT_NEAR(EvaluateOk(TruthAtRest(), turned).rotation_max_rad, 91 * kDegree, 1e-9);
  EvaluationOptions options;
  options.symmetries = {{ExpSo3({0, 0, M_PI / 2}), Eigen::Vector3d::Zero()}};
  const Evaluation e = EvaluateOk(TruthAtRest(), turned, options);
  EXPECT_NEAR(e.rotation_max_rad, 1 * kDegree, 1e-9);
  EXPECT_NEAR(e.position_rmse_m, 0.02, 1e-12);
  // Half a turn about (0.1, 0, 0) maps the object's origin to (0.2, 0, 0).
  options.symmetries = {{ExpSo3({0, 0, M_PI}), {0.2, 0, 0}}};
  const Evaluation half = EvaluateOk(TruthAtRest(), {Pose(0, {0.2, 0, 2}, {0, 0, M_PI})}, options);
  EXPECT_NEAR(half.position_rmse_m, 0.0, 1e-12);
  EXPECT_NEAR(half.rotation_max_rad, 0.0, 1e-7);
}

TEST(Evaluate, OfAnAxisOfSymmetryTheAxesAreCompared) {
  // The axis is parallel to x through (0, 0.5, 0): half a turn of the estimate about it moves its origin by 1 m.
  const ContinuousSymmetry axis = {ContinuousSymmetry::Kind::kAxis, {0, 0.5, 0}, Eigen::Vector3d::UnitX(), false};
  const RigidTransform spun = AboutCentre(axis, ExpSo3({2.8, 0, 0}));
  const Eigen::Vector3d centre(0, 0.5, 0);
  // Tilted by 3 degrees about the centre, which is 0.01 m beside the truth.
  const auto tilted = [&](double angle_deg) {
    const Eigen::Matrix3d tilt = ExpSo3({0, 0, angle_deg * kDegree});
    const RigidTransform pose = {tilt, Eigen::Vector3d(0.01, 0, 2) + centre - tilt * centre};
    return Trajectory{{0, pose * spun}};
  };
  EvaluationOptions options;
  EXPECT_GT(EvaluateOk(TruthAtRest(), tilted(3), options).rotation_max_rad, 90 * kDegree);
  options.continuous_symmetry = axis;
  const Evaluation e = EvaluateOk(TruthAtRest(), tilted(3), options);
  EXPECT_NEAR(e.rotation_max_rad, 3 * kDegree, 1e-7);
  EXPECT_NEAR(e.position_rmse_m, 0.01, 1e-9);
  EXPECT_NEAR(e.position_rmse_of_depth, 0.005, 1e-9);
  EXPECT_NEAR(EvaluateOk(TruthAtRest(), tilted(178), options).rotation_max_rad, 178 * kDegree, 1e-6);
  options.continuous_symmetry->is_flippable = true;
  EXPECT_NEAR(EvaluateOk(TruthAtRest(), tilted(178), options).rotation_max_rad, 2 * kDegree, 1e-6);
  options.continuous_symmetry = {ContinuousSymmetry::Kind::kSphere, centre, Eigen::Vector3d::Zero(), false};
  const Evaluation sphere = EvaluateOk(TruthAtRest(), tilted(50), options);
  EXPECT_NEAR(sphere.rotation_max_rad, 0.0, 1e-6);
  EXPECT_NEAR(sphere.position_rmse_m, 0.01, 1e-9);
}

TEST(Evaluate, IgnoresEstimatesOutsideTheTruth) {
  const Evaluation e =
      EvaluateOk(TruthAtRest(), {Pose(-1, {9, 9, 9}), Pose(50'000, {0, 0, 2}), Pose(100'001, {9, 9, 9})});
  EXPECT_EQ(e.num_poses, 1u);
  EXPECT_EQ(e.position_rmse_m, 0.0);
  EXPECT_EQ(e.pose_rate_hz, 0.0);
}

TEST(Evaluate, AnEstimateWithoutPosesHasNoCoverage) {
  const Evaluation e = EvaluateOk(TruthAtRest(), {});
  EXPECT_EQ(e.num_poses, 0u);
  EXPECT_EQ(e.coverage_ratio, 0.0);
  EXPECT_EQ(e.losses, 0u);
  EXPECT_TRUE(std::isnan(e.position_rmse_m));
  EXPECT_TRUE(std::isnan(e.rotation_max_rad));
}

TEST(Evaluate, ErrorsNameTheWrongInput) {
  const Trajectory good = {Pose(0, {0, 0, 2})};
  const auto message = [](const Trajectory& truth, const Trajectory& estimate, const EvaluationOptions& options = {}) {
    const absl::Status status = Evaluate(truth, estimate, options).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
    return std::string(status.message());
  };
  EXPECT_THAT(message({Pose(0, {0, 0, 2})}, good), HasSubstr("truth has 1 poses"));
  EXPECT_THAT(message({Pose(0, {0, 0, 2}), Pose(1, {0, 0, -2})}, good), HasSubstr("behind the camera"));
  EXPECT_THAT(message({Pose(1, {0, 0, 2}), Pose(1, {0, 0, 2})}, good), HasSubstr("truth's times do not increase"));
  EXPECT_THAT(message(TruthAtRest(), {Pose(1, {0, 0, 2}), Pose(0, {0, 0, 2})}), HasSubstr("estimate's times"));
  EXPECT_THAT(message(TruthAtRest(), {Pose(200'000, {0, 0, 2})}),
              HasSubstr("0.200000 to 0.200000 s) lies outside the truth's time span (0.000000 to 0.100000 s)"));
  EvaluationOptions options;
  options.max_gap_us = 0;
  EXPECT_THAT(message(TruthAtRest(), good, options), HasSubstr("max_gap_us"));
}

}  // namespace
}  // namespace evpose

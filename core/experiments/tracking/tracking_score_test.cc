// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/tracking_score.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <set>

namespace evpose {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;

// A cube at rest at 1 m in front of an EVK4, for one second.
class TrackingScoreTest : public ::testing::Test {
 protected:
  TrackingScoreTest() : run_(*SimulationPreset("cube")), model_(*SimulatedModel(run_)) {
    run_.t_begin_us = 1'000'000;
    run_.duration_us = 1'000'000;
    SetTruth({0.0, 0.0, 1.0});
  }

  void SetTruth(const Eigen::Vector3d& place_m) {
    true_pose_ = {ExpSo3({0.6, 0.7, 0.0}), place_m};
    truth_ = {{1'000'000, true_pose_}, {2'000'000, true_pose_}};
  }

  // Adds a pose with this error and a covariance of 1 mm and 1 mrad.
  PoseEstimate At(int64_t t_us, double off_m, TrackState state = TrackState::kTracking) const {
    PoseEstimate estimate;
    estimate.t_us = t_us;
    estimate.camera_from_object = true_pose_;
    estimate.camera_from_object.translation_m.x() += off_m;
    estimate.covariance = 1e-6 * Matrix6d::Identity();
    estimate.state = state;
    return estimate;
  }

  TrackingScore Score(const TrackingOutput& output) const {
    const auto score = ScoreTracking(run_, model_, truth_, EventRate(1'000'000), output);
    EXPECT_TRUE(score.ok()) << score.status();
    return score.value_or(TrackingScore{});
  }

  SimulationOptions run_;
  ObjectModel model_;
  RigidTransform true_pose_;
  Trajectory truth_;
};

TEST_F(TrackingScoreTest, HealthAgainstTheTruth) {
  TrackingOutput output;
  output.compute_s = 0.25;
  // Good poses from 100 ms on, every 10 ms; wrong from 400 to 450 ms, with state TRACKING for 30 ms of it.
  for (int i = 10; i < 100; ++i) {
    const bool is_wrong = i >= 40 && i < 45;
    const bool is_unsure = i == 43 || i == 44 || i == 60;
    output.poses.push_back(
        At(1'000'000 + 10'000 * i, is_wrong ? 0.2 : 0.002, is_unsure ? TrackState::kDegraded : TrackState::kTracking));
  }
  const TrackingScore score = Score(output);
  EXPECT_NEAR(score.first_pose_ms, 100.0, 1e-9);
  EXPECT_NEAR(score.evaluation.coverage_ratio, 0.85, 1e-9);
  EXPECT_EQ(score.losses, 1u);
  EXPECT_NEAR(score.wrong_tracking_s, 0.03, 1e-9);
  EXPECT_NEAR(score.longest_wrong_tracking_s, 0.03, 1e-9);
  EXPECT_NEAR(score.right_untracked_s, 0.01, 1e-9);
  EXPECT_NEAR(score.compute_ratio, 0.25, 1e-12);
  ASSERT_EQ(score.nees.size(), 90u);
  EXPECT_NEAR(score.nees[0], 4.0, 1e-6);  // 2 mm with a standard deviation of 1 mm
  output.losses = 3;                      // losses that the truth does not show
  EXPECT_EQ(Score(output).losses, 3u);
}

TEST_F(TrackingScoreTest, ALossOutOfViewIsNone) {
  TrackingOutput output;
  for (int i = 0; i < 50; ++i) output.poses.push_back(At(1'000'000 + 10'000 * i, 0.0));
  EXPECT_EQ(Score(output).losses, 1u);
  SetTruth({0.62, 0.0, 1.0});  // the origin of the cube at the border: half of it is in view
  output.poses.clear();
  for (int i = 0; i < 50; ++i) output.poses.push_back(At(1'000'000 + 10'000 * i, 0.0));
  EXPECT_EQ(Score(output).losses, 1u);
  SetTruth({0.8, 0.0, 1.0});
  output.poses.clear();
  for (int i = 0; i < 50; ++i) output.poses.push_back(At(1'000'000 + 10'000 * i, 0.0));
  EXPECT_EQ(Score(output).losses, 0u);
}

TEST_F(TrackingScoreTest, NoPoseAtAll) {
  const TrackingScore score = Score({});
  EXPECT_TRUE(std::isnan(score.first_pose_ms));
  EXPECT_EQ(score.evaluation.coverage_ratio, 0.0);
  const TrackingSummary summary = SummariseTracking({score});
  std::set<std::string> met;
  for (const TargetCheck& check : CheckTargets(summary, {})) {
    if (check.is_met()) met.insert(check.name);
  }
  EXPECT_EQ(met, std::set<std::string>{"losses"});
}

TEST(EventRateTest, BusyIntervalsNeedAPoseAMillisecond) {
  EventRate rate(0);
  std::vector<Event> events;
  std::vector<PoseEstimate> poses;
  // 0.4 Mev/s for 200 ms, then half of that.
  for (int64_t t_us = 0; t_us < 400'000; t_us += t_us < 200'000 ? 5 : 10) {
    for (int i = 0; i < 2; ++i) events.push_back({t_us, 1, 1, 1});
  }
  rate.Add(absl::MakeConstSpan(events).subspan(0, 777));
  rate.Add(absl::MakeConstSpan(events).subspan(777));
  EXPECT_EQ(rate.num_events(), events.size());
  for (int64_t t_us = 500; t_us < 400'000; t_us += 1000) {
    if (t_us / 10'000 == 12 && t_us % 10'000 == 500) continue;  // one pose is missing here
    PoseEstimate pose;
    pose.t_us = t_us;
    poses.push_back(pose);
  }
  // The intervals 5 to 19 are busy, and one of them is incomplete.
  EXPECT_NEAR(rate.ShareAtFullPoseRate(poses), 14.0 / 15.0, 1e-12);
  EXPECT_EQ(rate.ShareAtFullPoseRate({}), 0.0);
  EXPECT_TRUE(std::isnan(EventRate(0).ShareAtFullPoseRate(poses)));
}

TEST(TargetCheckTest, TheWorstRunMayHaveTwiceTheErrors) {
  const auto score_of = [](double position, double rotation_deg) {
    TrackingScore score;
    score.evaluation.coverage_ratio = 0.998;
    score.evaluation.position_rmse_of_depth = position;
    score.evaluation.rotation_median_rad = rotation_deg * kDegree;
    score.evaluation.rotation_p95_rad = rotation_deg * kDegree;
    // One of twenty poses has the true pose outside the 95 % ellipsoid, where the NEES is above 12.6.
    score.nees.assign(19, 5.0);
    score.nees.push_back(13.0);
    score.full_rate_ratio = 1.0;
    return score;
  };
  TrackingTargets targets;
  targets.position_rmse_of_depth = 0.001;
  const auto missed = [&](const std::vector<TrackingScore>& scores) {
    std::set<std::string> names;
    for (const TargetCheck& check : CheckTargets(SummariseTracking(scores), targets)) {
      if (!check.is_met()) names.insert(check.name);
    }
    return names;
  };
  EXPECT_TRUE(missed({score_of(0.0005, 0.05), score_of(0.0014, 0.05)}).empty());
  EXPECT_EQ(missed({score_of(0.0001, 0.05), score_of(0.0018, 0.21)}),
            (std::set<std::string>{"rotation median", "worst rotation median"}));
  EXPECT_EQ(missed({score_of(0.0, 0.05), score_of(0.0, 0.05), score_of(0.0021, 0.05)}),
            (std::set<std::string>{"worst position"}));
  TrackingScore lost = score_of(0.0005, 0.05);
  lost.losses = 1;
  lost.evaluation.coverage_ratio = 0.9;
  lost.nees.assign(60, 9.0);
  EXPECT_EQ(missed({score_of(0.0005, 0.05), lost}),
            (std::set<std::string>{"losses", "coverage", "worst coverage", "NEES median"}));
  EXPECT_EQ(SummariseTracking({score_of(0.0005, 0.05), lost, score_of(0.9, 0.05)}).worst_run, 1);
  // 87 % of the truths, or all of them, inside the 95 % ellipsoid.
  TrackingScore confident = score_of(0.0005, 0.05);
  confident.nees.assign(13, 5.0);
  confident.nees.resize(15, 13.0);
  EXPECT_EQ(missed({confident}), std::set<std::string>{"inside 95 %"});
  TrackingScore cautious = score_of(0.0005, 0.05);
  cautious.nees.assign(20, 5.0);
  EXPECT_EQ(missed({cautious}), std::set<std::string>{"inside 95 %"});
}

}  // namespace
}  // namespace evpose

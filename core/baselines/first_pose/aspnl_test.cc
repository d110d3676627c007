// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/aspnl.h"

#include <gtest/gtest.h>

#include "core/experiments/first_pose/trials_testing.h"

namespace evpose {
namespace {

constexpr int kAspnlTrials = 20;

TEST(Aspnl, IsExactWithoutNoise) {
  for (const SimulatedObject object : kAllObjects) {
    const auto trials = MakeTrials(object, 0.0);
    for (int seed = 0; seed < kAspnlTrials; ++seed) {
      const LineTrial trial = trials->Make(seed);
      const auto pose = EstimatePoseByAspnl(trials->camera(), TrueMatches(*trials, trial));
      ASSERT_TRUE(pose.ok()) << pose.status();
      EXPECT_LT(CompareWithTruth(*trials, trial, *pose).reprojection_px, 1e-3)
          << SimulatedObjectName(object) << " " << seed;
    }
  }
}

TEST(Aspnl, IsRightWithNoise) {
  for (const SimulatedObject object : kAllObjects) {
    const auto trials = MakeTrials(object, 0.8);
    int right = 0;
    for (int seed = 0; seed < kAspnlTrials; ++seed) {
      const LineTrial trial = trials->Make(seed);
      const auto pose = EstimatePoseByAspnl(trials->camera(), TrueMatches(*trials, trial));
      ASSERT_TRUE(pose.ok()) << pose.status();
      right += CompareWithTruth(*trials, trial, *pose).is_right();
    }
    EXPECT_GE(right, kAspnlTrials - 1) << SimulatedObjectName(object);
  }
}

TEST(Aspnl, ReportsErrors) {
  const auto trials = MakeTrials(SimulatedObject::kCube, 0.0);
  std::vector<LineMatch> matches = TrueMatches(*trials, trials->Make(1));
  EXPECT_EQ(EstimatePoseByAspnl(trials->camera(), absl::MakeSpan(matches).first(2)).status().code(),
            absl::StatusCode::kInvalidArgument);
  for (LineMatch& match : matches) match.p2 = match.p1 + Eigen::Vector3d::UnitX();
  EXPECT_EQ(EstimatePoseByAspnl(trials->camera(), matches).status().code(), absl::StatusCode::kNotFound);
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/ropnl.h"

#include <gtest/gtest.h>

#include "core/experiments/first_pose/trials_testing.h"

namespace evpose {
namespace {

constexpr int kRopnlTrials = 20;

struct Counts {
  int right = 0;
  int near = 0;  // mean error of the ends within 6 px
};

Counts RunTrials(SimulatedObject object, double noise_px) {
  const auto trials = MakeTrials(object, noise_px);
  Counts counts;
  for (int seed = 0; seed < kRopnlTrials; ++seed) {
    const LineTrial trial = trials->Make(seed);
    const auto pose = EstimatePoseByRopnl(trials->camera(), TrueMatches(*trials, trial), {});
    EXPECT_TRUE(pose.ok()) << pose.status();
    if (!pose.ok()) continue;
    const PoseError error = CompareWithTruth(*trials, trial, *pose);
    counts.right += error.is_right();
    counts.near += error.reprojection_px < 6.0;
  }
  return counts;
}

TEST(Ropnl, IsRightWithoutNoise) {
  for (const SimulatedObject object : kAllObjects) EXPECT_GE(RunTrials(object, 0.0).right, kRopnlTrials - 1);
}

TEST(Ropnl, IsNearWithNoise) {
  for (const SimulatedObject object : kAllObjects) {
    EXPECT_GE(RunTrials(object, 0.8).near, kRopnlTrials * 17 / 20) << SimulatedObjectName(object);
  }
}

TEST(Ropnl, IsMostlyRightWhereNoLineIsShort) {
  EXPECT_GE(RunTrials(SimulatedObject::kCube, 0.8).right, kRopnlTrials * 17 / 20);
  EXPECT_GE(RunTrials(SimulatedObject::kCuboid, 0.8).right, kRopnlTrials * 17 / 20);
}

TEST(Ropnl, WrongMatchesAreRejected) {
  const auto trials = MakeTrials(SimulatedObject::kSpacecraft, 0.5);
  const LineTrial trial = trials->Make(4);
  std::vector<LineMatch> matches = TrueMatches(*trials, trial);
  ASSERT_GE(matches.size(), 10u);
  for (int i = 0; i < 2; ++i) {  // rotated by a right angle in the image
    ImageSegment& segment = matches[i].segment;
    const Eigen::Vector2d way = segment.p2_px - segment.p1_px;
    segment.p2_px = segment.p1_px + Eigen::Vector2d(-way.y(), way.x());
  }
  const auto pose = EstimatePoseByRopnl(trials->camera(), matches, {});
  ASSERT_TRUE(pose.ok()) << pose.status();
  EXPECT_TRUE(CompareWithTruth(*trials, trial, *pose).is_right());
}

TEST(Ropnl, ReportsErrors) {
  const auto trials = MakeTrials(SimulatedObject::kCube, 0.0);
  const std::vector<LineMatch> matches = TrueMatches(*trials, trials->Make(1));
  EXPECT_EQ(EstimatePoseByRopnl(trials->camera(), absl::MakeSpan(matches).first(2), {}).status().code(),
            absl::StatusCode::kInvalidArgument);
  RotationBnbOptions options;
  options.inlier_rad = -1.0;
  EXPECT_EQ(EstimatePoseByRopnl(trials->camera(), matches, options).status().code(),
            absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/ransac_p3l.h"

#include <gtest/gtest.h>

#include "core/experiments/first_pose/trials_testing.h"

namespace evpose {
namespace {

constexpr int kRansacTrials = 10;

int CountRightByRansac(SimulatedObject object, double noise_px, int spurious, int missing) {
  const auto trials = MakeTrials(object, noise_px, spurious, missing);
  int right = 0;
  for (int seed = 0; seed < kRansacTrials; ++seed) {
    const LineTrial trial = trials->Make(seed);
    const auto pose = EstimatePoseByRansac(trials->model(), trials->camera(), trial.segments, {}, seed);
    right += pose.ok() && CompareWithTruth(*trials, trial, *pose).is_right();
  }
  return right;
}

TEST(RansacP3l, IsRightForBoxes) {
  EXPECT_EQ(CountRightByRansac(SimulatedObject::kCube, 0.0, 0, 0), kRansacTrials);
  EXPECT_GE(CountRightByRansac(SimulatedObject::kCube, 0.8, 2, 1), kRansacTrials - 1);
  EXPECT_GE(CountRightByRansac(SimulatedObject::kCuboid, 0.8, 0, 0), kRansacTrials - 1);
  EXPECT_GE(CountRightByRansac(SimulatedObject::kPlanar, 0.8, 0, 0), kRansacTrials * 6 / 10);
}

TEST(RansacP3l, EqualSeedsGiveEqualPoses) {
  const auto trials = MakeTrials(SimulatedObject::kCube, 0.8, 2, 1);
  const LineTrial trial = trials->Make(3);
  const auto a = EstimatePoseByRansac(trials->model(), trials->camera(), trial.segments, {}, 7);
  const auto b = EstimatePoseByRansac(trials->model(), trials->camera(), trial.segments, {}, 7);
  ASSERT_TRUE(a.ok() && b.ok());
  EXPECT_EQ(a->rotation, b->rotation);
  EXPECT_EQ(a->translation_m, b->translation_m);
}

TEST(RansacP3l, ReportsErrors) {
  const auto trials = MakeTrials(SimulatedObject::kCube, 0.8);
  const LineTrial trial = trials->Make(3);
  const auto few = absl::MakeSpan(trial.segments).first(3);
  EXPECT_EQ(EstimatePoseByRansac(trials->model(), trials->camera(), few, {}, 1).status().code(),
            absl::StatusCode::kNotFound);
  RansacP3lOptions options;
  options.num_draws = 0;
  EXPECT_EQ(EstimatePoseByRansac(trials->model(), trials->camera(), trial.segments, options, 1).status().code(),
            absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/softposit_lines.h"

#include <gtest/gtest.h>

#include "core/experiments/first_pose/trials_testing.h"

namespace evpose {
namespace {

constexpr int kSoftPositTrials = 10;

int CountRightBySoftPosit(SimulatedObject object, double noise_px, int spurious, int missing, double rotation_rad) {
  const auto trials = MakeTrials(object, noise_px, spurious, missing);
  int right = 0;
  for (int seed = 0; seed < kSoftPositTrials; ++seed) {
    const LineTrial trial = trials->Make(seed);
    const PosePrior prior = PriorOf(trial, rotation_rad, 0.3 * rotation_rad, seed);
    const auto pose = EstimatePoseBySoftPosit(trials->model(), trials->camera(), trial.segments, prior, {}, seed);
    right += pose.ok() && CompareWithTruth(*trials, trial, *pose).is_right();
  }
  return right;
}

TEST(SoftPosit, IsRightFromNearby) {
  for (const SimulatedObject object : {SimulatedObject::kCube, SimulatedObject::kCuboid}) {
    EXPECT_GE(CountRightBySoftPosit(object, 0.0, 0, 0, 0.05), kSoftPositTrials * 6 / 10) << SimulatedObjectName(object);
    EXPECT_GE(CountRightBySoftPosit(object, 0.8, 0, 0, 0.1), kSoftPositTrials * 6 / 10) << SimulatedObjectName(object);
    EXPECT_GE(CountRightBySoftPosit(object, 0.8, 2, 1, 0.1), kSoftPositTrials * 3 / 10) << SimulatedObjectName(object);
  }
}

TEST(SoftPosit, PlanesHaveNoSolution) {
  const auto trials = MakeTrials(SimulatedObject::kPlanar, 0.0);
  const LineTrial trial = trials->Make(1);
  const PosePrior prior = PriorOf(trial, 0.0, 0.0, 1);
  const auto pose = EstimatePoseBySoftPosit(trials->model(), trials->camera(), trial.segments, prior, {}, 1);
  EXPECT_EQ(pose.status().code(), absl::StatusCode::kNotFound);
}

TEST(SoftPosit, EqualSeedsGiveEqualPoses) {
  const auto trials = MakeTrials(SimulatedObject::kCube, 0.8);
  const LineTrial trial = trials->Make(3);
  const PosePrior prior = PriorOf(trial, 0.02, 0.01, 5);
  const auto a = EstimatePoseBySoftPosit(trials->model(), trials->camera(), trial.segments, prior, {}, 7);
  const auto b = EstimatePoseBySoftPosit(trials->model(), trials->camera(), trial.segments, prior, {}, 7);
  ASSERT_TRUE(a.ok() && b.ok());
  EXPECT_EQ(a->rotation, b->rotation);
  EXPECT_EQ(a->translation_m, b->translation_m);
}

TEST(SoftPosit, ReportsErrors) {
  const auto trials = MakeTrials(SimulatedObject::kCube, 0.8);
  const LineTrial trial = trials->Make(3);
  const PosePrior prior = PriorOf(trial, 0.1, 0.03, 5);
  EXPECT_EQ(EstimatePoseBySoftPosit(trials->model(), trials->camera(), {}, prior, {}, 1).status().code(),
            absl::StatusCode::kNotFound);
  SoftPositOptions options;
  options.max_starts = 0;
  EXPECT_EQ(
      EstimatePoseBySoftPosit(trials->model(), trials->camera(), trial.segments, prior, options, 1).status().code(),
      absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace evpose

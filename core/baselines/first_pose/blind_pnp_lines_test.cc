// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/blind_pnp_lines.h"

#include <gtest/gtest.h>

#include "core/experiments/first_pose/trials_testing.h"

namespace evpose {
namespace {

constexpr int kBlindPnpTrials = 10;

int CountRightByBlindPnp(SimulatedObject object, double noise_px, int spurious, int missing, double rotation_rad) {
  const auto trials = MakeTrials(object, noise_px, spurious, missing);
  int right = 0;
  for (int seed = 0; seed < kBlindPnpTrials; ++seed) {
    const LineTrial trial = trials->Make(seed);
    const PosePrior prior = PriorOf(trial, rotation_rad, 0.3 * rotation_rad, seed);
    const auto pose = EstimatePoseByBlindPnp(trials->model(), trials->camera(), trial.segments, prior, {}, seed);
    right += pose.ok() && CompareWithTruth(*trials, trial, *pose).is_right();
  }
  return right;
}

TEST(BlindPnp, IsRightFromNearby) {
  for (const SimulatedObject object : {SimulatedObject::kCube, SimulatedObject::kCuboid, SimulatedObject::kPlanar}) {
    EXPECT_GE(CountRightByBlindPnp(object, 0.0, 0, 0, 0.05), kBlindPnpTrials - 1) << SimulatedObjectName(object);
    EXPECT_GE(CountRightByBlindPnp(object, 0.8, 0, 0, 0.1), kBlindPnpTrials - 2) << SimulatedObjectName(object);
    EXPECT_GE(CountRightByBlindPnp(object, 0.8, 2, 1, 0.1), kBlindPnpTrials / 2) << SimulatedObjectName(object);
  }
}

TEST(BlindPnp, EqualSeedsGiveEqualPoses) {
  const auto trials = MakeTrials(SimulatedObject::kCube, 0.8, 2, 1);
  const LineTrial trial = trials->Make(3);
  const PosePrior prior = PriorOf(trial, 0.1, 0.03, 5);
  const auto a = EstimatePoseByBlindPnp(trials->model(), trials->camera(), trial.segments, prior, {}, 7);
  const auto b = EstimatePoseByBlindPnp(trials->model(), trials->camera(), trial.segments, prior, {}, 7);
  ASSERT_TRUE(a.ok() && b.ok());
  EXPECT_EQ(a->rotation, b->rotation);
  EXPECT_EQ(a->translation_m, b->translation_m);
}

TEST(BlindPnp, ReportsErrors) {
  const auto trials = MakeTrials(SimulatedObject::kCube, 0.8);
  const LineTrial trial = trials->Make(3);
  const PosePrior prior = PriorOf(trial, 0.1, 0.03, 5);
  EXPECT_EQ(EstimatePoseByBlindPnp(trials->model(), trials->camera(), {}, prior, {}, 1).status().code(),
            absl::StatusCode::kNotFound);
  BlindPnpOptions options;
  options.num_components = 0;
  EXPECT_EQ(
      EstimatePoseByBlindPnp(trials->model(), trials->camera(), trial.segments, prior, options, 1).status().code(),
      absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace evpose

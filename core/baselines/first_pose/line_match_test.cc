// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/line_match.h"

#include <gtest/gtest.h>

#include <cmath>

#include "core/experiments/first_pose/trials_testing.h"

namespace evpose {
namespace {

TEST(LineMatch, TranslationFollowsFromTheRotation) {
  const auto trials = MakeTrials(SimulatedObject::kSpacecraft, 0.0);
  for (int seed = 0; seed < 10; ++seed) {
    const LineTrial trial = trials->Make(seed);
    const auto translation_m =
        SolveTranslation(TrueMatches(*trials, trial), trials->camera(), trial.camera_from_object.rotation);
    ASSERT_TRUE(translation_m);
    EXPECT_LT((*translation_m - trial.camera_from_object.translation_m).norm(), 1e-9);
  }
}

TEST(LineMatch, PlanesThroughOneLineDoNotDetermineTheTranslation) {
  const auto trials = MakeTrials(SimulatedObject::kCube, 0.0);
  std::vector<LineMatch> matches = TrueMatches(*trials, trials->Make(1));
  for (size_t j = 0; j < matches.size(); ++j) {  // all pass through one pixel
    matches[j].segment = {{100.0, 100.0}, {200.0, 150.0 + 10.0 * static_cast<double>(j)}};
  }
  EXPECT_FALSE(SolveTranslation(matches, trials->camera(), Eigen::Matrix3d::Identity()));
}

TEST(LineMatch, RefinementFindsTheTruthFromNearby) {
  const auto trials = MakeTrials(SimulatedObject::kCuboid, 0.0);
  for (int seed = 0; seed < 10; ++seed) {
    const LineTrial trial = trials->Make(seed);
    const std::vector<LineMatch> matches = TrueMatches(*trials, trial);
    Vector6d offset;
    offset << 0.01, -0.01, 0.02, 0.03, -0.02, 0.03;
    const RigidTransform start = Perturb(trial.camera_from_object, offset);
    EXPECT_GT(LineResidualPx(matches, trials->camera(), start), 1.0);
    const auto refined = RefinePose(matches, trials->camera(), start, 20);
    ASSERT_TRUE(refined);
    EXPECT_LT(LineResidualPx(matches, trials->camera(), *refined), 1e-6);
    EXPECT_LT(CompareWithTruth(*trials, trial, *refined).reprojection_px, 1e-4);
  }
}

TEST(LineMatch, ResidualBehindTheCameraIsInfinite) {
  const auto trials = MakeTrials(SimulatedObject::kCube, 0.0);
  const LineTrial trial = trials->Make(1);
  const RigidTransform behind{trial.camera_from_object.rotation, -trial.camera_from_object.translation_m};
  EXPECT_TRUE(std::isinf(LineResidualPx(TrueMatches(*trials, trial), trials->camera(), behind)));
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/pose_score.h"

#include <gtest/gtest.h>

#include <climits>

#include "core/experiments/first_pose/trials_testing.h"

namespace evpose {
namespace {

TEST(PoseScore, TheTruthExplainsTheSegmentsOfTheObject) {
  for (const SimulatedObject object : {SimulatedObject::kCube, SimulatedObject::kBook, SimulatedObject::kSpacecraft}) {
    const auto trials = MakeTrials(object, 0.0, 3, 1);
    for (int seed = 0; seed < 10; ++seed) {
      const LineTrial trial = trials->Make(seed);
      const PoseScorer scorer(trials->model(), trials->camera(), trial.segments, 2.0);
      const PoseScore score = scorer.Score(trial.camera_from_object);
      for (size_t j = 0; j < trial.segments.size(); ++j) {
        EXPECT_TRUE(trial.model_line[j] < 0 || score.model_line[j] >= 0);
      }
      const int true_lines = static_cast<int>(trial.segments.size()) - 3;
      EXPECT_GE(score.inliers, true_lines);
      EXPECT_LE(score.cost_px2, 3 * 2.0 * 4.0 + 1e-9);  // the share of the spurious segments
      EXPECT_EQ(scorer.Matches(score).size(), static_cast<size_t>(score.inliers));
      const PoseScore quick = scorer.QuickScore(trial.camera_from_object, 0);
      EXPECT_EQ(quick.inliers, score.inliers);
      EXPECT_EQ(quick.cost_px2, score.cost_px2);
      EXPECT_EQ(scorer.QuickScore(trial.camera_from_object, static_cast<int>(trial.segments.size()) + 1).inliers,
                INT_MIN);
    }
  }
}

TEST(PoseScore, AWrongPoseExplainsLess) {
  const auto trials = MakeTrials(SimulatedObject::kCuboid, 0.0);
  const LineTrial trial = trials->Make(2);
  const PoseScorer scorer(trials->model(), trials->camera(), trial.segments, 2.0);
  RigidTransform aside = trial.camera_from_object;
  aside.translation_m.x() += 0.05 * aside.translation_m.z();
  EXPECT_TRUE(scorer.Score(trial.camera_from_object).IsBetterThan(scorer.Score(aside)));
  RigidTransform behind = trial.camera_from_object;
  behind.translation_m = -behind.translation_m;
  EXPECT_EQ(scorer.Score(behind).inliers, 0);
  EXPECT_EQ(scorer.QuickScore(behind, 0).inliers, INT_MIN);
}

}  // namespace
}  // namespace evpose

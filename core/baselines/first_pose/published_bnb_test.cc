// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/published_bnb.h"

#include <gtest/gtest.h>

#include "core/experiments/first_pose/trials_testing.h"

namespace evpose {
namespace {

constexpr int kPublishedBnbTrials = 20;

int CountRightByPublishedBnb(SimulatedObject object, double noise_px, int spurious, int missing) {
  const auto trials = MakeTrials(object, noise_px, spurious, missing);
  int right = 0;
  for (int seed = 0; seed < kPublishedBnbTrials; ++seed) {
    const LineTrial trial = trials->Make(seed);
    const auto pose = EstimatePoseByPublishedBnb(trials->model(), trials->camera(), trial.segments, {});
    right += pose.ok() && CompareWithTruth(*trials, trial, *pose).is_right();
  }
  return right;
}

TEST(PublishedBnb, IsRightForBoxesThatAreSeenWhole) {
  EXPECT_EQ(CountRightByPublishedBnb(SimulatedObject::kCube, 0.0, 0, 0), kPublishedBnbTrials);
  EXPECT_GE(CountRightByPublishedBnb(SimulatedObject::kCube, 0.8, 0, 0), kPublishedBnbTrials - 1);
  // The directions do not determine the correspondences of the parallel lines; the translations do.
  EXPECT_GE(CountRightByPublishedBnb(SimulatedObject::kCuboid, 0.8, 0, 0), kPublishedBnbTrials - 2);
}

TEST(PublishedBnb, CountingIsMisledBySpuriousLines) {
  const int right = CountRightByPublishedBnb(SimulatedObject::kCube, 0.8, 4, 2);
  EXPECT_GE(right, kPublishedBnbTrials / 5);
  EXPECT_LE(right, kPublishedBnbTrials * 4 / 5);
}

TEST(PublishedBnb, ReportsErrors) {
  const auto trials = MakeTrials(SimulatedObject::kCube, 0.8);
  const LineTrial trial = trials->Make(3);
  EXPECT_EQ(EstimatePoseByPublishedBnb(trials->model(), trials->camera(), {}, {}).status().code(),
            absl::StatusCode::kInvalidArgument);
  const auto two = absl::MakeSpan(trial.segments).first(2);
  EXPECT_EQ(EstimatePoseByPublishedBnb(trials->model(), trials->camera(), two, {}).status().code(),
            absl::StatusCode::kNotFound);
  PublishedBnbOptions options;
  options.max_triples = 0;
  EXPECT_EQ(EstimatePoseByPublishedBnb(trials->model(), trials->camera(), trial.segments, options).status().code(),
            absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace evpose

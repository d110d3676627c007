// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/trajectory_gaps.h"

#include <gtest/gtest.h>

#include <utility>
#include <vector>

namespace evpose {
namespace {

Trajectory SamplesAt(const std::vector<int64_t>& times_us) {
  Trajectory trajectory;
  for (const int64_t t_us : times_us) trajectory.push_back({t_us, {Eigen::Matrix3d::Identity(), {0, 0, 1}}});
  return trajectory;
}

TEST(TrajectoryGaps, NoPoseIsInterpolatedBeforeABreak) {
  const Trajectory trajectory = SamplesAt({10, 20, 30});
  for (const int64_t t_us : {5, 10, 15, 20, 30, 35}) EXPECT_TRUE(PoseNear(trajectory, t_us, 15, {2})) << t_us;
  for (const int64_t t_us : {21, 29, 50}) EXPECT_FALSE(PoseNear(trajectory, t_us, 15, {2})) << t_us;
  EXPECT_FALSE(PoseNear(trajectory, 15, 5, {2})) << "the samples are 10 us apart";
  EXPECT_FALSE(PoseNear({}, 15, 5, {2}));
}

TEST(TrajectoryGaps, TheLongestStepFollowsTheRateOfTheSamples) {
  using Steps = std::pair<int64_t, int64_t>;
  const auto steps = [](const std::vector<int64_t>& times_us) {
    const Trajectory trajectory = SamplesAt(times_us);
    return Steps(LongestStepUs(trajectory), LongestInterpolatedStepUs(trajectory));
  };
  const Steps shortest(50'000, 50'000), of_10_hz(300'000, 300'000), of_1_hz(3'000'000, 500'000);
  EXPECT_EQ(steps({}), shortest);
  EXPECT_EQ(steps({5}), shortest);
  EXPECT_EQ(steps({0, 1'000, 2'000, 90'000}), shortest) << "1 kHz";
  EXPECT_EQ(steps({0, 100'000, 200'000, 900'000}), of_10_hz);
  EXPECT_EQ(steps({0, 1'000'000, 2'000'000}), of_1_hz);
}

}  // namespace
}  // namespace evpose

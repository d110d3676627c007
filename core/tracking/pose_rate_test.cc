// SPDX-License-Identifier: Apache-2.0

// Poses at more than one per millisecond: shorter windows, whose estimates carry the information of the earlier ones.
#include <gtest/gtest.h>

#include <vector>

#include "core/estimation/ideal_events_testing.h"
#include "core/numerics/statistics.h"
#include "core/tracking/tracker.h"
#include "core/tracking/tracking_testing.h"

namespace evpose {
namespace {

using testing::ConstantTwist;
using testing::IdealEventOptions;
using testing::MakeIdealEvents;
using testing::Motion;

const Motion kFastMotion = ConstantTwist(kStart, Twist(0.6, 0.3, 0.1, 2.0, 1.5, 1.0));

// Normalised squared errors and the distances from the truth of the poses of a cube with this pose rate.
struct RateResult {
  double num_poses = 0.0;
  double rmse_m = 0.0;
  double median_nees = 0.0;
  uint32_t losses = 0;
};

RateResult TrackAt(double pose_rate_hz, const std::vector<Event>& events) {
  TrackerOptions options = WithoutInitialization();
  options.windows = WindowOptions::WithPoseRate(pose_rate_hz);
  const auto tracker = Tracker::Create(Cube(), kCamera, options, kFastMotion(0.0)).value();
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(events, estimates);
  tracker->Finish(estimates);
  RateResult result;
  std::vector<double> nees;
  for (const PoseEstimate& estimate : estimates) {
    const Vector6d error =
        Difference(kFastMotion(1e-6 * static_cast<double>(estimate.t_us)), estimate.camera_from_object);
    nees.push_back(error.dot(estimate.covariance.ldlt().solve(error)));
    result.rmse_m += error.head<3>().squaredNorm() / static_cast<double>(estimates.size());
  }
  result.num_poses = static_cast<double>(estimates.size());
  result.rmse_m = std::sqrt(result.rmse_m);
  result.median_nees = UpperMedian(nees);
  result.losses = tracker->losses();
  return result;
}

TEST(PoseRate, TenTimesAsManyPosesAreAsAccurateAndConsistent) {
  for (const uint64_t seed : {1, 2, 3}) {
    IdealEventOptions ideal;
    ideal.duration_us = 100'000;
    ideal.events_per_px2 = 4.0;
    ideal.seed = seed;
    const std::vector<Event> events = MakeIdealEvents(*Cube(), kCamera, kFastMotion, ideal);
    ASSERT_GT(events.size(), 200'000u) << "150 events in 100 us and more, " << seed;
    const RateResult usual = TrackAt(1000.0, events), high = TrackAt(10'000.0, events);
    EXPECT_GE(usual.num_poses, 95.0) << seed;
    EXPECT_GE(high.num_poses, 900.0) << seed;
    EXPECT_LT(high.rmse_m, 1.3 * usual.rmse_m) << seed;
    EXPECT_GT(high.median_nees, 0.5 * usual.median_nees) << seed;
    EXPECT_LT(high.median_nees, 1.5 * usual.median_nees) << seed;
    EXPECT_EQ(high.losses, 0u) << seed;
  }
}

TEST(PoseRate, WithFewerEventsThereAreFewerPoses) {
  IdealEventOptions ideal;
  ideal.duration_us = 100'000;
  ideal.events_per_px2 = 0.4;
  const std::vector<Event> events = MakeIdealEvents(*Cube(), kCamera, kFastMotion, ideal);
  const RateResult result = TrackAt(10'000.0, events);
  EXPECT_LE(result.num_poses, static_cast<double>(events.size()) / WindowOptions().min_events);
  EXPECT_GE(result.num_poses, 50.0);
  EXPECT_EQ(result.losses, 0u);
}

}  // namespace
}  // namespace evpose

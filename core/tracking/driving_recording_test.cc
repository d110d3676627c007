// SPDX-License-Identifier: Apache-2.0

// A real recording of a street without a cube: no pose of a cube may be reported, for any given pose.
#include <gtest/gtest.h>

#include <filesystem>
#include <vector>

#include "core/baselines/estimators/estimator_factory.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/numerics/random.h"
#include "core/recordings/recordings_testing.h"
#include "core/tracking/object/tracker_options.h"
#include "core/tracking/tracker.h"
#include "tests/data/test_data.h"

namespace evpose {
namespace {

TEST(DrivingRecording, NoCubeIsReported) {
  const std::string path = FindTestData("evt3_driving_gen41/evt3_sample.raw");
  if (path.empty()) GTEST_SKIP() << "the recording is not in the test data";
  const std::vector<Event> events = EventsOf(path);
  const auto cube = testing::MakeCube(0.15);
  const CameraModel camera = testing::MakeCamera(1280, 720, 1000.0);
  Random random(1);
  for (int k = 0; k < 60; ++k) {
    RigidTransform pose;
    const double depth_m = random.Uniform(0.25, 2.0);
    pose.translation_m = {random.Uniform(-0.5, 0.5) * depth_m, random.Uniform(-0.3, 0.3) * depth_m, depth_m};
    pose.rotation = Eigen::Quaterniond{random.Normal(), random.Normal(), random.Normal(), random.Normal()}
                        .normalized()
                        .toRotationMatrix();
    TrackerOptions options;
    options.estimator_factory = EstimatorFactoryOf(k % 3 == 2 ? Estimator::kStaticMm : Estimator::kMixture);
    auto tracker = Tracker::Create(cube, camera, options, pose).value();
    std::vector<PoseEstimate> estimates;
    tracker->AddEvents(events, estimates);
    tracker->Finish(estimates);
    EXPECT_EQ(tracker->state(), TrackState::kLost) << k;
    EXPECT_TRUE(estimates.empty()) << k;
  }
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/tracker_options.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <string>

#include "core/estimation/ideal_events_testing.h"
#include "core/tracking/tracker.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;
using testing::MakeCamera;
using testing::MakeCube;
using testing::MakePose;

template <typename Change>
std::string MessageAfter(Change change) {
  TrackerOptions options;
  change(options);
  const absl::Status status = options.Validate();
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  return std::string(status.message());
}

TEST(TrackerOptions, DefaultsAreValid) { EXPECT_TRUE(TrackerOptions().Validate().ok()); }

TEST(TrackerOptions, ValidateNamesGroupAndField) {
  EXPECT_THAT(MessageAfter([](auto& o) { o.windows.interval_us = -1; }), HasSubstr("windows.interval_us"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.initial.lateral_px = 0.0; }), HasSubstr("initial.lateral_px"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.initial.depth_ratio = std::numeric_limits<double>::quiet_NaN(); }),
              HasSubstr("initial.depth_ratio"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.motion.angular_acceleration_density = -1.0; }),
              HasSubstr("motion.angular_acceleration_density"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.motion.retry_noise_factor = 0.5; }), HasSubstr("motion.retry_noise_factor"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.sensor.pixel_noise_px = 0.0; }), HasSubstr("sensor.pixel_noise_px"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.edge.memory_events = 0.0; }), HasSubstr("edge.memory_events"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.mixture.max_gate_px = 1.0; }), HasSubstr("mixture.max_gate_px"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.mixture.max_passes = 0; }), HasSubstr("mixture.max_passes"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.mixture.retry_explained_ratio = 1.5; }),
              HasSubstr("mixture.retry_explained_ratio"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.mixture.memory_events = 0.0; }), HasSubstr("mixture.memory_events"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.mixture.initial_outlier_ratio = 1.0; }),
              HasSubstr("mixture.initial_outlier_ratio"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.mixture.narrow_face_sigma = -1.0; }),
              HasSubstr("mixture.narrow_face_sigma"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.initialization.max_compared_events = 0; }),
              HasSubstr("initialization.max_compared_events"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.initialization.merge_rad = -1.0; }), HasSubstr("initialization.merge_rad"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.initialization.merge_depth_ratio = -1.0; }),
              HasSubstr("initialization.merge_depth_ratio"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.health.keep_lines = 4; }), HasSubstr("health.keep_lines"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.health.min_signal_events = -1.0; }), HasSubstr("health.min_signal_events"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.health.near_px = 7.0; }), HasSubstr("health.near_px"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.health.lost_after_us = 0; }), HasSubstr("health.lost_after_us"));
  EXPECT_THAT(MessageAfter([](auto& o) { o.visibility.samples_per_line = 0; }), HasSubstr("visibility."));
}

TEST(TrackerCreate, ErrorsNameTheArgument) {
  const auto cube = MakeCube(0.1);
  const CameraModel camera = MakeCamera(640, 480, 600.0);
  const auto message = [](auto result) {
    EXPECT_EQ(result.status().code(), absl::StatusCode::kInvalidArgument);
    return std::string(result.status().message());
  };
  EXPECT_THAT(message(Tracker::Create(nullptr, camera, {}, std::nullopt)), HasSubstr("model"));
  EXPECT_THAT(message(Tracker::Create(std::make_shared<ObjectModel>(), camera, {}, std::nullopt)), HasSubstr("line"));

  auto broken = std::make_shared<ObjectModel>(*cube);
  broken->lines[3].p2.x() = std::numeric_limits<double>::infinity();
  EXPECT_THAT(message(Tracker::Create(broken, camera, {}, std::nullopt)), HasSubstr("line 3"));

  CameraModel no_focus = camera;
  no_focus.fx_px = 0.0;
  EXPECT_FALSE(Tracker::Create(cube, no_focus, {}, std::nullopt).ok());

  TrackerOptions options;
  options.mixture.gate_px = -1.0;
  EXPECT_THAT(message(Tracker::Create(cube, camera, options, std::nullopt)), HasSubstr("mixture.gate_px"));

  RigidTransform pose = MakePose({0.0, 0.0, 0.0}, {0.0, 0.0, 0.0});
  EXPECT_THAT(message(Tracker::Create(cube, camera, {}, pose)), HasSubstr("initial_camera_from_object"));
  pose.translation_m.z() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(message(Tracker::Create(cube, camera, {}, pose)), HasSubstr("initial_camera_from_object"));
}

TEST(TrackStateName, NamesAll) {
  EXPECT_EQ(TrackStateName(TrackState::kInitializing), "INITIALIZING");
  EXPECT_EQ(TrackStateName(TrackState::kTracking), "TRACKING");
  EXPECT_EQ(TrackStateName(TrackState::kDegraded), "DEGRADED");
  EXPECT_EQ(TrackStateName(TrackState::kAmbiguous), "AMBIGUOUS");
  EXPECT_EQ(TrackStateName(TrackState::kLost), "LOST");
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/detection/event_stretch.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "core/detection/moving_edges_testing.h"

namespace evpose {
namespace {

using testing::EdgeEventOptions;
using testing::MakeEdgeEvents;
using testing::MovingEdge;

class StretchFollowsSpeed : public ::testing::TestWithParam<double> {};

TEST_P(StretchFollowsSpeed, InAnyDirection) {
  const double speed = GetParam();
  const double duration_s = std::min(0.05, 30.0 / speed);
  for (const double angle : {0.0, 0.4, 0.8, 1.2, 1.57, 2.5}) {
    const Eigen::Vector2d along(std::cos(angle), std::sin(angle)), normal(-along.y(), along.x());
    const Eigen::Vector2d middle(320.0, 240.0);
    const std::vector<PixelEvent> events =
        MakeEdgeEvents({MovingEdge{middle - 100.0 * along, middle + 100.0 * along, speed * normal}},
                       EdgeEventOptions{.duration_s = duration_s});
    StretchSelector selector({}, 640, 480);
    const EventStretch stretch = selector.Select(events);
    EXPECT_GT(stretch.speed_px_per_s, 0.6 * speed) << angle;
    EXPECT_LT(stretch.speed_px_per_s, 1.6 * speed) << angle;
    const double motion_px = 2.0 * stretch.half_duration_s() * speed;
    EXPECT_GT(motion_px, 0.6 * StretchOptions().motion_px) << angle;
    EXPECT_LT(motion_px, 1.7 * StretchOptions().motion_px) << angle;
    EXPECT_EQ(stretch.t_end_us, events.back().t_us);
  }
}

INSTANTIATE_TEST_SUITE_P(Speeds, StretchFollowsSpeed, ::testing::Values(200.0, 800.0, 3000.0),
                         [](const auto& speed) { return "PxPerS" + std::to_string(static_cast<int>(speed.param)); });

TEST(StretchSelector, TakesTheTimeThatASlowObjectNeeds) {
  const double speed = 15.0;
  const std::vector<PixelEvent> events =
      MakeEdgeEvents({MovingEdge{{200.0, 100.0}, {230.0, 300.0}, {speed, 0.0}}}, EdgeEventOptions{.duration_s = 0.8});
  StretchSelector selector({}, 640, 480);
  const EventStretch stretch = selector.Select(events);
  const double motion_px = 2.0 * stretch.half_duration_s() * speed;
  EXPECT_GT(motion_px, 0.6 * StretchOptions().motion_px);
  EXPECT_LT(motion_px, 1.7 * StretchOptions().motion_px);
}

TEST(StretchSelector, TakesTheMaximumDurationForAnObjectThatHardlyMoves) {
  const std::vector<PixelEvent> events =
      MakeEdgeEvents({MovingEdge{{200.0, 100.0}, {230.0, 300.0}, {1.0, 0.0}}}, EdgeEventOptions{.duration_s = 1.5});
  StretchSelector selector({}, 640, 480);
  const EventStretch stretch = selector.Select(events);
  EXPECT_NEAR(static_cast<double>(stretch.t_end_us - stretch.t_begin_us), 1e6, 2e4);
}

TEST(StretchSelector, FastObjectAfterASlowOneHasAShortStretch) {
  std::vector<PixelEvent> events =
      MakeEdgeEvents({MovingEdge{{200.0, 100.0}, {230.0, 300.0}, {5.0, 0.0}}}, EdgeEventOptions{.duration_s = 0.7});
  const std::vector<PixelEvent> fast =
      MakeEdgeEvents({MovingEdge{{210.0, 100.0}, {240.0, 300.0}, {600.0, 0.0}}},
                     EdgeEventOptions{.duration_s = 0.05, .t_begin_us = events.back().t_us});
  events.insert(events.end(), fast.begin(), fast.end());
  StretchSelector selector({}, 640, 480);
  const EventStretch stretch = selector.Select(events);
  EXPECT_LT(stretch.t_end_us - stretch.t_begin_us, 17'000);
}

TEST(StretchSelector, FollowsSlowSpeedsOverLongTimes) {
  // The duration exceeds 65535 microseconds, the range of 16 bits.
  const double speed = 40.0;
  const std::vector<PixelEvent> events =
      MakeEdgeEvents({MovingEdge{{200.0, 100.0}, {230.0, 300.0}, {speed, 0.0}}}, EdgeEventOptions{.duration_s = 0.8});
  StretchOptions options;
  options.max_duration_us = options.max_slow_duration_us = 1'000'000;
  StretchSelector selector(options, 640, 480);
  const EventStretch first = selector.Select(events);
  EXPECT_GT(first.speed_px_per_s, 0.6 * speed);
  EXPECT_LT(first.speed_px_per_s, 1.6 * speed);
  EXPECT_EQ(selector.Select(events).speed_px_per_s, first.speed_px_per_s);
}

TEST(StretchSelector, DownsamplesUniformlyToItsBound) {
  const std::vector<PixelEvent> events = MakeEdgeEvents({MovingEdge{{100.0, 100.0}, {500.0, 300.0}, {300.0, -100.0}}},
                                                        EdgeEventOptions{.events_per_px2 = 20.0});
  StretchOptions options;
  options.max_events = 2000;
  StretchSelector selector(options, 640, 480);
  const EventStretch stretch = selector.Select(events);
  EXPECT_EQ(stretch.events.size(), 2000u);
  int late = 0;
  for (const StretchEvent& event : stretch.events) late += event.tau_s > 0.0f;
  EXPECT_NEAR(late, 1000, 150);
}

TEST(StretchSelector, IgnoresEventsOutsideTheMap) {
  const float nan = std::numeric_limits<float>::quiet_NaN(), infinity = std::numeric_limits<float>::infinity();
  std::vector<PixelEvent> events;
  for (const float u : {nan, infinity, -infinity, 1e30f, -1e30f, -161.0f, 801.0f}) {
    events.push_back({10, u, 100.0f, 1});
    events.push_back({10, 100.0f, u, 0});
  }
  events.push_back({10, -100.0f, -100.0f, 7});
  StretchSelector selector({}, 640, 480);
  const EventStretch stretch = selector.Select(events);
  ASSERT_EQ(stretch.events.size(), 1u);
  EXPECT_EQ(stretch.events[0].u_px, -100.0f);
  EXPECT_EQ(stretch.events[0].polarity, 1);
}

TEST(LastTimes, KeepsTheLastTimeOfAsManyKeysAsItIsMadeFor) {
  LastTimes times;
  const auto key = [](size_t i) { return static_cast<uint32_t>(i * 1259); };  // as of pixels far from each other
  for (int round = 0; round < 2; ++round) {
    times.Clear();
    EXPECT_EQ(times.Get(key(0)), LastTimes::kNever);
    for (size_t i = 0; i < LastTimes::kMaxKeys; ++i) times.Set(key(i), 7);
    for (size_t i = 0; i < LastTimes::kMaxKeys; ++i) times.Set(key(i), static_cast<uint16_t>(i % 1000 + round));
    for (size_t i = 0; i < LastTimes::kMaxKeys; ++i) {
      ASSERT_EQ(times.Get(key(i)), i % 1000 + round);
      ASSERT_EQ(times.Get(key(i) + 1), LastTimes::kNever);
    }
  }
}

TEST(StretchOptions, NamesTheFieldThatIsWrong) {
  EXPECT_TRUE(StretchOptions().Validate().ok());
  const auto message = [](auto change) {
    StretchOptions options;
    change(options);
    return std::string(options.Validate().message());
  };
  EXPECT_NE(message([](auto& o) { o.motion_px = 0.0; }).find("motion_px"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.motion_px = std::nan(""); }).find("motion_px"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.max_duration_us = 0; }).find("max_duration_us"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.max_slow_duration_us = o.max_duration_us - 1; }).find("max_slow_duration_us"),
            std::string::npos);
  EXPECT_NE(message([](auto& o) { o.max_events = 0; }).find("max_events"), std::string::npos);
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/association/near_events.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "core/association/camera_tables.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

constexpr int kMaxEvents = 200;
constexpr int64_t kWindowUs = 1000;

// A vertical line in the middle of the image; events within 4 px of it, or 100 px away from it.
class NearEventsTest : public ::testing::Test {
 protected:
  NearEventsTest() {
    lines_.resize(1);
    lines_[0].p1_px = {320.0, 100.0};
    lines_[0].direction = {0.0, 1.0};
    lines_[0].length_px = 300.0;
    grid_.Build(lines_, 12.0);
  }
  void Add(int count, uint8_t polarity, bool is_near = true) {
    for (int i = 0; i < count; ++i) {
      const double x = (is_near ? 320.0 : 420.0) + random_.Uniform(-4.0, 4.0);
      WindowEvent event;
      event.x = static_cast<uint16_t>(x);
      event.y = static_cast<uint16_t>(random_.Uniform(120.0, 380.0));
      event.polarity = polarity;
      events_.push_back(event);
    }
  }
  EventSampling Find(ByPolarity events_per_sample = {1.0, 1.0}) {
    for (size_t i = events_.size(); i > 1; --i) std::swap(events_[i - 1], events_[random_.UniformInt(i)]);
    EventWindow window;
    window.t_end_us = kWindowUs;
    window.events = events_;
    window.num_events = events_.size();
    window.events_per_sample = events_per_sample;
    const EventSampling sampling = near_.Find(window, grid_, kMaxEvents, background_);
    const absl::Span<const Observation> found =
        near_.Observe(window, grid_, lines_, kWindowUs / 2, 1000.0, [](const Observation&) { return 0.0f; });
    EXPECT_LE(found.size(), static_cast<size_t>(kMaxEvents));
    num_found_ = {};
    for (const Observation& event : found) ++num_found_[event.polarity];
    background_.CloseWindow(grid_, 1e-6 * kWindowUs);
    events_.clear();
    return sampling;
  }

  const CameraModel camera_ = testing::MakeCamera(640, 480, 600.0);
  const std::shared_ptr<const CameraTables> tables_ = MakeCameraTables(camera_).value();
  std::vector<ImageLine> lines_;
  TileGrid grid_{camera_};
  BackgroundRate background_{camera_};
  NearEvents near_{camera_, *tables_, 1};
  Random random_{7};
  std::vector<WindowEvent> events_;
  std::array<int, 2> num_found_ = {};
};

TEST_F(NearEventsTest, KeepsAllOfFewEvents) {
  Add(30, 0);
  Add(100, 1);
  Add(50, 1, false);
  const EventSampling sampling = Find();
  EXPECT_EQ(num_found_, (std::array<int, 2>{30, 100}));
  EXPECT_EQ(sampling.events_per_observation, (ByPolarity{1.0, 1.0}));
  EXPECT_EQ(sampling.mean_events_per_observation, 1.0);
  EXPECT_EQ(sampling.observations_per_background_event, 1.0);
}

TEST_F(NearEventsTest, DownsamplesAFlickerBurstMore) {
  for (int i = 0; i < 40; ++i) {
    const bool is_on = i / 5 % 2 != 0;  // the rising and falling light of a lamp
    Add(is_on ? 100 : 2000, 0);
    Add(is_on ? 2000 : 100, 1);
    const EventSampling sampling = Find();
    if (i < 10) continue;
    EXPECT_GT(num_found_[is_on ? 0 : 1], 60) << i;
    EXPECT_LT(sampling.events_per_observation[is_on ? 0 : 1], 1.7) << i;
    EXPECT_GT(sampling.events_per_observation[is_on ? 1 : 0], 10.0) << i;
    EXPECT_EQ(sampling.polarity_weight[is_on ? 0 : 1], 1.0) << i;
    EXPECT_LT(sampling.polarity_weight[is_on ? 1 : 0], 0.25) << i;
  }
}

TEST_F(NearEventsTest, AUsualExcessOfOnePolarityIsSampledInItsRatio) {
  for (int i = 0; i < 200; ++i) {
    Add(200, 0);
    Add(1800, 1);
    EXPECT_GT(Find().polarity_weight[1], i < 100 ? 0.0 : 0.999);
  }
  EXPECT_NEAR(num_found_[0], 20, 3);
  EXPECT_NEAR(num_found_[1], 180, 3);
}

TEST_F(NearEventsTest, SharesCountTheEventsOfTheSensor) {
  Add(100, 0);
  Add(300, 1);
  Add(10, 0, false);
  Add(30, 1, false);
  const EventSampling sampling = Find({8.0, 1.0});
  const double seen_off = num_found_[0] * sampling.events_per_observation[0];
  const double seen_on = num_found_[1] * sampling.events_per_observation[1];
  EXPECT_NEAR(seen_off, 800.0, 1e-9);
  EXPECT_NEAR(seen_on, 300.0, 1e-9);
  EXPECT_NEAR(sampling.mean_events_per_observation, 1100.0 / (num_found_[0] + num_found_[1]), 1e-9);
  const double background = 80.0 / sampling.events_per_observation[0] + 30.0 / sampling.events_per_observation[1];
  EXPECT_NEAR(sampling.observations_per_background_event, background / 110.0, 1e-9);
}

}  // namespace
}  // namespace evpose

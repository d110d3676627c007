// SPDX-License-Identifier: Apache-2.0
#include "core/detection/flicker_filter.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/numerics/random.h"

namespace evpose {
namespace {

constexpr float kEdge = 1.0f;     // PixelEvent::u_px of the events of edges
constexpr float kSurface = 2.0f;  // PixelEvent::u_px of the events that a lamp causes on surfaces

class FlickerFilterTest : public ::testing::Test {
 protected:
  // Adds these numbers of events of each polarity in each millisecond of [begin_ms, end_ms).
  void Add(int begin_ms, int end_ms, double num_off, double num_on, float u_px = kEdge) {
    for (int ms = begin_ms; ms < end_ms; ++ms) {
      for (int polarity = 0; polarity < 2; ++polarity) {
        const uint32_t count = random_.Poisson(polarity == 0 ? num_off : num_on);
        for (uint32_t i = 0; i < count; ++i) {
          const auto t_us = int64_t{1000} * ms + static_cast<int64_t>(random_.UniformInt(1000));
          events_.push_back({t_us, u_px, 0.0f, static_cast<uint8_t>(polarity)});
        }
      }
    }
  }
  double KeptRatio(float u_px) {
    std::stable_sort(events_.begin(), events_.end(), [](const auto& a, const auto& b) { return a.t_us < b.t_us; });
    const auto is_of = [u_px](const PixelEvent& event) { return event.u_px == u_px; };
    const absl::Span<const PixelEvent> kept = filter_.Remove(events_);
    return static_cast<double>(std::count_if(kept.begin(), kept.end(), is_of)) /
           static_cast<double>(std::count_if(events_.begin(), events_.end(), is_of));
  }

  Random random_{5};
  std::vector<PixelEvent> events_;
  FlickerFilter filter_;
};

TEST_F(FlickerFilterTest, RemovesFlickerAndKeepsEdges) {
  Add(0, 25, 300.0, 200.0);
  for (int ms = 0; ms < 25; ++ms) {
    const double flood = 6000.0 * std::sin(2.0 * std::numbers::pi * ms / 10.0);
    Add(ms, ms + 1, std::max(0.0, -flood), std::max(0.0, flood), kSurface);
  }
  EXPECT_LT(KeptRatio(kSurface), 0.02);
  EXPECT_GT(KeptRatio(kEdge), 0.5);  // the edge events with the polarity opposite to the change of the light
}

TEST_F(FlickerFilterTest, KeepsTheEventsOfAnObjectThatStartsToMove) {
  Add(0, 10, 20.0, 30.0);
  Add(10, 20, 1500.0, 2000.0);
  EXPECT_EQ(KeptRatio(kEdge), 1.0);
}

TEST_F(FlickerFilterTest, KeepsAConstantExcessOfOnePolarity) {
  Add(0, 20, 30.0, 3000.0);
  EXPECT_GT(KeptRatio(kEdge), 0.95);
}

TEST_F(FlickerFilterTest, IsEmptyWithoutEvents) { EXPECT_TRUE(filter_.Remove({}).empty()); }

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/event_extent.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "core/base/yield_point.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

constexpr int kWidthPx = 320;
constexpr int kHeightPx = 240;

// Events that are spread over the image.
std::vector<PixelEvent> EvenEvents(int count, Random& random) {
  std::vector<PixelEvent> events;
  for (int k = 0; k < count; ++k) {
    events.push_back(
        {k, static_cast<float>(random.Uniform(0.0, kWidthPx)), static_cast<float>(random.Uniform(0.0, kHeightPx)), 1});
  }
  return events;
}

// Adds events on the outline of a square that moves to the right by `motion_px` in all, in the order of time.
void AddSquare(double side_px, double motion_px, int count, Random& random, std::vector<PixelEvent>& events) {
  for (int k = 0; k < count; ++k) {
    const double along_px = random.Uniform(0.0, side_px);
    const double across_px = k % 2 == 0 ? 0.0 : side_px;
    const double shift_px = motion_px * k / count;
    const bool is_upright = k % 4 < 2;
    events.push_back({int64_t{10} * k, static_cast<float>(150.0 + shift_px + (is_upright ? across_px : along_px)),
                      static_cast<float>(100.0 + (is_upright ? along_px : across_px)), 1});
  }
  std::stable_sort(events.begin(), events.end(),
                   [](const PixelEvent& a, const PixelEvent& b) { return a.t_us < b.t_us; });
}

TEST(EventExtent, IsTheSideOfTheObjectAndNotTheLengthOfItsPath) {
  for (const double side_px : {12.0, 30.0, 90.0}) {
    Random random(3);
    std::vector<PixelEvent> events = EvenEvents(3000, random);
    AddSquare(side_px, 0.5 * side_px, 1500, random, events);
    EXPECT_NEAR(EventExtentPx(events, kWidthPx, kHeightPx), side_px, 0.15 * side_px + 2.0) << side_px;
  }
}

TEST(EventExtent, IsZeroInNoiseAndForDefectivePixels) {
  Random random(5);
  std::vector<PixelEvent> events = EvenEvents(5000, random);
  EXPECT_EQ(EventExtentPx(events, kWidthPx, kHeightPx), 0);
  for (int k = 0; k < 300; ++k) events.push_back({6000 + k, 33.5f, 44.5f, 1});
  EXPECT_EQ(EventExtentPx(events, kWidthPx, kHeightPx), 0);
  EXPECT_EQ(EventExtentPx({}, kWidthPx, kHeightPx), 0);
}

class YieldCounter : public Yielder {
 public:
  void Yield() override { ++count; }
  size_t count = 0;
};

// A search after a long wait has many events.
TEST(EventExtent, YieldsInEachPassOverTheEvents) {
  Random random(3);
  std::vector<PixelEvent> events = EvenEvents(3000, random);
  AddSquare(90.0, 45.0, 60'000, random, events);
  YieldCounter yields;
  {
    const ScopedYielder scope(yields);
    EXPECT_GT(EventExtentPx(events, kWidthPx, kHeightPx), 0);
  }
  EXPECT_GE(yields.count, 3 * events.size() / 64);
}

TEST(EventExtent, IgnoresEventsOutsideTheImage) {
  std::vector<PixelEvent> events;
  for (int k = 0; k < 300; ++k) events.push_back({k, -5.0f - static_cast<float>(k % 20), 400.0f, 1});
  EXPECT_EQ(EventExtentPx(events, kWidthPx, kHeightPx), 0);
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/detection/event_grid.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/numerics/random.h"

namespace evpose {
namespace {

std::vector<int32_t> Near(const EventGrid& grid) {
  std::vector<int32_t> indices;
  grid.Near({20.0, 30.0}, {90.0, 50.0}, 5.0, indices);
  return indices;
}

TEST(EventGrid, TheOrderDoesNotDependOnTheSelectedPolarities) {
  Random random(5);
  std::vector<StretchEvent> events;
  for (int i = 0; i < 2000; ++i) {
    const auto u_px = static_cast<float>(random.Uniform(0.0, 120.0));
    const auto v_px = static_cast<float>(random.Uniform(0.0, 80.0));
    events.push_back({u_px, v_px, 0.0f, static_cast<uint8_t>(random.UniformInt(2))});
  }
  const std::vector<int32_t> both = Near(EventGrid(events));
  EXPECT_LT(both.size(), events.size()) << "distant events are not examined";
  std::vector<int32_t> of_polarity[2];
  for (const int32_t index : both) of_polarity[events[index].polarity].push_back(index);
  ASSERT_FALSE(of_polarity[0].empty() || of_polarity[1].empty());
  EXPECT_EQ(Near(EventGrid(events, {true, false})), of_polarity[0]);
  EXPECT_EQ(Near(EventGrid(events, {false, true})), of_polarity[1]);
  EXPECT_THAT(Near(EventGrid(events, {false, false})), ::testing::IsEmpty());
}

TEST(EventGrid, IsEmptyWithoutEvents) { EXPECT_THAT(Near(EventGrid({})), ::testing::IsEmpty()); }

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/events/event_bitmap.h"

#include <gtest/gtest.h>

#include <array>
#include <random>
#include <vector>

namespace evpose {
namespace {

// The two bits of a cell, from the definition of the format.
int CellOf(const EventBitmap& bitmap, int x, int y) {
  const size_t number = static_cast<size_t>(y) * static_cast<size_t>(bitmap.width()) + static_cast<size_t>(x);
  return (bitmap.bytes()[number / 4] >> (number % 4 * 2)) & 3;
}

class EventBitmapTest : public testing::TestWithParam<int> {};

// Odd sizes, so that cells at two borders are incomplete and the rows begin within a byte.
TEST_P(EventBitmapTest, EachEventSetsTheBitOfItsCellAlone) {
  constexpr SensorGeometry kOddSensor = {13, 7};
  const int cell_px = GetParam();
  for (uint16_t y = 0; y < kOddSensor.height_px; ++y) {
    for (uint16_t x = 0; x < kOddSensor.width_px; ++x) {
      for (const uint8_t polarity : {0, 1}) {
        EventBitmap bitmap(kOddSensor, cell_px);
        bitmap.Add(std::vector<Event>{{5, x, y, polarity}});
        for (int row = 0; row < bitmap.height(); ++row) {
          for (int column = 0; column < bitmap.width(); ++column) {
            const bool is_its_own = column == x / cell_px && row == y / cell_px;
            EXPECT_EQ(CellOf(bitmap, column, row), is_its_own ? (polarity == 1 ? 1 : 2) : 0);
          }
        }
      }
    }
  }
}

TEST_P(EventBitmapTest, HoldsTheUnionOfEvents) {
  constexpr SensorGeometry kOtherSensor = {37, 22};
  const int cell_px = GetParam();
  EventBitmap at_once(kOtherSensor, cell_px), first(kOtherSensor, cell_px), second(kOtherSensor, cell_px);
  std::mt19937 random(7);
  std::vector<Event> events;
  std::array<std::array<int, 37>, 22> expected = {};
  for (int i = 0; i < 200; ++i) {
    const Event event = {i, static_cast<uint16_t>(random() % 37), static_cast<uint16_t>(random() % 22),
                         static_cast<uint8_t>(random() % 2)};
    events.push_back(event);
    expected[event.y / cell_px][event.x / cell_px] |= event.polarity == 1 ? 1 : 2;
  }
  const absl::Span<const Event> all = events;
  at_once.Add(all);
  first.Add(all.first(90));
  second.Add(all.subspan(90));
  EXPECT_NE(first.bytes(), at_once.bytes());
  first.Add(second);
  EXPECT_EQ(first.bytes(), at_once.bytes());
  for (int y = 0; y < at_once.height(); ++y) {
    for (int x = 0; x < at_once.width(); ++x) EXPECT_EQ(CellOf(at_once, x, y), expected[y][x]);
  }
  at_once.Clear();
  EXPECT_EQ(at_once.bytes(), EventBitmap(kOtherSensor, cell_px).bytes());
}

INSTANTIATE_TEST_SUITE_P(Cells, EventBitmapTest, testing::Values(1, 2, 4));

TEST(EventBitmapSizeTest, RoundsUp) {
  EXPECT_EQ(EventBitmap::NumBytes({1280, 720}, 1), 230'400u);
  EXPECT_EQ(EventBitmap::NumBytes({1280, 720}, 2), 57'600u);
  EXPECT_EQ(EventBitmap::NumBytes({1280, 720}, 4), 14'400u);
  EXPECT_EQ(EventBitmap::NumBytes({1, 1}, 4), 1u);
  EXPECT_EQ(EventBitmap::NumBytes({5, 3}, 2), 2u);  // 3 x 2 cells
  const EventBitmap bitmap({5, 3}, 4);
  EXPECT_EQ(bitmap.width(), 2);
  EXPECT_EQ(bitmap.height(), 1);
  EXPECT_EQ(bitmap.cell_px(), 4);
}

TEST(EventBitmapSizeTest, IgnoresEventsOutsideTheSensor) {
  EventBitmap bitmap({5, 3}, 2);
  bitmap.Add(std::vector<Event>{{1, 5, 0, 1}, {1, 0, 3, 1}, {1, 65'535, 65'535, 0}});
  EXPECT_EQ(bitmap.bytes(), EventBitmap({5, 3}, 2).bytes());
}

}  // namespace
}  // namespace evpose

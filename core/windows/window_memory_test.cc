// SPDX-License-Identifier: Apache-2.0
#include "core/windows/window_memory.h"

#include <gtest/gtest.h>

namespace evpose {
namespace {

std::vector<WindowEvent> MakeEvents(size_t count, int64_t t_us) {
  std::vector<WindowEvent> events;
  for (size_t i = 0; i < count; ++i) events.push_back({{t_us, static_cast<uint16_t>(i), 7, 1}});
  return events;
}

EventWindow MakeWindow(int64_t begin_us, int64_t end_us, const std::vector<WindowEvent>& events) {
  return {begin_us, end_us, events, 2 * events.size(), true, {3.0, 2.0}};
}

TEST(WindowMemory, KeepsWindowsUnchanged) {
  WindowMemory memory(10'000, 100, 1000);
  const std::vector<WindowEvent> events = MakeEvents(30, 1500);
  memory.Add(MakeWindow(1000, 2000, events));
  ASSERT_EQ(memory.size(), 1u);
  const EventWindow window = memory.At(0);
  EXPECT_EQ(window.t_begin_us, 1000);
  EXPECT_EQ(window.t_end_us, 2000);
  EXPECT_EQ(window.num_events, 60u);
  EXPECT_TRUE(window.has_few_events);
  EXPECT_EQ(window.events_per_sample, (ByPolarity{3.0, 2.0}));
  ASSERT_EQ(window.events.size(), 30u);
  EXPECT_EQ(window.events[29].x, 29);
}

TEST(WindowMemory, RemovesWindowsOlderThanItsMemory) {
  WindowMemory memory(3000, 100, 1000);
  for (int64_t t_us = 0; t_us < 10'000; t_us += 1000) {
    memory.Add(MakeWindow(t_us, t_us + 1000, MakeEvents(5, t_us)));
  }
  ASSERT_EQ(memory.size(), 3u);
  EXPECT_EQ(memory.At(0).t_begin_us, 7000);
  EXPECT_EQ(memory.num_events(), 15u);
  memory.Add(MakeWindow(500'000, 501'000, {}));
  EXPECT_EQ(memory.size(), 1u);
}

TEST(WindowMemory, DownsamplesUniformly) {
  WindowMemory memory(10'000, 100, 1000);
  memory.Add(MakeWindow(0, 1000, MakeEvents(1000, 10)));
  const EventWindow window = memory.At(0);
  EXPECT_LE(window.events.size(), 100u);
  EXPECT_GE(window.events.size(), 98u);
  EXPECT_EQ(window.num_events, 2000u);
  int first_half = 0;
  for (const Event& event : window.events) first_half += event.x < 500;
  EXPECT_NEAR(first_half, 50, 2);
  EXPECT_EQ(window.events_per_sample[0], 3.0);
  EXPECT_DOUBLE_EQ(window.events_per_sample[1], 2000.0 / static_cast<double>(window.events.size()));
}

TEST(WindowMemory, RemovesOldWindowsAboveTheEventLimit) {
  WindowMemory memory(1'000'000, 100, 250);
  for (int64_t t_us = 0; t_us < 5000; t_us += 1000) memory.Add(MakeWindow(t_us, t_us + 1000, MakeEvents(100, t_us)));
  EXPECT_EQ(memory.size(), 2u);
  EXPECT_EQ(memory.num_events(), 200u);
  EXPECT_EQ(memory.At(0).t_begin_us, 3000);
  memory.Clear();
  EXPECT_EQ(memory.size(), 0u);
  EXPECT_EQ(memory.num_events(), 0u);
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/association/line_events.h"

#include <gtest/gtest.h>

#include <map>

#include "core/numerics/random.h"

namespace evpose {
namespace {

constexpr size_t kNumLines = 5;

std::vector<Observation> SomeEvents(int count) {
  Random random(4);
  std::vector<Observation> events;
  for (int i = 0; i < count; ++i) {
    Observation event;
    event.bx = random.Uniform(-0.3, 0.3);
    event.by = random.Uniform(-0.3, 0.3);
    event.u_px = 640.0 + 1000.0 * event.bx;
    event.v_px = 360.0 + 1000.0 * event.by;
    event.tau_s = random.Uniform(-5e-4, 5e-4);
    event.polarity = static_cast<uint8_t>(random.UniformInt(2));
    event.previous = static_cast<PreviousPolarity>(random.UniformInt(3));
    event.others_per_px = static_cast<float>(random.Uniform());
    event.num_lines = static_cast<uint8_t>(random.UniformInt(4));
    for (int k = 0; k < event.num_lines; ++k) event.lines[k] = static_cast<uint16_t>((i + k) % kNumLines);
    events.push_back(event);
  }
  return events;
}

bool IsAt(const Observation& event, const LineGroup& group, const EventLanes& lanes, int lane) {
  constexpr double kReversalProbability[] = {0.5, 0.0, 1.0};
  return group.polarity == event.polarity && lanes.is_event[lane] == 1.0f &&
         std::abs(group.origin.x() + lanes.bx[lane] - event.bx) < 1e-7 &&
         std::abs(group.origin.y() + lanes.by[lane] - event.by) < 1e-7 &&
         std::abs(group.origin_px.x() + lanes.u_px[lane] - event.u_px) < 1e-4 &&
         std::abs(group.origin_px.y() + lanes.v_px[lane] - event.v_px) < 1e-4 &&
         std::abs(lanes.tau_s[lane] - event.tau_s) < 1e-10 && lanes.others_per_px[lane] == event.others_per_px &&
         lanes.reversal_probability[lane] == kReversalProbability[static_cast<int>(event.previous)];
}

TEST(LineEvents, ContainEveryEventOnceForEachOfItsLines) {
  const std::vector<Observation> events = SomeEvents(500);
  const LineEvents sorted(events, kNumLines);
  // Number of events of each line, shared or not.
  std::map<std::pair<int, bool>, int> expected, found;
  for (const Observation& event : events) {
    for (const uint16_t line : event.Lines()) ++expected[{line, event.num_lines > 1}];
  }
  for (const LineGroup& group : sorted.groups()) {
    for (const EventLanes& lanes : group.events) {
      for (int lane = 0; lane < kNumLanes; ++lane) {
        if (lanes.is_event[lane] == 0.0f) continue;
        ++found[{group.line, group.is_shared}];
        const bool is_there = std::any_of(events.begin(), events.end(), [&](const Observation& event) {
          const absl::Span<const uint16_t> lines = event.Lines();
          return std::find(lines.begin(), lines.end(), group.line) != lines.end() &&
                 (lines.size() > 1) == group.is_shared && IsAt(event, group, lanes, lane);
        });
        EXPECT_TRUE(is_there);
      }
    }
  }
  EXPECT_EQ(found, expected);
}

TEST(LineEvents, LocateTheSharedEvents) {
  const std::vector<Observation> events = SomeEvents(500);
  const LineEvents sorted(events, kNumLines);
  size_t next = 0;
  size_t num_lanes = 0;
  for (const LineGroup& group : sorted.groups()) num_lanes += group.is_shared ? group.events.size() : 0;
  EXPECT_EQ(sorted.num_shared_lanes(), num_lanes);
  for (const Observation& event : events) {
    if (event.num_lines < 2) continue;
    const LineEvents::Shared& shared = sorted.shared()[next++];
    EXPECT_EQ(shared.others_per_px, event.others_per_px);
    ASSERT_EQ(shared.Places().size(), event.num_lines);
    for (int k = 0; k < event.num_lines; ++k) {
      const uint32_t place = shared.places[k];
      const auto group = std::find_if(sorted.groups().begin(), sorted.groups().end(), [&](const LineGroup& of) {
        return of.is_shared && of.first <= place / kNumLanes && place / kNumLanes < of.first + of.events.size();
      });
      ASSERT_NE(group, sorted.groups().end());
      EXPECT_EQ(group->line, event.lines[k]);
      EXPECT_TRUE(IsAt(event, *group, group->events[place / kNumLanes - group->first], place % kNumLanes));
    }
  }
  EXPECT_EQ(next, sorted.shared().size());
}

TEST(LineEvents, AreEmptyWithoutEvents) {
  LineEvents sorted(SomeEvents(50), kNumLines);
  sorted.Sort({}, kNumLines);
  EXPECT_TRUE(sorted.groups().empty());
  EXPECT_TRUE(sorted.shared().empty());
  EXPECT_EQ(sorted.num_shared_lanes(), 0u);
  sorted.Sort({}, 0);
  EXPECT_TRUE(sorted.groups().empty());
}

}  // namespace
}  // namespace evpose

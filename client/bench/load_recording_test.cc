// SPDX-License-Identifier: Apache-2.0
#include "client/bench/load_recording.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>

#include "core/base/byte_order.h"
#include "core/events/decoder.h"

namespace evpose::client {
namespace {

// The events of some chunks, as a decoder reads them.
std::vector<Event> Decode(const LoadRecording& recording, uint64_t num_chunks, DecodeCounts& counts) {
  const std::unique_ptr<EventDecoder> decoder = MakeEventDecoder(Encoding::kEvt3, recording.scene().geometry).value();
  DecodedEvents decoded;
  for (uint64_t i = 0; i < num_chunks; ++i) {
    const std::string payload = recording.Payload(i);
    EXPECT_EQ(payload.size() % 2, 0u);
    decoder->Decode(AsBytes(payload), decoded);
  }
  counts = decoder->counts();
  return {decoded.events.begin(), decoded.events.end()};
}

TEST(LoadRecordingTest, RepetitionsHaveTheSameEventsAtLaterTimes) {
  const auto recording = LoadRecording::Make(2e5, 1000);
  ASSERT_TRUE(recording.ok()) << recording.status();
  EXPECT_EQ(recording->period_us() % 4096, 0);
  const auto per_period = static_cast<uint64_t>(recording->period_us() / 1000);
  // Beyond a wrap of the clock, which comes after 16.8 s.
  const uint64_t num_periods = 2 + (uint64_t{1} << 24) / static_cast<uint64_t>(recording->period_us());
  DecodeCounts counts;
  const std::vector<Event> events = Decode(*recording, num_periods * per_period, counts);
  EXPECT_EQ(counts.clock_wraps, 1u);
  EXPECT_EQ(counts.invalid_words() + counts.dropped_events() + counts.time_backsteps, 0u);
  uint64_t num_events = 0;
  for (uint64_t i = 0; i < per_period; ++i) num_events += recording->NumEvents(i);
  EXPECT_NEAR(1e6 * static_cast<double>(num_events) / static_cast<double>(recording->period_us()), 2e5, 1e3);
  ASSERT_EQ(events.size(), num_periods * num_events);
  uint64_t num_different = 0;
  for (size_t i = 0; i + num_events < events.size(); ++i) {
    Event later = events[i];
    later.t_us += recording->period_us();
    num_different += later == events[i + num_events] ? 0 : 1;
  }
  EXPECT_EQ(num_different, 0u);
}

TEST(LoadRecordingTest, TheSecondHalfIsTheWayBack) {
  const auto recording = LoadRecording::Make(1e5, 2000);
  ASSERT_TRUE(recording.ok()) << recording.status();
  DecodeCounts counts;
  const std::vector<Event> events = Decode(*recording, static_cast<uint64_t>(recording->period_us() / 2000), counts);
  ASSERT_EQ(events.size() % 2, 0u);
  // The sums over both halves are equal but for the polarity.
  uint64_t sum_x[2] = {}, sum_on[2] = {};
  int64_t sum_t[2] = {};
  for (const Event& event : events) {
    const int half = event.t_us < recording->period_us() / 2 ? 0 : 1;
    sum_x[half] += event.x;
    sum_on[half] += event.polarity;
    sum_t[half] += half == 0 ? event.t_us : recording->period_us() - 1 - event.t_us;
  }
  EXPECT_EQ(sum_x[0], sum_x[1]);
  EXPECT_EQ(sum_t[0], sum_t[1]);
  EXPECT_EQ(sum_on[0] + sum_on[1], events.size() / 2);
}

TEST(LoadRecordingTest, RefusesValuesOutsideTheirLimits) {
  EXPECT_EQ(LoadRecording::Make(10.0, 1000).status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(LoadRecording::Make(1e9, 1000).status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(LoadRecording::Make(1e5, 1).status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(LoadRecording::Make(1e5, 1000, [](double) { return false; }).status().code(), absl::StatusCode::kCancelled);
}

}  // namespace
}  // namespace evpose::client

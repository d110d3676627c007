// SPDX-License-Identifier: Apache-2.0
#include "core/events/encoder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "core/events/events_testing.h"

namespace evpose {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

std::vector<uint8_t> EncodeAll(Encoding encoding, SensorGeometry geometry, absl::Span<const Event> events) {
  std::vector<uint8_t> bytes;
  const absl::Status status = MakeEventEncoder(encoding, geometry).value()->Encode(events, bytes);
  EXPECT_TRUE(status.ok()) << status;
  return bytes;
}

// Random events: rows with neighbours, pauses up to `max_gap_us`, and several events at one time.
std::vector<Event> RandomEvents(SensorGeometry geometry, int64_t first_us, int64_t max_gap_us, size_t count,
                                Random& random) {
  std::vector<Event> events;
  Event event{first_us, 0, 0, 0};
  while (events.size() < count) {
    if (random.UniformInt(3) > 0) event.t_us += static_cast<int64_t>(random.UniformInt(40));
    if (random.UniformInt(50) == 0) event.t_us += static_cast<int64_t>(random.UniformInt(max_gap_us));
    if (random.UniformInt(2) == 0) event.y = static_cast<uint16_t>(random.UniformInt(geometry.height_px));
    event.polarity = static_cast<uint8_t>(random.UniformInt(2));
    event.x = static_cast<uint16_t>(random.UniformInt(geometry.width_px));
    const size_t run = random.UniformInt(3) == 0 ? 1 + random.UniformInt(70) : 1;
    for (size_t i = 0; i < run && event.x < geometry.width_px; ++i) {
      events.push_back(event);
      event.x = static_cast<uint16_t>(event.x + 1 + (random.UniformInt(4) == 0));
    }
  }
  return events;
}

struct RoundTripCase {
  Encoding encoding;
  SensorGeometry geometry;
};

class RoundTripTest : public testing::TestWithParam<RoundTripCase> {};

TEST_P(RoundTripTest, EventsAreUnchanged) {
  const auto [encoding, geometry] = GetParam();
  const bool is_flat = encoding == Encoding::kFlat64 || encoding == Encoding::kDat;
  Random random(static_cast<uint64_t>(geometry.width_px));
  // Short pauses, and pauses that pass several wraps of the 24-bit clock; starts before and after wraps.
  for (const int64_t max_gap_us : {int64_t{2000}, int64_t{100000000}, int64_t{2000000000}}) {
    for (const int64_t first_us : {int64_t{0}, int64_t{16777000}, int64_t{913716224}, (int64_t{1} << 34) - 5000}) {
      if (is_flat && first_us >= int64_t{1} << 32) continue;
      const std::vector<Event> events = RandomEvents(geometry, first_us, max_gap_us, 1500, random);
      const Decoded decoded = DecodeAll(encoding, geometry, EncodeAll(encoding, geometry, events));
      ASSERT_THAT(decoded.out.events, ::testing::ElementsAreArray(events));
      EXPECT_EQ(decoded.counts.dropped_events() + decoded.counts.invalid_words(), 0);
      EXPECT_EQ(decoded.counts.time_backsteps, 0);
    }
  }
}

TEST_P(RoundTripTest, CallsDoNotMatter) {
  const auto [encoding, geometry] = GetParam();
  Random random(3);
  const std::vector<Event> events = RandomEvents(geometry, 5000, 300000, 2000, random);
  const auto encoder = MakeEventEncoder(encoding, geometry).value();
  std::vector<uint8_t> bytes;
  for (size_t begin = 0; begin < events.size();) {
    const size_t size = std::min(events.size() - begin, static_cast<size_t>(random.UniformInt(50)));
    ASSERT_TRUE(encoder->Encode(absl::MakeConstSpan(events).subspan(begin, size), bytes).ok());
    begin += size;
  }
  EXPECT_THAT(DecodeAll(encoding, geometry, bytes).out.events, ::testing::ElementsAreArray(events));
}

TEST_P(RoundTripTest, TimeWordsAdvanceTheTime) {
  const auto [encoding, geometry] = GetParam();
  const auto encoder = MakeEventEncoder(encoding, geometry).value();
  std::vector<uint8_t> bytes;
  std::vector<Event> events;
  for (int64_t t_us = 0; t_us < 200000; t_us += 500) {
    ASSERT_TRUE(encoder->EncodeTime(t_us, bytes).ok());
    if (t_us % 7000 != 0) continue;
    events.push_back({t_us, 0, 0, 1});
    ASSERT_TRUE(encoder->Encode({&events.back(), 1}, bytes).ok());
  }
  const Decoded decoded = DecodeAll(encoding, geometry, bytes);
  EXPECT_THAT(decoded.out.events, ::testing::ElementsAreArray(events));
  if (encoding == Encoding::kFlat64 || encoding == Encoding::kDat) {
    EXPECT_THAT(decoded.out.time_marks, IsEmpty());
    return;
  }
  ASSERT_GT(decoded.out.time_marks.size(), 100);
  EXPECT_GE(decoded.out.time_marks.back().t_us, 198000);
}

std::vector<RoundTripCase> RoundTripCases() {
  std::vector<RoundTripCase> cases;
  for (const Encoding encoding :
       {Encoding::kEvt3, Encoding::kEvt21, Encoding::kEvt2, Encoding::kDat, Encoding::kFlat64}) {
    for (const SensorGeometry geometry : {SensorGeometry{1, 1},
                                          {31, 7},
                                          {33, 1},
                                          {304, 240},
                                          {320, 320},
                                          {346, 260},
                                          {640, 480},
                                          {1280, 720},
                                          {2048, 2048}}) {
      cases.push_back({encoding, geometry});
    }
  }
  return cases;
}

INSTANTIATE_TEST_SUITE_P(All, RoundTripTest, testing::ValuesIn(RoundTripCases()), [](const auto& test) {
  std::string name(EncodingName(test.param.encoding));
  std::erase(name, '.');
  return name + "_" + std::to_string(test.param.geometry.width_px) + "x" +
         std::to_string(test.param.geometry.height_px);
});

std::vector<uint16_t> Evt3Words(absl::Span<const Event> events) {
  const std::vector<uint8_t> bytes = EncodeAll(Encoding::kEvt3, kVga, events);
  std::vector<uint16_t> words(bytes.size() / 2);
  std::memcpy(words.data(), bytes.data(), bytes.size());
  return words;
}

TEST(Evt3EncoderTest, VectorsWhenTheyAreShorter) {
  std::vector<Event> events;
  for (uint16_t x = 64; x < 68; ++x) events.push_back({4096, x, 9, 1});
  EXPECT_THAT(Evt3Words(events), ElementsAre(Evt3(8, 1), Evt3(6, 0), Evt3(0, 9), Evt3(2, 0x840), Evt3(2, 0x841),
                                             Evt3(2, 0x842), Evt3(2, 0x843)));
  for (uint16_t x = 95; x < 100; ++x) events.push_back({4096, x, 9, 1});
  // The second vector continues where the first one ends: it needs no base.
  EXPECT_THAT(Evt3Words(events), ElementsAre(Evt3(8, 1), Evt3(6, 0), Evt3(0, 9), Evt3(3, 0x840), Evt3(4, 0xf),
                                             Evt3(4, 0), Evt3(5, 0x80), Evt3(4, 0xf), Evt3(4, 0), Evt3(5, 0)));
}

TEST(Evt3EncoderTest, TimeHighEvery16us) {
  EXPECT_THAT(
      Evt3Words({{15, 1, 2, 0}, {16, 1, 2, 0}, {17, 1, 2, 0}, {4096, 1, 2, 0}}),
      ElementsAre(Evt3(8, 0), Evt3(6, 15), Evt3(0, 2), Evt3(2, 1), Evt3(8, 0), Evt3(6, 16), Evt3(0, 2), Evt3(2, 1),
                  Evt3(6, 17), Evt3(0, 2), Evt3(2, 1), Evt3(8, 1), Evt3(6, 0), Evt3(0, 2), Evt3(2, 1)));
}

TEST(Evt3EncoderTest, LongGapsStaySmall) {
  // A day is 5150 wraps.
  const std::vector<Event> events = {{0, 1, 2, 0}, {int64_t{86400} * 1000000, 1, 2, 0}};
  const std::vector<uint8_t> bytes = EncodeAll(Encoding::kEvt3, kVga, events);
  EXPECT_LT(bytes.size(), 50000);
  EXPECT_THAT(DecodeAll(Encoding::kEvt3, kVga, bytes).out.events, ::testing::ElementsAreArray(events));
}

class EncoderErrorTest : public testing::TestWithParam<Encoding> {};

TEST_P(EncoderErrorTest, NamesTheFirstWrongEventAndWritesNothing) {
  struct Case {
    std::vector<Event> events;
    std::string message;
  };
  const std::vector<Case> cases = {
      {{{-1, 0, 0, 0}}, "the time of event 0 is -1 us; it must not be negative"},
      {{{5, 639, 479, 1}, {5, 640, 0, 0}}, "event 1 at x 640, y 0 lies outside the sensor of 640x480 pixels"},
      {{{5, 0, 480, 0}}, "event 0 at x 0, y 480 lies outside"},
      {{{5, 0, 0, 2}}, "event 0 has polarity 2; it must be 0 or 1"},
      {{{5, 0, 0, 0}, {int64_t{1} << 50, 0, 0, 0}}, "the time of event 1 is 1125899906842624 us"},
      {{{int64_t{1} << 50, 0, 0, 0}}, "after the zero of the clock; at most"},
  };
  for (const Case& wrong : cases) {
    std::vector<uint8_t> bytes;
    const absl::Status status = MakeEventEncoder(GetParam(), kVga).value()->Encode(wrong.events, bytes);
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
    EXPECT_THAT(status.message(), HasSubstr(wrong.message));
    EXPECT_THAT(bytes, IsEmpty());
  }
}

TEST_P(EncoderErrorTest, TimesMustNotDecreaseAcrossCalls) {
  if (GetParam() == Encoding::kDat || GetParam() == Encoding::kFlat64) return;  // see FullAddressEncoderTest
  const auto encoder = MakeEventEncoder(GetParam(), kVga).value();
  std::vector<uint8_t> bytes;
  const Event event{1000, 0, 0, 0};
  ASSERT_TRUE(encoder->Encode({&event, 1}, bytes).ok());
  const std::vector<Event> step_back = {{1005, 0, 0, 0}, {1004, 0, 0, 0}};
  EXPECT_THAT(encoder->Encode(step_back, bytes).message(), HasSubstr("the time of event 1 is 1004 us after 1005 us"));
  EXPECT_THAT(encoder->EncodeTime(999, bytes).message(), HasSubstr("the time is 999 us after 1000 us"));
  ASSERT_TRUE(encoder->EncodeTime(2000, bytes).ok());
  const size_t size = bytes.size();
  EXPECT_THAT(encoder->Encode({&event, 1}, bytes).message(), HasSubstr("is 1000 us after 2000 us"));
  EXPECT_EQ(bytes.size(), size);
}

INSTANTIATE_TEST_SUITE_P(Encodings, EncoderErrorTest,
                         testing::Values(Encoding::kEvt3, Encoding::kEvt21, Encoding::kEvt2, Encoding::kDat,
                                         Encoding::kFlat64));

class TriggerEncoderTest : public testing::TestWithParam<Encoding> {};

TEST_P(TriggerEncoderTest, TriggersAmongEventsKeepTheirTimesAndOrder) {
  const auto encoder = MakeEventEncoder(GetParam(), kVga).value();
  std::vector<uint8_t> bytes;
  const std::vector<Event> events = {{20'000'005, 1, 2, 1}, {20'000'005, 3, 2, 1}, {20'005'000, 1, 2, 0}};
  const std::vector<Trigger> triggers = {
      {20'000'001, 0, 1}, {20'000'005, 15, 0}, {20'004'100, 3, 1}, {500'000'000, 0, 0}};
  ASSERT_TRUE(encoder->EncodeTrigger(triggers[0], bytes).ok());
  ASSERT_TRUE(encoder->Encode(absl::MakeConstSpan(events).first(2), bytes).ok());
  ASSERT_TRUE(encoder->EncodeTrigger(triggers[1], bytes).ok());
  ASSERT_TRUE(encoder->EncodeTrigger(triggers[2], bytes).ok());
  ASSERT_TRUE(encoder->Encode(absl::MakeConstSpan(events).last(1), bytes).ok());
  ASSERT_TRUE(encoder->EncodeTrigger(triggers[3], bytes).ok());
  const Decoded decoded = DecodeAll(GetParam(), kVga, bytes);
  EXPECT_THAT(decoded.out.events, ::testing::ElementsAreArray(events));
  EXPECT_THAT(decoded.out.triggers, ::testing::ElementsAreArray(triggers));
  EXPECT_EQ(decoded.counts.invalid_words(), 0);
}

TEST_P(TriggerEncoderTest, ErrorsWriteNothing) {
  const auto encoder = MakeEventEncoder(GetParam(), kVga).value();
  std::vector<uint8_t> bytes;
  EXPECT_THAT(encoder->EncodeTrigger({5, 0, 2}, bytes).message(), HasSubstr("polarity 2 does not fit"));
  EXPECT_THAT(encoder->EncodeTrigger({-1, 0, 0}, bytes).message(), HasSubstr("must not be negative"));
  EXPECT_THAT(encoder->EncodeTrigger({int64_t{1} << 50, 0, 0}, bytes).message(), HasSubstr("can be encoded"));
  EXPECT_THAT(bytes, IsEmpty());
}

INSTANTIATE_TEST_SUITE_P(Encodings, TriggerEncoderTest,
                         testing::Values(Encoding::kEvt3, Encoding::kEvt21, Encoding::kEvt2, Encoding::kFlat64));

TEST(EncoderTest, InputsAndEncodingsWithoutTriggersAreErrors) {
  std::vector<uint8_t> bytes;
  EXPECT_THAT(MakeEventEncoder(Encoding::kEvt3, kVga).value()->EncodeTrigger({5, 16, 0}, bytes).message(),
              HasSubstr("a trigger of input 16 and polarity 0 does not fit the encoding, which has 16 inputs"));
  EXPECT_EQ(MakeEventEncoder(Encoding::kDat, kVga).value()->EncodeTrigger({5, 0, 0}, bytes).code(),
            absl::StatusCode::kUnimplemented);
  EXPECT_THAT(bytes, IsEmpty());
}

class FullAddressEncoderTest : public testing::TestWithParam<Encoding> {};

TEST_P(FullAddressEncoderTest, TimesMayStepBack) {
  const auto encoder = MakeEventEncoder(GetParam(), kVga).value();
  std::vector<uint8_t> bytes;
  const std::vector<Event> events = {{5000, 1, 2, 1}, {4000, 3, 4, 0}, {4000000000, 5, 6, 1}, {3999999999, 7, 8, 0}};
  ASSERT_TRUE(encoder->Encode(absl::MakeConstSpan(events).first(2), bytes).ok());
  const Event middle{2000000000, 9, 9, 1};
  ASSERT_TRUE(encoder->Encode({&middle, 1}, bytes).ok());
  ASSERT_TRUE(encoder->Encode(absl::MakeConstSpan(events).last(2), bytes).ok());
  const Decoded decoded = DecodeAll(GetParam(), kVga, bytes);
  EXPECT_THAT(decoded.out.events, ::testing::ElementsAre(events[0], events[1], middle, events[2], events[3]));
  EXPECT_EQ(decoded.counts.time_backsteps, 2);
}

TEST_P(FullAddressEncoderTest, GapsBeyondHalfTheClockAreErrors) {
  const auto encoder = MakeEventEncoder(GetParam(), kVga).value();
  std::vector<uint8_t> bytes;
  Event event{(int64_t{1} << 32) - 1, 0, 0, 0};
  ASSERT_TRUE(encoder->Encode({&event, 1}, bytes).ok());
  // There are no time words, so that EncodeTime() does not shorten the gap.
  ASSERT_TRUE(encoder->EncodeTime(event.t_us + 2000000000, bytes).ok());
  event.t_us += 2200000000;
  EXPECT_THAT(encoder->Encode({&event, 1}, bytes).message(), HasSubstr("at most 2147483647 us can be encoded"));
}

INSTANTIATE_TEST_SUITE_P(Encodings, FullAddressEncoderTest, testing::Values(Encoding::kDat, Encoding::kFlat64));

TEST(EncoderTest, GeometriesAreChecked) {
  EXPECT_EQ(MakeEventEncoder(Encoding::kEvt3, {4096, 720}).status().code(), absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace evpose

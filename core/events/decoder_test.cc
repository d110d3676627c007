// SPDX-License-Identifier: Apache-2.0
#include "core/events/decoder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <utility>

#include "core/events/events_testing.h"
#include "core/events/time_scanner.h"

namespace evpose {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using testing::SizeIs;

Decoded DecodeEvt3(const std::vector<uint16_t>& words) { return DecodeAll(Encoding::kEvt3, kVga, BytesOf(words)); }
Decoded DecodeEvt2(const std::vector<uint32_t>& words) { return DecodeAll(Encoding::kEvt2, kVga, BytesOf(words)); }
Decoded DecodeEvt21(const std::vector<uint64_t>& words) { return DecodeAll(Encoding::kEvt21, kVga, BytesOf(words)); }

uint64_t Evt21(uint32_t upper, uint32_t mask = 0) { return static_cast<uint64_t>(upper) << 32 | mask; }

TEST(DecoderTest, NamesAndSizes) {
  EXPECT_EQ(EncodingName(Encoding::kEvt21), "EVT2.1");
  EXPECT_EQ(WordBytes(Encoding::kEvt3), 2);
  EXPECT_EQ(WordBytes(Encoding::kEvt2), 4);
  EXPECT_EQ(WordBytes(Encoding::kFlat64), 8);
}

TEST(DecoderTest, RefusesGeometriesThatCannotBeAddressed) {
  for (const SensorGeometry geometry : {SensorGeometry{0, 480}, {640, -1}, {2049, 480}, {640, 2049}}) {
    const auto decoder = MakeEventDecoder(Encoding::kEvt3, geometry);
    EXPECT_EQ(decoder.status().code(), absl::StatusCode::kInvalidArgument);
    EXPECT_THAT(decoder.status().message(), testing::HasSubstr("EVT3 addresses 1x1 to 2048x2048"));
  }
  EXPECT_TRUE(MakeEventDecoder(Encoding::kDat, {16384, 16384}).ok());
  EXPECT_FALSE(MakeEventDecoder(Encoding::kFlat64, {16385, 1}).ok());
}

TEST(Evt3DecoderTest, RowsColumnsTimesAndTriggers) {
  const Decoded decoded = DecodeEvt3({Evt3(8, 10), Evt3(6, 100), Evt3(0, 7), Evt3(2, 0x800 | 5), Evt3(2, 6),
                                      Evt3(6, 101), Evt3(0, 8), Evt3(2, 9), Evt3(0xa, 0x601), Evt3(0xa, 0x600)});
  EXPECT_THAT(decoded.out.events, ElementsAre(Event{41060, 5, 7, 1}, Event{41060, 6, 7, 0}, Event{41061, 9, 8, 0}));
  EXPECT_THAT(decoded.out.triggers, ElementsAre(Trigger{41061, 6, 1}, Trigger{41061, 6, 0}));
  EXPECT_EQ(decoded.counts, (DecodeCounts{.cd_events = 3, .triggers = 2}));
}

TEST(Evt3DecoderTest, LegalWordsThatHoldNoEventsAreNotUnknown) {
  const Decoded decoded = DecodeEvt3({Evt3(8, 1), Evt3(0, 1), Evt3(0xe, 0x19), Evt3(0xf, 2), Evt3(0xf, 3), Evt3(7, 4),
                                      Evt3(2, 5), Evt3(0xe, 0x19), Evt3(0xf, 2), Evt3(0xf, 3), Evt3(8, 2), Evt3(2, 6)});
  // OTHERS does not take the following word: the second TIME_HIGH counts.
  EXPECT_THAT(decoded.out.events, ElementsAre(Event{4096, 5, 1, 0}, Event{8192, 6, 1, 0}));
  EXPECT_EQ(decoded.counts, (DecodeCounts{.cd_events = 2}));
}

TEST(Evt3DecoderTest, PaddingIsCountedApartFromUnknownWords) {
  const Decoded decoded = DecodeEvt3(
      {Evt3(9, 0x999), Evt3(8, 0), Evt3(6, 1), Evt3(0, 2), Evt3(9, 0x999), Evt3(2, 3), Evt3(9, 0x998), Evt3(9, 0x999)});
  EXPECT_EQ(decoded.counts, (DecodeCounts{.cd_events = 1, .unknown_words = 1, .padding_words = 3}));
}

TEST(Evt3DecoderTest, ReservedWordsAreCountedAndSkipped) {
  const Decoded decoded =
      DecodeEvt3({Evt3(8, 1), Evt3(0, 1), Evt3(9, 1), Evt3(0xb, 1), Evt3(0xc, 1), Evt3(0xd, 1), Evt3(2, 5)});
  EXPECT_THAT(decoded.out.events, SizeIs(1));
  EXPECT_EQ(decoded.counts.unknown_words, 4);
}

TEST(Evt3DecoderTest, ReservedRowHidesAddressesUntilTheNextRow) {
  const Decoded decoded = DecodeEvt3({Evt3(8, 1), Evt3(0, 1), Evt3(3, 0), Evt3(1, 9), Evt3(2, 5), Evt3(4, 0xfff),
                                      Evt3(4, 0), Evt3(5, 0), Evt3(0, 2), Evt3(2, 6)});
  EXPECT_THAT(decoded.out.events, ElementsAre(Event{4096, 6, 2, 0}));
  EXPECT_EQ(decoded.counts, (DecodeCounts{.cd_events = 1, .dropped_outside_sensor = 13, .unknown_words = 1}));
}

TEST(Evt3DecoderTest, NothingBeforeTimeAndRow) {
  const Decoded decoded = DecodeEvt3({Evt3(0, 7), Evt3(2, 1), Evt3(4, 0x00f), Evt3(4, 1), Evt3(5, 3), Evt3(0xa, 1),
                                      Evt3(6, 9), Evt3(0xd, 0), Evt3(8, 1), Evt3(2, 2), Evt3(0, 7), Evt3(2, 3)});
  EXPECT_THAT(decoded.out.events, ElementsAre(Event{4096, 3, 7, 0}));
  EXPECT_THAT(decoded.out.triggers, IsEmpty());
  // 1 + 4 + 1 + 2 events and a trigger before the time, one event before the row.
  EXPECT_EQ(decoded.counts, (DecodeCounts{.cd_events = 1, .dropped_before_time = 10, .unknown_words = 1}));
}

TEST(Evt3DecoderTest, VectorTriples) {
  const Decoded decoded = DecodeEvt3({Evt3(8, 0), Evt3(0, 7), Evt3(3, 0x800 | 64), Evt3(4, 1), Evt3(4, 2),
                                      Evt3(5, 0x80), Evt3(4, 1), Evt3(4, 0), Evt3(5, 0)});
  EXPECT_THAT(decoded.out.events,
              ElementsAre(Event{0, 64, 7, 1}, Event{0, 64 + 13, 7, 1}, Event{0, 64 + 31, 7, 1}, Event{0, 96, 7, 1}));
  EXPECT_EQ(decoded.counts, (DecodeCounts{.cd_events = 4}));
}

TEST(Evt3DecoderTest, BrokenVectorsAreCounted) {
  // The vectors have no base, no beginning, or no end.
  EXPECT_EQ(DecodeEvt3({Evt3(8, 0), Evt3(0, 7), Evt3(4, 1), Evt3(4, 1), Evt3(5, 1)}).counts,
            (DecodeCounts{.broken_vectors = 1}));
  EXPECT_EQ(DecodeEvt3({Evt3(8, 0), Evt3(0, 7), Evt3(3, 0), Evt3(5, 1)}).counts, (DecodeCounts{.broken_vectors = 1}));
  EXPECT_EQ(DecodeEvt3({Evt3(8, 0), Evt3(0, 7), Evt3(3, 0), Evt3(4, 1), Evt3(2, 1), Evt3(6, 1)}).counts,
            (DecodeCounts{.cd_events = 3, .broken_vectors = 1}));
}

TEST(Evt3DecoderTest, UnfinishedTripleIsPending) {
  const Decoded decoded = DecodeEvt3({Evt3(8, 0), Evt3(0, 7), Evt3(3, 0), Evt3(4, 1), Evt3(4, 1)});
  EXPECT_THAT(decoded.out.events, IsEmpty());
  EXPECT_EQ(decoded.pending_bytes, 4);
}

TEST(Evt3DecoderTest, OutsideTheSensorIsDroppedAndCounted) {
  const std::vector<uint8_t> bytes =
      BytesOf<uint16_t>({Evt3(8, 0), Evt3(0, 7), Evt3(2, 639), Evt3(2, 640), Evt3(3, 620), Evt3(4, 3), Evt3(4, 1),
                         Evt3(5, 1), Evt3(0, 480), Evt3(2, 1), Evt3(2, 2)});
  const Decoded dropped = DecodeAll(Encoding::kEvt3, kVga, bytes);
  EXPECT_THAT(dropped.out.events, ElementsAre(Event{0, 639, 7, 0}));
  EXPECT_EQ(dropped.counts, (DecodeCounts{.cd_events = 1, .dropped_outside_sensor = 7}));
  const Decoded kept = DecodeInPieces(Encoding::kEvt3, kVga, OutsideSensor::kKeep, bytes, {});
  EXPECT_THAT(kept.out.events, ElementsAre(Event{0, 639, 7, 0}, Event{0, 640, 7, 0}));
  EXPECT_EQ(kept.counts, (DecodeCounts{.cd_events = 2, .dropped_outside_sensor = 6, .kept_outside_sensor = 1}));
}

TEST(Evt3DecoderTest, SmallStepsBackAreNotWraps) {
  const Decoded decoded = DecodeEvt3({Evt3(8, 10), Evt3(0, 7), Evt3(6, 500), Evt3(2, 0), Evt3(6, 100), Evt3(2, 1),
                                      Evt3(8, 9), Evt3(2, 2), Evt3(8, 10), Evt3(2, 3)});
  EXPECT_THAT(decoded.out.events,
              ElementsAre(Event{41460, 0, 7, 0}, Event{41060, 1, 7, 0}, Event{36864, 2, 7, 0}, Event{40960, 3, 7, 0}));
  EXPECT_EQ(decoded.counts.time_backsteps, 2);
  EXPECT_EQ(decoded.counts.clock_wraps, 0);
}

TEST(Evt3DecoderTest, ClockUnwrapsForHours) {
  std::vector<uint16_t> words = {Evt3(8, 0), Evt3(0, 7)};
  // Six hours in steps of a quarter of the clock's range.
  const int num_quarters = 6 * 3600 * 1000 / 4194;
  for (int i = 1; i <= num_quarters; ++i) {
    words.push_back(Evt3(8, static_cast<uint32_t>(i) * 1024 % 4096));
    words.push_back(Evt3(6, static_cast<uint32_t>(i) % 4096));
    words.push_back(Evt3(2, 1));
  }
  const Decoded decoded = DecodeEvt3(words);
  ASSERT_THAT(decoded.out.events, SizeIs(num_quarters));
  for (int i = 1; i <= num_quarters; ++i) {
    ASSERT_EQ(decoded.out.events[static_cast<size_t>(i - 1)].t_us, int64_t{i} * (1 << 22) + i % 4096);
  }
  EXPECT_EQ(decoded.counts.clock_wraps, static_cast<uint64_t>(num_quarters / 4));
  EXPECT_EQ(decoded.counts.time_backsteps, 0);
}

TEST(Evt3DecoderTest, AfterALossItWaitsForTheWholeTimeAndTheRow) {
  const auto decoder = MakeEventDecoder(Encoding::kEvt3, kVga).value();
  DecodedEvents out;
  decoder->Decode(BytesOf<uint16_t>({Evt3(8, 4095), Evt3(6, 5), Evt3(0, 7), Evt3(2, 1), Evt3(3, 0), Evt3(4, 1)}), out);
  EXPECT_EQ(decoder->pending_bytes(), 2);
  decoder->ResetAfterLoss();
  EXPECT_EQ(decoder->pending_bytes(), 0);
  decoder->Decode(BytesOf<uint16_t>({Evt3(2, 2), Evt3(8, 0), Evt3(2, 3), Evt3(6, 9), Evt3(2, 4), Evt3(0, 8), Evt3(2, 5),
                                     Evt3(4, 1), Evt3(4, 1), Evt3(5, 1)}),
                  out);
  EXPECT_THAT(out.events, ElementsAre(Event{4095 * 4096 + 5, 1, 7, 0}, Event{(1 << 24) + 9, 5, 8, 0}));
  EXPECT_EQ(decoder->counts(),
            (DecodeCounts{.cd_events = 2, .dropped_before_time = 3, .broken_vectors = 1, .clock_wraps = 1}));
}

TEST(Evt2DecoderTest, EventsTimesAndTriggers) {
  const Decoded decoded =
      DecodeEvt2({Evt2Cd(1, 3, 1, 2), Evt2(8, 10), Evt2Cd(1, 3, 639, 479), Evt2Cd(0, 3, 5, 6),
                  Evt2(0xa, 4u << 22 | 9 << 8 | 1), Evt2(0xe, 0), Evt2(0xf, 0), Evt2(5, 0), Evt2Cd(0, 1, 640, 1)});
  EXPECT_THAT(decoded.out.events, ElementsAre(Event{643, 639, 479, 1}, Event{643, 5, 6, 0}));
  EXPECT_THAT(decoded.out.triggers, ElementsAre(Trigger{644, 9, 1}));
  EXPECT_EQ(decoded.counts, (DecodeCounts{.cd_events = 2,
                                          .triggers = 1,
                                          .dropped_before_time = 1,
                                          .dropped_outside_sensor = 1,
                                          .unknown_words = 1,
                                          .time_backsteps = 1}));
}

TEST(Evt2DecoderTest, ClockUnwrapsForDays) {
  std::vector<uint32_t> words;
  for (int i = 0; i < 10; ++i) {
    words.insert(words.end(),
                 {Evt2(8, 0), Evt2Cd(1, 1, 0, 0), Evt2(8, 0x8000000), Evt2(8, 0xfffffff), Evt2Cd(1, 63, 0, 0)});
  }
  const Decoded decoded = DecodeEvt2(words);
  ASSERT_THAT(decoded.out.events, SizeIs(20));
  for (int i = 0; i < 10; ++i) {
    EXPECT_EQ(decoded.out.events[static_cast<size_t>(2 * i)].t_us, (int64_t{i} << 34) + 1);
    EXPECT_EQ(decoded.out.events[static_cast<size_t>(2 * i + 1)].t_us, (int64_t{i + 1} << 34) - 1);
  }
  EXPECT_EQ(decoded.counts.clock_wraps, 9);
  EXPECT_EQ(decoded.counts.time_backsteps, 0);
}

TEST(Evt2DecoderTest, AfterALossItWaitsForTheTime) {
  const auto decoder = MakeEventDecoder(Encoding::kEvt2, kVga).value();
  DecodedEvents out;
  decoder->Decode(BytesOf<uint32_t>({Evt2(8, 10), Evt2Cd(1, 3, 1, 2)}), out);
  decoder->ResetAfterLoss();
  decoder->Decode(BytesOf<uint32_t>({Evt2Cd(1, 4, 1, 2), Evt2(0xa, 0), Evt2(8, 11), Evt2Cd(1, 5, 1, 2)}), out);
  EXPECT_THAT(out.events, ElementsAre(Event{643, 1, 2, 1}, Event{709, 1, 2, 1}));
  EXPECT_EQ(decoder->counts(), (DecodeCounts{.cd_events = 2, .dropped_before_time = 2}));
}

TEST(Evt21DecoderTest, MasksTimesAndTriggers) {
  const Decoded decoded = DecodeEvt21({Evt21(Evt2Cd(1, 0, 0, 0), 0xff), Evt21(Evt2(8, 10)),
                                       Evt21(Evt2Cd(1, 3, 32, 7), 0x80000001), Evt21(Evt2Cd(0, 4, 5, 6), 0),
                                       Evt21(Evt2(0xa, 5u << 22 | 1 << 8)), Evt21(Evt2(0xe, 0)), Evt21(Evt2(2, 0))});
  EXPECT_THAT(decoded.out.events, ElementsAre(Event{643, 32, 7, 1}, Event{643, 63, 7, 1}));
  EXPECT_THAT(decoded.out.triggers, ElementsAre(Trigger{645, 1, 0}));
  EXPECT_EQ(decoded.counts,
            (DecodeCounts{.cd_events = 2, .triggers = 1, .dropped_before_time = 8, .unknown_words = 1}));
}

TEST(Evt21DecoderTest, PixelsBeyondTheEdgesAreDropped) {
  const std::vector<uint8_t> bytes =
      BytesOf<uint64_t>({Evt21(Evt2(8, 0)), Evt21(Evt2Cd(1, 0, 630, 0), 0xffffffff), Evt21(Evt2Cd(1, 0, 640, 0), 1),
                         Evt21(Evt2Cd(1, 0, 0, 480), 3)});
  EXPECT_EQ(DecodeAll(Encoding::kEvt21, kVga, bytes).counts,
            (DecodeCounts{.cd_events = 10, .dropped_outside_sensor = 25}));
  EXPECT_EQ(DecodeInPieces(Encoding::kEvt21, kVga, OutsideSensor::kKeep, bytes, {}).counts,
            (DecodeCounts{.cd_events = 35, .kept_outside_sensor = 25}));
}

TEST(Evt21DecoderTest, ClockUnwraps) {
  const Decoded decoded = DecodeEvt21(
      {Evt21(Evt2(8, 0xfffffff)), Evt21(Evt2Cd(1, 63, 0, 0), 1), Evt21(Evt2(8, 2)), Evt21(Evt2Cd(1, 0, 0, 0), 1)});
  EXPECT_THAT(decoded.out.events,
              ElementsAre(Event{(int64_t{1} << 34) - 1, 0, 0, 1}, Event{(int64_t{1} << 34) + 128, 0, 0, 1}));
}

uint64_t Flat64(uint32_t t, uint32_t x, uint32_t y, uint32_t low) {
  return static_cast<uint64_t>(t) << 32 | static_cast<uint64_t>(x) << 18 | y << 4 | low;
}

TEST(Flat64DecoderTest, EventsReservedBitsAndEdges) {
  const Decoded decoded = DecodeAll(Encoding::kFlat64, {10000, 9000},
                                    BytesOf<uint64_t>({Flat64(7, 9999, 8999, 1), Flat64(8, 0, 0, 0), Flat64(9, 0, 0, 4),
                                                       Flat64(10, 10000, 0, 0), Flat64(11, 0, 9000, 0)}));
  EXPECT_THAT(decoded.out.events, ElementsAre(Event{7, 9999, 8999, 1}, Event{8, 0, 0, 0}));
  EXPECT_EQ(decoded.counts, (DecodeCounts{.cd_events = 2, .dropped_outside_sensor = 2, .unknown_words = 1}));
}

TEST(Flat64DecoderTest, Triggers) {
  const Decoded decoded =
      DecodeAll(Encoding::kFlat64, kVga,
                BytesOf<uint64_t>({Flat64(7, 3, 0, 3), Flat64(8, 1, 2, 1), Flat64(9, 255, 0, 2), Flat64(10, 256, 0, 2),
                                   Flat64(11, 0, 1, 2), Flat64(12, 0, 0, 6)}));
  EXPECT_THAT(decoded.out.triggers, ElementsAre(Trigger{7, 3, 1}, Trigger{9, 255, 0}));
  EXPECT_EQ(decoded.counts, (DecodeCounts{.cd_events = 1, .triggers = 2, .unknown_words = 3}));
}

TEST(Flat64DecoderTest, ClockUnwrapsAndLateWordsStayLate) {
  const Decoded decoded =
      DecodeAll(Encoding::kFlat64, kVga,
                BytesOf<uint64_t>({Flat64(0xfffffff0, 0, 0, 0), Flat64(5, 0, 0, 0), Flat64(0xfffffff1, 0, 0, 0),
                                   Flat64(6, 0, 0, 0), Flat64(0x7fffffff, 0, 0, 0), Flat64(0xfffffff0, 0, 0, 0),
                                   Flat64(1, 0, 0, 0)}));
  const int64_t wrap = int64_t{1} << 32;
  std::vector<int64_t> times;
  for (const Event& event : decoded.out.events) times.push_back(event.t_us);
  EXPECT_THAT(times,
              ElementsAre(wrap - 16, wrap + 5, wrap - 15, wrap + 6, wrap + 0x7fffffff, 2 * wrap - 16, 2 * wrap + 1));
  EXPECT_EQ(decoded.counts.clock_wraps, 2);
  EXPECT_EQ(decoded.counts.time_backsteps, 1);
}

TEST(DatDecoderTest, EventsAndEdges) {
  const auto dat = [](uint32_t t, uint32_t x, uint32_t y, uint32_t p) {
    return static_cast<uint64_t>(p << 28 | y << 14 | x) << 32 | t;
  };
  const std::vector<uint8_t> bytes =
      BytesOf<uint64_t>({dat(3, 639, 479, 1), dat(4, 640, 0, 0), dat(0xffffffff, 1, 2, 0), dat(2, 3, 4, 0)});
  const Decoded decoded = DecodeAll(Encoding::kDat, kVga, bytes);
  EXPECT_THAT(decoded.out.events,
              ElementsAre(Event{3, 639, 479, 1}, Event{0xffffffff, 1, 2, 0}, Event{(int64_t{1} << 32) + 2, 3, 4, 0}));
  EXPECT_EQ(decoded.counts, (DecodeCounts{.cd_events = 3, .dropped_outside_sensor = 1, .clock_wraps = 1}));
}

// The time after these words, and after further ones that follow a loss.
template <typename Word>
std::vector<int64_t> ScannedTimes(Encoding encoding, const std::vector<Word>& before, const std::vector<Word>& after) {
  constexpr int64_t kUnlimitedUs = int64_t{1} << 50;
  TimeScanner scanner(encoding);
  std::vector<int64_t> times;
  for (const std::vector<Word>& words : {before, after}) {
    if (&words != &before) scanner.ResetAfterLoss();
    const std::vector<uint8_t> bytes = BytesOf(words);
    for (size_t i = 0; i < words.size(); ++i) scanner.Scan(bytes.data() + i * sizeof(Word), 1, kUnlimitedUs);
    times.push_back(scanner.now_us());
  }
  return times;
}

TEST(TimeScannerTest, WaitsAfterALossLikeTheDecoders) {
  const std::vector<uint16_t> start = {Evt3(8, 1), Evt3(6, 5)};
  const std::vector<std::pair<std::vector<uint16_t>, int64_t>> continuations = {
      {{Evt3(6, 0x900)}, 4101},                                              // TIME_LOW without TIME_HIGH
      {{Evt3(4, 1), Evt3(8, 2), Evt3(6, 7)}, 8199},                          // VECT_12 hides no time
      {{Evt3(8, 2), Evt3(4, 1), Evt3(6, 7)}, 8199},                          // nor before TIME_LOW
      {{Evt3(8, 2), Evt3(6, 7), Evt3(4, 1), Evt3(6, 8), Evt3(6, 9)}, 8199},  // then it does
  };
  for (const auto& [after, expected_us] : continuations) {
    EXPECT_EQ(ScannedTimes<uint16_t>(Encoding::kEvt3, start, after).at(1), expected_us);
  }
  EXPECT_EQ(ScannedTimes<uint32_t>(Encoding::kEvt2, {Evt2(8, 2), Evt2Cd(1, 3, 0, 0)}, {Evt2Cd(1, 60, 0, 0)}),
            (std::vector<int64_t>{131, 131}));
  EXPECT_EQ(ScannedTimes<uint32_t>(Encoding::kEvt2, {Evt2(8, 2)}, {Evt2(8, 3), Evt2Cd(1, 60, 0, 0)}),
            (std::vector<int64_t>{128, 252}));
}

TEST(TimeScannerTest, UnknownWordsOfFlat64HaveNoTime) {
  const uint64_t event = uint64_t{1000} << 32, unknown = uint64_t{5'000'000} << 32 | 4;
  EXPECT_EQ(DecodeAll(Encoding::kFlat64, kVga, BytesOf<uint64_t>({unknown})).counts.unknown_words, 1u);
  EXPECT_EQ(ScannedTimes<uint64_t>(Encoding::kFlat64, {event, unknown}, {}).at(1), 1000);
}

TEST(TimeMarksTest, Evt3MarksAPassedMillisecond) {
  const Decoded decoded = DecodeEvt3({Evt3(8, 1), Evt3(0, 7), Evt3(6, 10), Evt3(2, 1),  //
                                      Evt3(6, 1009),                                    // 999 us after the event
                                      Evt3(6, 1010),                                    // 1000: a mark
                                      Evt3(6, 2009), Evt3(8, 2),                        // a mark at 8192
                                      Evt3(6, 900), Evt3(2, 2), Evt3(6, 1800),          // 900 us after the event
                                      Evt3(6, 1900)});                                  // 1000: a mark
  EXPECT_THAT(decoded.out.time_marks,
              ElementsAre(TimeMark{1, 4096 + 1010}, TimeMark{1, 8192}, TimeMark{2, 8192 + 1900}));
}

TEST(TimeMarksTest, AStepBackBeginsAgain) {
  const Decoded decoded = DecodeEvt3({Evt3(8, 100), Evt3(0, 7), Evt3(2, 1), Evt3(8, 50), Evt3(6, 999), Evt3(6, 1000)});
  EXPECT_THAT(decoded.out.time_marks, ElementsAre(TimeMark{1, 50 * 4096 + 1000}));
}

TEST(TimeMarksTest, Evt2AndEvt21MarkAPassedMillisecond) {
  const std::vector<uint32_t> words = {Evt2(8, 0),  Evt2Cd(0, 1, 0, 0), Evt2(8, 15),
                                       Evt2(8, 16), Evt2(8, 31),        Evt2(8, 32)};
  std::vector<uint64_t> wide;
  for (const uint32_t word : words) wide.push_back(Evt21(word, 1));
  const auto expected = ElementsAre(TimeMark{1, 1024}, TimeMark{1, 2048});
  EXPECT_THAT(DecodeEvt2(words).out.time_marks, expected);
  EXPECT_THAT(DecodeEvt21(wide).out.time_marks, expected);
}

// A random EVT3 word of a sensor of 640x480, mostly a plain one: sometimes the time steps back, a row or column lies
// outside, or the word has another type.
uint16_t MostlyPlainEvt3(Random& random, uint32_t& low) {
  const auto any = static_cast<uint32_t>(random.NextU64());
  const uint64_t kind = random.UniformInt(100);
  if (kind < 45) return Evt3(0x0, any % (kind == 0 ? 0x1000 : 480));
  if (kind < 90) return Evt3(0x2, (any & 0x800) | (any & 0x7ff) % (kind == 45 ? 0x800 : 640));
  if (kind < 98) {
    low = kind == 90 ? any % 0x1000 : std::min(low + any % 4, 0xfffu);
    return Evt3(0x6, low);
  }
  return kind == 98 ? Evt3(0x8, (any % 16) / 15) : static_cast<uint16_t>(any);
}

// A random EVT2 word, or the upper half of an EVT2.1 word; a TIME_HIGH is mostly the current one or one of the next.
uint32_t MostlyPlainEvt2(Random& random, uint32_t& high, uint32_t& low) {
  const auto any = static_cast<uint32_t>(random.NextU64());
  const uint64_t kind = random.UniformInt(100);
  if (kind == 0) return any;
  if (kind < 5) {
    if (kind < 3) high = kind == 1 ? any % 1000 : high + any % 20;
    return Evt2(0x8, high);
  }
  low = kind == 5 ? any % 64 : std::min(low + any % 2, 63u);
  if (kind == 6) return Evt2(0xa, low << 22 | (any & 0x1f01));
  return Evt2Cd(any & 1, low, (any >> 1 & 0x7ff) % (kind == 7 ? 0x800 : 640),
                (any >> 12 & 0x7ff) % (kind == 8 ? 0x800 : 480));
}

uint64_t MostlyPlainEvt21(Random& random, uint32_t& high, uint32_t& low) {
  const auto any = static_cast<uint32_t>(random.NextU64());
  const uint64_t kind = random.UniformInt(50);
  const uint32_t mask = kind == 0 ? any : kind == 1 ? 3u << any % 32 : 1u << any % 32;
  return Evt21(MostlyPlainEvt2(random, high, low), mask);
}

// In one piece the words are decoded in runs, in pieces of a word one by one.
TEST(DecoderTest, RunsHaveTheEventsOfSingleWords) {
  Random random(11);
  for (int round = 0; round < 100; ++round) {
    std::vector<uint16_t> evt3 = {Evt3(0x8, 0), Evt3(0x0, 1)};
    std::vector<uint32_t> evt2 = {Evt2(0x8, 0)};
    std::vector<uint64_t> evt21 = {Evt21(Evt2(0x8, 0))};
    uint32_t low3 = 0, low2 = 0, low21 = 0, high2 = 0, high21 = 0;
    for (int i = 0; i < 1000; ++i) {
      evt3.push_back(MostlyPlainEvt3(random, low3));
      evt2.push_back(MostlyPlainEvt2(random, high2, low2));
      evt21.push_back(MostlyPlainEvt21(random, high21, low21));
    }
    const OutsideSensor outside = round % 2 == 0 ? OutsideSensor::kDrop : OutsideSensor::kKeep;
    const auto check = [&](Encoding encoding, const std::vector<uint8_t>& bytes) {
      const Decoded whole = DecodeInPieces(encoding, kVga, outside, bytes, {});
      std::vector<size_t> every_byte(bytes.size());
      std::iota(every_byte.begin(), every_byte.end(), size_t{0});
      ASSERT_TRUE(SameDecoded(DecodeInPieces(encoding, kVga, outside, bytes, every_byte), whole));
      ASSERT_GT(whole.out.events.size(), 300u);
    };
    check(Encoding::kEvt3, BytesOf(evt3));
    check(Encoding::kEvt2, BytesOf(evt2));
    check(Encoding::kEvt21, BytesOf(evt21));
  }
}

// Any bytes decode without a crash, and to the same events for all cuts.
class AnyBytesTest : public testing::TestWithParam<Encoding> {};

TEST_P(AnyBytesTest, DecodeTheSameHoweverTheyAreCut) {
  Random random(7);
  for (int round = 0; round < 200; ++round) {
    std::vector<uint8_t> bytes(random.UniformInt(3000));
    for (uint8_t& byte : bytes) byte = static_cast<uint8_t>(random.NextU64());
    // Half of the rounds begin with a time, so that they test more than the wait for it.
    if (round % 2 == 0 && bytes.size() > 8) std::fill_n(bytes.begin(), 8, 0x80);
    const SensorGeometry geometry = {1 + static_cast<int>(random.UniformInt(2048)),
                                     1 + static_cast<int>(random.UniformInt(2048))};
    const auto outside = round % 3 == 0 ? OutsideSensor::kKeep : OutsideSensor::kDrop;
    const Decoded whole = DecodeInPieces(GetParam(), geometry, outside, bytes, {});
    if (outside == OutsideSensor::kDrop) {
      for (const Event& event : whole.out.events) {
        ASSERT_LT(event.x, geometry.width_px);
        ASSERT_LT(event.y, geometry.height_px);
      }
    }
    EXPECT_EQ(whole.counts.cd_events, whole.out.events.size());
    std::vector<size_t> every_byte(bytes.size());
    std::iota(every_byte.begin(), every_byte.end(), size_t{0});
    ASSERT_TRUE(SameDecoded(DecodeInPieces(GetParam(), geometry, outside, bytes, every_byte), whole));
    for (const size_t max_piece : {3u, 40u, 700u}) {
      const std::vector<size_t> cuts = RandomCuts(bytes.size(), max_piece, random.NextU64());
      ASSERT_TRUE(SameDecoded(DecodeInPieces(GetParam(), geometry, outside, bytes, cuts), whole));
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Encodings, AnyBytesTest,
                         testing::Values(Encoding::kEvt3, Encoding::kEvt21, Encoding::kEvt2, Encoding::kDat,
                                         Encoding::kFlat64),
                         [](const auto& test) {
                           std::string name(EncodingName(test.param));
                           std::erase(name, '.');
                           return name;
                         });

}  // namespace
}  // namespace evpose

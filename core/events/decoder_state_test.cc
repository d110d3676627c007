// SPDX-License-Identifier: Apache-2.0

// A decoder that loads a saved state continues with the same output.
#include <gtest/gtest.h>

#include <algorithm>

#include "core/base/state_io.h"
#include "core/events/events_testing.h"
#include "core/events/sensor_clock.h"

namespace evpose {
namespace {

constexpr SensorGeometry kSensor = {640, 480};
constexpr Encoding kEncodings[] = {Encoding::kEvt3, Encoding::kEvt21, Encoding::kEvt2, Encoding::kDat,
                                   Encoding::kFlat64};

// A random word with types and times as in a real stream.
void AppendWord(Encoding encoding, int64_t t_us, Random& random, std::vector<uint8_t>& bytes) {
  const auto append = [&](auto word) {
    const auto* begin = reinterpret_cast<const uint8_t*>(&word);
    bytes.insert(bytes.end(), begin, begin + sizeof(word));
  };
  const auto any = static_cast<uint32_t>(random.NextU64());
  const bool is_time = random.UniformInt(20) == 0;
  switch (encoding) {
    case Encoding::kEvt3:
      if (is_time) return append(Evt3(8, static_cast<uint32_t>(t_us >> 12) & 0xfff));
      return append(Evt3(static_cast<uint32_t>(random.UniformInt(16)) & ~8u, any & 0xfff));
    case Encoding::kEvt2:
      if (is_time) return append(Evt2(8, static_cast<uint32_t>(t_us >> 6) & 0xfffffff));
      return append(random.UniformInt(9) == 0 ? any : Evt2Cd(any & 1, t_us & 0x3f, any >> 8 & 0x3ff, any >> 20));
    case Encoding::kEvt21: {
      const auto upper = is_time ? Evt2(8, static_cast<uint32_t>(t_us >> 6) & 0xfffffff)
                                 : Evt2Cd(any & 1, t_us & 0x3f, any >> 8 & 0x3ff, any >> 21 & 0x3ff);
      return append(static_cast<uint64_t>(upper) << 32 | static_cast<uint32_t>(random.NextU64()));
    }
    case Encoding::kDat:
      return append(static_cast<uint64_t>(any & 0x13ff03ff) << 32 | static_cast<uint32_t>(t_us));
    case Encoding::kFlat64:
      return append(static_cast<uint64_t>(t_us) << 32 | (any & 0x0ffc1ff3));
  }
}

std::vector<uint8_t> Stream(Encoding encoding, size_t num_words, uint64_t seed) {
  Random random(seed);
  std::vector<uint8_t> bytes;
  int64_t t_us = 16'000'000;
  for (size_t i = 0; i < num_words; ++i) {
    if (random.UniformInt(500) == 0) t_us += 900'000;
    t_us += static_cast<int64_t>(random.UniformInt(40)) - 2;
    AppendWord(encoding, t_us, random, bytes);
  }
  return bytes;
}

std::unique_ptr<EventDecoder> MakeDecoder(Encoding encoding) { return MakeEventDecoder(encoding, kSensor).value(); }

std::string Save(const EventDecoder& decoder) {
  StateWriter writer;
  decoder.SaveState(writer);
  return writer.Take();
}

absl::Status Load(const std::string& state, EventDecoder& decoder) {
  StateReader reader(state);
  decoder.LoadState(reader);
  return reader.Finish();
}

TEST(DecoderStateTest, ALoadedDecoderContinuesWithTheSameEvents) {
  for (const Encoding encoding : kEncodings) {
    const std::vector<uint8_t> bytes = Stream(encoding, 20'000, 1);
    const auto whole = MakeDecoder(encoding);
    auto moved = MakeDecoder(encoding);
    DecodedEvents expected, events;
    Random random(2);
    size_t begin = 0;
    for (const size_t end : RandomCuts(bytes.size(), 400, 3)) {
      const auto piece = absl::MakeConstSpan(bytes).subspan(begin, end - begin);
      whole->Decode(piece, expected);
      moved->Decode(piece, events);
      if (random.UniformInt(50) == 0) {
        whole->ResetAfterLoss();
        moved->ResetAfterLoss();
      }
      const std::string state = Save(*moved);
      EXPECT_EQ(state, Save(*whole));
      moved = MakeDecoder(encoding);
      ASSERT_EQ(Load(state, *moved), absl::OkStatus()) << EncodingName(encoding) << " at byte " << end;
      ASSERT_EQ(Save(*moved), state);
      ASSERT_EQ(moved->pending_bytes(), whole->pending_bytes());
      begin = end;
    }
    EXPECT_EQ(events.events, expected.events);
    EXPECT_EQ(events.triggers, expected.triggers);
    EXPECT_EQ(events.time_marks, expected.time_marks);
    EXPECT_EQ(moved->counts(), whole->counts());
    EXPECT_GT(events.events.size(), 300u) << EncodingName(encoding);
    EXPECT_GT(moved->counts().dropped_events(), 0u) << EncodingName(encoding);
  }
}

template <typename Clock>
absl::Status SaveAndLoad(const Clock& clock) {
  StateWriter writer;
  writer(clock);
  const std::string state = writer.Take();
  StateReader reader(state);
  Clock loaded;
  reader(loaded);
  return reader.Finish();
}

template <typename Clock>
Clock ClockAt(auto... fields) {
  StateWriter writer;
  writer(fields...);
  const std::string state = writer.Take();
  StateReader reader(state);
  Clock clock;
  reader(clock);
  EXPECT_TRUE(reader.Finish().ok()) << reader.status();
  return clock;
}

TEST(DecoderStateTest, ClocksDoNotWrapBeyondTheLargestTimeOfAState) {
  const uint64_t none = 0;
  const int64_t zero = 0;
  int64_t near_us = kMaxStateTimeUs - 4 * Evt3Clock::kRangeUs;
  auto evt3 = ClockAt<Evt3Clock>(near_us, zero, none, none, true);
  near_us = kMaxStateTimeUs - 4 * Evt2Clock::kRangeUs;
  auto evt2 = ClockAt<Evt2Clock>(near_us, near_us, near_us, none, none, true);
  near_us = kMaxStateTimeUs - 4 * Clock32::kRangeUs;
  auto clock32 = ClockAt<Clock32>(near_us, none, none, true);
  for (int i = 0; i < 20; ++i) {
    for (const bool is_high : {true, false}) {
      evt3.SetHigh(is_high ? 0xfff : 0);
      evt3.SetLow(0xfff);
      evt2.SetHigh(is_high ? 0xfffffff : 0);
      evt2.SetLow(63);
      for (uint32_t quarter = 0; quarter < 4; ++quarter) clock32.Set(quarter << 30);
      EXPECT_TRUE(SaveAndLoad(evt3).ok() && SaveAndLoad(evt2).ok() && SaveAndLoad(clock32).ok()) << i;
      EXPECT_LT(std::max({evt3.now_us(), evt2.now_us(), clock32.now_us()}), kMaxStateTimeUs - (1 << 23));
    }
  }
  EXPECT_EQ(evt3.wraps(), 2u);
  EXPECT_EQ(evt2.wraps(), 2u);
}

TEST(DecoderStateTest, TruncatedStatesAreRefused) {
  for (const Encoding encoding : kEncodings) {
    const auto decoder = MakeDecoder(encoding);
    DecodedEvents events;
    decoder->Decode(Stream(encoding, 1000, 4), events);
    const std::string state = Save(*decoder);
    for (size_t size = 0; size < state.size(); ++size) {
      // Without its last number the state is that of a version that did not count padding words.
      if (encoding == Encoding::kEvt3 && size == state.size() - sizeof(uint64_t)) continue;
      EXPECT_EQ(Load(state.substr(0, size), *MakeDecoder(encoding)).code(), absl::StatusCode::kDataLoss);
    }
  }
}

TEST(DecoderStateTest, DamagedStatesAreRefusedOrDecodeEventsOfTheSensor) {
  for (const Encoding encoding : kEncodings) {
    const auto decoder = MakeDecoder(encoding);
    DecodedEvents events;
    const std::vector<uint8_t> bytes = Stream(encoding, 2000, 5);
    decoder->Decode(absl::MakeConstSpan(bytes).subspan(0, bytes.size() / 2 + 3), events);
    const std::string state = Save(*decoder);
    Random random(6);
    int num_loaded = 0;
    for (int i = 0; i < 1000; ++i) {
      std::string damaged = state;
      damaged[random.UniformInt(damaged.size())] ^= static_cast<char>(1 << random.UniformInt(8));
      const auto loaded = MakeDecoder(encoding);
      const absl::Status status = Load(damaged, *loaded);
      if (!status.ok()) {
        EXPECT_EQ(status.code(), absl::StatusCode::kDataLoss);
        continue;
      }
      ++num_loaded;
      events.events.clear();
      loaded->Decode(absl::MakeConstSpan(bytes).subspan(bytes.size() / 2 + 3), events);
      for (const Event& event : events.events) {
        ASSERT_LT(event.x, kSensor.width_px);
        ASSERT_LT(event.y, kSensor.height_px);
      }
    }
    EXPECT_GT(num_loaded, 0);
    EXPECT_LT(num_loaded, 1000);
  }
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "client/containers/hdf5/ecf_codec.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "absl/strings/escaping.h"
#include "core/numerics/random.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAreArray;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

std::vector<uint8_t> FromHex(const std::string& hex) {
  const std::string bytes = absl::HexStringToBytes(hex);
  return {bytes.begin(), bytes.end()};
}

// Six neighbours of a row, one event of the other polarity, and one 20 us later in the next row.
const std::vector<Event> kRowOfEvents = {{1000, 100, 7, 1}, {1000, 101, 7, 1}, {1000, 102, 7, 1}, {1000, 103, 7, 1},
                                         {1000, 104, 7, 1}, {1000, 105, 7, 1}, {1000, 300, 7, 0}, {1020, 302, 8, 0}};
const std::vector<Event> kScatteredInRow = {{5'000'000'000, 5, 9, 0},
                                            {5'000'000'003, 900, 9, 1},
                                            {5'000'000'006, 3, 9, 0},
                                            {5'000'000'009, 1270, 9, 1},
                                            {5'000'000'012, 640, 9, 0}};
const std::vector<Event> kScattered = {
    {70, 5, 0, 0}, {170, 900, 100, 1}, {270, 3, 200, 0}, {370, 1270, 300, 1}, {470, 640, 400, 0}};

struct GoldenChunk {
  const char* hex;
  std::vector<Event> events;
};

// Written by Prophesee's encoder (hdf5_ecf), in each of the three layouts.
const std::vector<GoldenChunk>& GoldenChunks() {
  static const auto* const kChunks = new std::vector<GoldenChunk>{
      {"20000000e80300000000000007f4f101e70001019f0c88258602", kRowOfEvents},
      {"1500000000f2052a0100000001313131312501a9000670ed09005000000000", kScatteredInRow},
      {"16000000460000000000000001f4f601f4f601f4f601f4f601090a000006804706edc9120c000005190000000000000000",
       kScattered}};
  return *kChunks;
}

TEST(EcfCodecTest, DecodesChunksOfPropheseesEncoder) {
  for (const GoldenChunk& chunk : GoldenChunks()) {
    EventVector events;
    ASSERT_TRUE(DecodeEcfChunk(FromHex(chunk.hex), events).ok());
    EXPECT_THAT(events, ElementsAreArray(chunk.events));
  }
}

TEST(EcfCodecTest, EncodesAsShortAsPropheseesEncoder) {
  for (const GoldenChunk& chunk : GoldenChunks()) {
    std::vector<uint8_t> bytes;
    ASSERT_TRUE(EncodeEcfChunk(chunk.events, bytes).ok());
    EXPECT_LE(bytes.size(), FromHex(chunk.hex).size());
    EventVector events;
    ASSERT_TRUE(DecodeEcfChunk(bytes, events).ok());
    EXPECT_THAT(events, ElementsAreArray(chunk.events));
  }
}

// Events like those of edges: runs in rows, repeated times, sometimes a long pause or a step back in time.
std::vector<Event> RandomEvents(uint64_t seed, size_t count, int max_run) {
  Random random(seed);
  std::vector<Event> events;
  int64_t t_us = static_cast<int64_t>(random.Uniform(0, 1e12));
  while (events.size() < count) {
    t_us += static_cast<int64_t>(random.Uniform(0, 20));
    if (random.Uniform(0, 1) < 0.01) t_us += static_cast<int64_t>(random.Uniform(0, 1e9));
    if (random.Uniform(0, 1) < 0.01) t_us -= static_cast<int64_t>(random.Uniform(0, 100));
    const auto y = static_cast<uint16_t>(random.Uniform(0, 2048));
    auto x = static_cast<uint16_t>(random.Uniform(0, 2000));
    const auto polarity = static_cast<uint8_t>(random.Uniform(0, 2));
    for (auto run = static_cast<int>(random.Uniform(1, max_run)); run > 0 && events.size() < count; --run) {
      events.push_back({t_us, x, y, polarity});
      x = static_cast<uint16_t>(std::min(2047.0, x + random.Uniform(0, 3)));
    }
  }
  return events;
}

TEST(EcfCodecTest, RoundTripsAreExact) {
  for (uint64_t seed = 0; seed < 60; ++seed) {
    const size_t count = seed < 20 ? seed + 1 : seed < 55 ? 40 * seed : kEcfMaxEvents;
    const std::vector<Event> events = RandomEvents(seed, count, seed % 2 == 0 ? 2 : 60);
    std::vector<uint8_t> chunk;
    ASSERT_TRUE(EncodeEcfChunk(events, chunk).ok());
    EXPECT_LT(chunk.size(), 12 + 16 * events.size());
    EventVector decoded;
    ASSERT_TRUE(DecodeEcfChunk(chunk, decoded).ok());
    ASSERT_THAT(decoded, ElementsAreArray(events)) << seed;
  }
}

TEST(EcfCodecTest, LongRunsRoundTrip) {
  std::vector<Event> events(kEcfMaxEvents, Event{123, 4, 5, 1});
  std::vector<uint8_t> chunk;
  ASSERT_TRUE(EncodeEcfChunk(events, chunk).ok());
  EventVector decoded;
  ASSERT_TRUE(DecodeEcfChunk(chunk, decoded).ok());
  EXPECT_THAT(decoded, ElementsAreArray(events));
}

TEST(EcfCodecTest, DecodingAppends) {
  EventVector events = {{1, 2, 3, 0}};
  ASSERT_TRUE(DecodeEcfChunk(FromHex(GoldenChunks()[0].hex), events).ok());
  EXPECT_THAT(events, SizeIs(9));
  EXPECT_EQ(events.front(), (Event{1, 2, 3, 0}));
}

// Prophesee's encoder may mark columns that belong to no event, after the last one.
TEST(EcfCodecTest, ColumnsAfterTheLastEventAreIgnored) {
  std::vector<uint8_t> chunk = FromHex(GoldenChunks()[0].hex);
  chunk[chunk.size() - 3] = 0x3f;  // the mask of the last column word
  EventVector events;
  ASSERT_TRUE(DecodeEcfChunk(chunk, events).ok());
  EXPECT_THAT(events, SizeIs(8));
}

TEST(EcfCodecTest, EveryTruncationIsAnError) {
  for (const GoldenChunk& golden : GoldenChunks()) {
    const std::vector<uint8_t> chunk = FromHex(golden.hex);
    for (size_t size = 0; size < chunk.size(); ++size) {
      EventVector events;
      const absl::Status status = DecodeEcfChunk(absl::MakeConstSpan(chunk).first(size), events);
      EXPECT_EQ(status.code(), absl::StatusCode::kDataLoss) << size;
      EXPECT_THAT(status.message(), HasSubstr("of an ECF chunk: it ends"));
      EXPECT_THAT(events, IsEmpty());
    }
  }
}

TEST(EcfCodecTest, DamageIsAnErrorWithThePlace) {
  struct Case {
    const char* hex;
    const char* message;
  };
  const Case cases[] = {
      {"04000400", "byte 4 of 4 of an ECF chunk: 65537 events"},
      // Two times for one event.
      {"0400000001000000000000000200a00080", "byte 13 of 17 of an ECF chunk: more times than events"},
      // A negative time.
      {"04000000ffffffffffffffff01", "byte 13 of 13 of an ECF chunk: a time is out of range"},
      // A step of 17 times four bits.
      {"040000000100000000000000f1f1f1f1f1f1f1f1f1f1f1f1f1f1f1f1f101", "a time step has more than 64 bits"},
      // Two rows for one event.
      {"04000000010000000000000001020000000000", "more rows or polarities than events"},
  };
  for (const Case& wrong : cases) {
    EventVector events;
    const absl::Status status = DecodeEcfChunk(FromHex(wrong.hex), events);
    EXPECT_EQ(status.code(), absl::StatusCode::kDataLoss) << wrong.hex;
    EXPECT_THAT(status.message(), HasSubstr(wrong.message));
    EXPECT_THAT(events, IsEmpty());
  }
}

TEST(EcfCodecTest, EncodingRefusesWhatTheFormatCannotHold) {
  std::vector<uint8_t> chunk;
  EXPECT_THAT(EncodeEcfChunk({}, chunk).message(), HasSubstr("has 1 to 65535 events, not 0"));
  EXPECT_EQ(EncodeEcfChunk(std::vector<Event>(65536), chunk).code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(EncodeEcfChunk(std::vector<Event>{{}, {5, 2048, 0, 0}}, chunk).message(),
              HasSubstr("event 1 of a chunk (x 2048, y 0, t 5 us"));
  EXPECT_FALSE(EncodeEcfChunk(std::vector<Event>{{-1, 0, 0, 0}}, chunk).ok());
  EXPECT_FALSE(EncodeEcfChunk(std::vector<Event>{{1, 0, 2048, 0}}, chunk).ok());
  EXPECT_FALSE(EncodeEcfChunk(std::vector<Event>{{1, 0, 0, 2}}, chunk).ok());
  EXPECT_THAT(chunk, IsEmpty());
}

}  // namespace
}  // namespace evpose::client

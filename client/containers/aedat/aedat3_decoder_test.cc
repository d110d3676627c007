// SPDX-License-Identifier: Apache-2.0
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "client/containers/aedat/aedat_testing.h"
#include "core/base/byte_order.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

struct Record3 {
  uint32_t bits;
  int32_t time;
};

uint32_t PolarityBits(uint32_t x, uint32_t y, uint32_t polarity) { return x << 17 | y << 2 | polarity << 1 | 1; }
uint32_t SpecialBits(uint32_t type) { return type << 1 | 1; }

void AppendPacket(int16_t type, int16_t source, int32_t overflow, const std::vector<Record3>& records,
                  std::vector<uint8_t>& out) {
  const auto count = static_cast<int32_t>(records.size());
  AppendLittleEndian(type, out);
  AppendLittleEndian(source, out);
  for (const int32_t number : {8, 4, overflow, count, count, count}) AppendLittleEndian(number, out);
  for (const Record3& record : records) {
    AppendLittleEndian(record.bits, out);
    AppendLittleEndian(record.time, out);
  }
}

const std::function<std::unique_ptr<AedatDecoder>()> kMakeAedat3 = [] { return MakeAedat3Decoder({128, 128}); };

std::vector<uint8_t> ValidPackets() {
  std::vector<uint8_t> bytes;
  AppendPacket(0, 1, 0, {{SpecialBits(2), 90}, {SpecialBits(10), 95}, {SpecialBits(4), 96}, {SpecialBits(1), 97}},
               bytes);
  AppendPacket(1, 1, 0,
               {{PolarityBits(0, 127, 1), 100}, {PolarityBits(127, 0, 0), 101}, {PolarityBits(1, 1, 1) - 1, 102}},
               bytes);
  AppendPacket(2, 1, 0, {{1, 2}, {3, 4}}, bytes);                // a packet of frames, here of small ones
  AppendPacket(1, 2, 0, {{PolarityBits(5, 5, 1), 103}}, bytes);  // of another camera
  AppendPacket(1, 1, 2, {{PolarityBits(7, 8, 1), 3}, {PolarityBits(128, 8, 1), 4}, {PolarityBits(7, 8, 1), -1}}, bytes);
  return bytes;
}

TEST(Aedat3DecoderTest, DecodesEventsAndEdges) {
  const std::vector<uint8_t> bytes = ValidPackets();
  const DecodedAedat decoded = DecodeInPieces(kMakeAedat3, bytes, bytes.size());
  EXPECT_THAT(decoded.events,
              ElementsAre(Event{100, 0, 127, 1}, Event{101, 127, 0, 0}, Event{(int64_t{2} << 31) + 3, 7, 8, 1}));
  EXPECT_THAT(decoded.triggers, ElementsAre(Trigger{90, 0, 1}, Trigger{95, 2, 0}));
  EXPECT_EQ(decoded.counts, (AedatCounts{.cd_events = 3,
                                         .triggers = 2,
                                         .other_records = 2,
                                         .other_packets = 2,
                                         .outside_sensor = 1,
                                         .invalid_events = 2}));
}

TEST(Aedat3DecoderTest, TheOutputDoesNotDependOnTheCuts) {
  const std::vector<uint8_t> bytes = ValidPackets();
  const DecodedAedat whole = DecodeInPieces(kMakeAedat3, bytes, bytes.size());
  for (const size_t piece : {1, 7, 8, 30}) EXPECT_TRUE(DecodeInPieces(kMakeAedat3, bytes, piece) == whole) << piece;
}

TEST(Aedat3DecoderTest, AllTypesOfEdges) {
  std::vector<uint8_t> bytes;
  std::vector<Record3> records;
  for (uint32_t type = 0; type < 20; ++type) records.push_back({SpecialBits(type), static_cast<int32_t>(type)});
  AppendPacket(0, 0, 0, records, bytes);
  const DecodedAedat decoded = DecodeInPieces(kMakeAedat3, bytes, bytes.size());
  EXPECT_THAT(decoded.triggers, ElementsAre(Trigger{2, 0, 1}, Trigger{3, 0, 0}, Trigger{6, 1, 1}, Trigger{7, 1, 0},
                                            Trigger{9, 2, 1}, Trigger{10, 2, 0}));
  EXPECT_EQ(decoded.counts.other_records, 14);
}

TEST(Aedat3DecoderTest, TruncatedPacketsAreCounted) {
  std::vector<uint8_t> bytes;
  AppendPacket(1, 1, 0, {{PolarityBits(1, 2, 1), 100}, {PolarityBits(3, 4, 1), 101}}, bytes);
  const auto counts = [&bytes](size_t size) {
    return DecodeInPieces(kMakeAedat3, absl::MakeConstSpan(bytes).first(size), 16).counts;
  };
  EXPECT_EQ(counts(27), (AedatCounts{.lost_bytes = 27}));
  EXPECT_EQ(counts(28), (AedatCounts{.damaged_packets = 1}));
  EXPECT_EQ(counts(39), (AedatCounts{.cd_events = 1, .damaged_packets = 1, .lost_bytes = 3}));
}

TEST(Aedat3DecoderTest, AfterADamagedHeaderTheRestIsCounted) {
  for (const size_t damaged_byte : {1u, 3u, 7u, 11u, 15u, 19u, 23u, 27u}) {  // the sign of each field
    std::vector<uint8_t> bytes;
    AppendPacket(1, 1, 0, {{PolarityBits(1, 2, 1), 100}}, bytes);
    bytes[damaged_byte] |= 0x80;
    AppendPacket(1, 1, 0, {{PolarityBits(3, 4, 1), 101}}, bytes);
    const DecodedAedat decoded = DecodeInPieces(kMakeAedat3, bytes, 10);
    EXPECT_THAT(decoded.events, IsEmpty());
    EXPECT_EQ(decoded.counts, (AedatCounts{.damaged_packets = 1, .lost_bytes = 72})) << damaged_byte;
  }
}

}  // namespace
}  // namespace evpose::client

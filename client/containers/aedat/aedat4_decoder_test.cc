// SPDX-License-Identifier: Apache-2.0
#include "client/containers/aedat/aedat4_decoder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "client/containers/aedat/aedat4_testing.h"
#include "client/containers/aedat/aedat_testing.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAre;
using ::testing::ElementsAreArray;
using ::testing::HasSubstr;
using ::testing::SizeIs;

constexpr int64_t kUnixTimeUs = 1'600'000'000'000'000;

std::vector<Event> ManyEvents(size_t count) {
  std::vector<Event> events;
  for (size_t i = 0; i < count; ++i) {
    events.push_back({kUnixTimeUs + static_cast<int64_t>(i / 3), static_cast<uint16_t>(i * 7 % 346),
                      static_cast<uint16_t>(i * 11 % 260), static_cast<uint8_t>(i % 2)});
  }
  return events;
}

DecodedAedat DecodeFile(absl::Span<const uint8_t> bytes, size_t piece_bytes = 1000) {
  const Aedat4Header header = ParseAedat4Header(bytes, true).value().value();
  return DecodeInPieces([&header] { return MakeAedat4Decoder(header); }, bytes.subspan(header.size_bytes), piece_bytes);
}

class Aedat4Test : public testing::TestWithParam<Aedat4File::Frames> {};

TEST_P(Aedat4Test, DecodesTheFirstCamera) {
  Aedat4File file(GetParam());
  const std::vector<Event> events = ManyEvents(20'000);
  file.AddTriggers(2, {{kUnixTimeUs, 1}, {kUnixTimeUs + 5, 2}, {kUnixTimeUs + 6, 4}, {kUnixTimeUs + 7, 6}});
  file.AddEvents(0, events);
  file.AddEvents(3, {{kUnixTimeUs, 1, 2, 1}});
  file.AddEvents(0, {{kUnixTimeUs + 9000, 345, 259, 1}, {kUnixTimeUs + 9000, 346, 0, 1}, {-5, 0, 0, 0}});
  const Aedat4Header header = ParseAedat4Header(file.bytes(), true).value().value();
  EXPECT_EQ(header.geometry, (SensorGeometry{346, 260}));
  EXPECT_EQ(header.source, "A");
  EXPECT_EQ(header.trigger_stream, 2);
  const DecodedAedat decoded = DecodeFile(file.bytes());
  ASSERT_THAT(decoded.events, SizeIs(events.size() + 1));
  EXPECT_THAT(absl::MakeConstSpan(decoded.events).first(events.size()), ElementsAreArray(events));
  EXPECT_EQ(decoded.events.back(), (Event{kUnixTimeUs + 9000, 345, 259, 1}));
  EXPECT_THAT(decoded.triggers,
              ElementsAre(Trigger{kUnixTimeUs, 0, 1}, Trigger{kUnixTimeUs + 5, 0, 0}, Trigger{kUnixTimeUs + 6, 1, 1}));
  EXPECT_EQ(decoded.counts, (AedatCounts{.cd_events = 20'001,
                                         .triggers = 3,
                                         .other_records = 1,
                                         .other_packets = 1,
                                         .outside_sensor = 1,
                                         .invalid_events = 1}));
  EXPECT_TRUE(DecodeFile(file.bytes(), 1) == decoded);
}

TEST_P(Aedat4Test, ADamagedPacketIsSkippedAndCounted) {
  Aedat4File file(GetParam());
  const size_t begin = file.bytes().size();
  file.AddEvents(0, ManyEvents(100));
  // The identifier of the FlatBuffer, or the mark of the frame.
  const size_t damaged = begin + 8 + (GetParam() == Aedat4File::Frames::kNone ? 8 : 0);
  file.bytes()[damaged] ^= 0xff;
  file.AddEvents(0, {{kUnixTimeUs, 1, 2, 1}});
  const DecodedAedat decoded = DecodeFile(file.bytes());
  EXPECT_THAT(decoded.events, ElementsAre(Event{kUnixTimeUs, 1, 2, 1}));
  EXPECT_EQ(decoded.counts, (AedatCounts{.cd_events = 1, .damaged_packets = 1}));
}

TEST_P(Aedat4Test, ATruncatedFileKeepsItsWholePackets) {
  Aedat4File file(GetParam());
  file.AddEvents(0, ManyEvents(100));
  const size_t first_end = file.bytes().size();
  file.AddEvents(0, ManyEvents(100));
  for (const size_t size : {first_end + 3, first_end + 8, file.bytes().size() - 1}) {
    const DecodedAedat decoded = DecodeFile(absl::MakeConstSpan(file.bytes()).first(size));
    EXPECT_THAT(decoded.events, SizeIs(100));
    EXPECT_EQ(decoded.counts.lost_bytes, size == first_end + 3 ? 3 : size - first_end - 8);
    EXPECT_EQ(decoded.counts.damaged_packets, size == first_end + 3 ? 0 : 1);
  }
}

TEST_P(Aedat4Test, AFrameThatEndsEarlyIsDamaged) {
  Aedat4File file(GetParam());
  const size_t begin = file.bytes().size();
  file.AddEvents(0, ManyEvents(100));
  file.bytes().pop_back();
  file.bytes()[begin + 4] -= 1;  // the size of the packet
  EXPECT_EQ(DecodeFile(file.bytes()).counts, (AedatCounts{.damaged_packets = 1}));
}

INSTANTIATE_TEST_SUITE_P(Compressions, Aedat4Test,
                         testing::Values(Aedat4File::Frames::kNone, Aedat4File::Frames::kLz4,
                                         Aedat4File::Frames::kZstd));

TEST(Aedat4DecoderTest, TheTableBehindThePacketsIsNoData) {
  // The size of the header does not depend on the position of the table, which has 64 bits.
  const size_t header_bytes = Aedat4File(Aedat4File::Frames::kNone, 1 << 20).bytes().size();
  Aedat4File file(Aedat4File::Frames::kNone);
  const size_t begin = file.bytes().size();
  file.AddEvents(0, ManyEvents(3));
  Aedat4File exact(Aedat4File::Frames::kNone, static_cast<int64_t>(header_bytes + file.bytes().size() - begin));
  exact.AddEvents(0, ManyEvents(3));
  exact.AddBytes({1, 2, 3, 4, 5});
  EXPECT_EQ(DecodeFile(exact.bytes()).counts, (AedatCounts{.cd_events = 3}));
}

TEST(Aedat4DecoderTest, ACallEndsAfterAPacketOfManyEvents) {
  Aedat4File file(Aedat4File::Frames::kZstd);
  const std::vector<Event> events(200'000, Event{kUnixTimeUs, 1, 2, 1});
  for (int i = 0; i < 3; ++i) file.AddEvents(0, events);
  const Aedat4Header header = ParseAedat4Header(file.bytes(), true).value().value();
  const std::unique_ptr<AedatDecoder> decoder = MakeAedat4Decoder(header);
  absl::Span<const uint8_t> rest = absl::MakeConstSpan(file.bytes()).subspan(header.size_bytes);
  for (size_t i = 1; i <= 3; ++i) {
    EXPECT_FALSE(rest.empty());
    DecodedEvents out;
    decoder->Decode(rest, out);
    EXPECT_THAT(out.events, SizeIs(events.size())) << i;
  }
  EXPECT_TRUE(rest.empty());
}

// The packets between two usual ones have one byte too many, in the file or in their content.
TEST(Aedat4DecoderTest, PacketsAboveTheLimitAreSkippedAndCounted) {
  for (const auto frames : {Aedat4File::Frames::kNone, Aedat4File::Frames::kLz4, Aedat4File::Frames::kZstd}) {
    Aedat4File file(frames);
    file.AddEvents(0, ManyEvents(3));
    file.AddContent(0, std::vector<uint8_t>(kMaxAedat4PacketBytes + 1, 0));
    file.AddEvents(0, ManyEvents(4));
    EXPECT_EQ(DecodeFile(file.bytes()).counts, (AedatCounts{.cd_events = 7, .oversized_packets = 1}));
  }
  Aedat4File file(Aedat4File::Frames::kZstd);
  file.AddContent(0, std::vector<uint8_t>(kMaxAedat4PacketBytes, 0));
  EXPECT_EQ(DecodeFile(file.bytes()).counts, (AedatCounts{.damaged_packets = 1}));
}

TEST(Aedat4DecoderTest, ANegativeSizeEndsTheReading) {
  Aedat4File file(Aedat4File::Frames::kNone);
  file.AddBytes({0, 0, 0, 0, 0, 0, 0, 0x80});
  file.AddEvents(0, ManyEvents(3));
  const AedatCounts counts = DecodeFile(file.bytes()).counts;
  EXPECT_EQ(counts.cd_events, 0);
  EXPECT_EQ(counts.damaged_packets, 1);
  EXPECT_GT(counts.lost_bytes, 8);
}

TEST(Aedat4DecoderTest, HeadersThatCannotBeUsedAreErrors) {
  Aedat4File file(Aedat4File::Frames::kNone);
  const std::vector<uint8_t> whole = file.bytes();
  for (size_t size = 0; size < whole.size(); ++size) {
    const absl::Span<const uint8_t> part = absl::MakeConstSpan(whole).first(size);
    EXPECT_FALSE(ParseAedat4Header(part, false).value().has_value());
    EXPECT_EQ(ParseAedat4Header(part, true).status().code(), absl::StatusCode::kInvalidArgument);
  }
  const auto error = [](const std::vector<uint8_t>& bytes) {
    return std::string(ParseAedat4Header(bytes, true).status().message());
  };
  EXPECT_THAT(error(Aedat4File(static_cast<Aedat4File::Frames>(7)).bytes()),
              HasSubstr("the compression 7 is not known"));
  std::vector<uint8_t> changed = whole;
  changed[14 + 3] = 0x7f;
  EXPECT_THAT(error(changed), HasSubstr("it has 2130"));
  changed = whole;
  changed[14 + 8] = 'X';
  EXPECT_THAT(error(changed), HasSubstr("a FlatBuffer is no IOHE"));
  std::string text(whole.begin(), whole.end());
  for (size_t at = text.find("EVTS"); at != std::string::npos; at = text.find("EVTS")) text.replace(at, 4, "NONE");
  EXPECT_THAT(error({text.begin(), text.end()}), HasSubstr("the recording has no stream of events"));
  text.replace(text.find("<dv"), 3, "((((");
  EXPECT_THAT(error({text.begin(), text.end()}), HasSubstr("is damaged"));
}

}  // namespace
}  // namespace evpose::client

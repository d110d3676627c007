// SPDX-License-Identifier: Apache-2.0
#include "client/diagnosis/recording_slice.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/events/encoder.h"
#include "core/recordings/event_reader.h"

namespace evpose::client {
namespace {

constexpr SensorGeometry kVga = {640, 480};
constexpr int64_t kBeginUs = 16'000'000;  // EVT3's clock wraps 0.78 s later

// A recording with an event in each 0.1 ms for `duration_us`.
std::vector<Event> Events(int64_t duration_us) {
  std::vector<Event> events;
  for (int64_t t_us = 0; t_us < duration_us; t_us += 100) {
    const auto number = static_cast<uint16_t>(t_us / 100);
    events.push_back({kBeginUs + t_us, static_cast<uint16_t>(number % 640), static_cast<uint16_t>(number % 480),
                      static_cast<uint8_t>(number % 2)});
  }
  return events;
}

std::string FileOf(Encoding encoding, const std::vector<Event>& events) {
  std::vector<uint8_t> bytes;
  auto encoder = MakeEventEncoder(encoding, kVga);
  EXPECT_TRUE(encoder.ok() && (*encoder)->Encode(events, bytes).ok());
  return MakeRawHeader(encoding, kVga) + std::string(bytes.begin(), bytes.end());
}

std::vector<Event> ReadEvents(const std::string& file) {
  const auto reader = OpenSlice(file);
  EXPECT_TRUE(reader.ok()) << reader.status();
  auto events = EventReader::Make(**reader);
  std::vector<Event> all;
  while (events->Next().value()) {
    all.insert(all.end(), events->decoded().events.begin(), events->decoded().events.end());
  }
  return all;
}

absl::StatusOr<RecordingSlice> Slice(const std::string& file, const SliceOptions& options) {
  const auto reader = OpenSlice(file);
  EXPECT_TRUE(reader.ok()) << reader.status();
  return ReadSlice(**reader, options);
}

class RecordingSliceTest : public ::testing::TestWithParam<Encoding> {};

TEST_P(RecordingSliceTest, WholeRecordingIsUnchanged) {
  const std::string file = FileOf(GetParam(), Events(50'000));
  const auto slice = Slice(file, {});
  ASSERT_TRUE(slice.ok()) << slice.status();
  EXPECT_EQ(slice->file, file);
  EXPECT_FALSE(slice->is_cut);
}

TEST_P(RecordingSliceTest, LaterPartHasTheEventsOfTheRecording) {
  const std::vector<Event> events = Events(1'200'000);
  const std::string file = FileOf(GetParam(), events);
  const auto slice = Slice(file, {.start_s = 1.0, .duration_s = 0.1});
  ASSERT_TRUE(slice.ok()) << slice.status();
  EXPECT_FALSE(slice->is_cut);
  EXPECT_NEAR(static_cast<double>(slice->begin_us), kBeginUs + 1e6, 2000.0);
  EXPECT_NEAR(static_cast<double>(slice->end_us), kBeginUs + 1.1e6, 2000.0);
  const auto reader = OpenSlice(slice->file);
  ASSERT_TRUE(reader.ok());
  const std::vector<Event> part = ReadEvents(slice->file);
  ASSERT_GT(part.size(), 900u);
  const int64_t first_us = part.front().t_us + (*reader)->header().time_offset_us;
  const auto first = static_cast<size_t>((first_us - kBeginUs) / 100);
  ASSERT_LE(first + part.size(), events.size());
  for (size_t i = 0; i < part.size(); ++i) {
    Event event = part[i];
    event.t_us += (*reader)->header().time_offset_us;
    EXPECT_EQ(event, events[first + i]) << i;
  }
}

TEST_P(RecordingSliceTest, BoundsCutIt) {
  const std::string file = FileOf(GetParam(), Events(100'000));
  const auto small = Slice(file, {.max_bytes = 1000});
  ASSERT_TRUE(small.ok());
  EXPECT_TRUE(small->is_cut);
  EXPECT_LE(small->data_bytes, 1000u);
  EXPECT_GT(small->data_bytes, 500u);
  EXPECT_EQ(file.substr(0, small->file.size()), small->file);
  const auto brief = Slice(file, {.duration_s = 0.09, .max_duration_s = 0.02});
  ASSERT_TRUE(brief.ok());
  EXPECT_TRUE(brief->is_cut);
  EXPECT_NEAR(static_cast<double>(brief->end_us - brief->begin_us), 20'000.0, 2000.0);
}

INSTANTIATE_TEST_SUITE_P(Encodings, RecordingSliceTest,
                         ::testing::Values(Encoding::kEvt3, Encoding::kEvt2, Encoding::kEvt21, Encoding::kDat,
                                           Encoding::kFlat64),
                         [](const auto& test) {
                           return std::string(EncodingName(test.param) == "EVT2.1" ? "EVT21"
                                                                                   : EncodingName(test.param));
                         });

TEST(RecordingSliceErrorsTest, NothingThere) {
  const std::string file = FileOf(Encoding::kEvt3, Events(10'000));
  EXPECT_TRUE(absl::IsOutOfRange(Slice(file, {.start_s = 5.0}).status()));
  EXPECT_FALSE(OpenSlice("no header").ok());
  EXPECT_FALSE(OpenSlice("").ok());
}

}  // namespace
}  // namespace evpose::client

// SPDX-License-Identifier: Apache-2.0
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>

#include "client/containers/aedat/aedat_testing.h"
#include "core/base/byte_order.h"
#include "tests/data/test_data.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAre;

void AppendAedat2Record(uint32_t address, uint32_t t_us, std::vector<uint8_t>& out) {
  for (const uint32_t word : {address, t_us}) {
    for (int shift = 24; shift >= 0; shift -= 8) out.push_back(static_cast<uint8_t>(word >> shift));
  }
}

const std::function<std::unique_ptr<AedatDecoder>()> kMakeDvs128 = [] {
  return MakeAedat2Decoder(Aedat2Layout::kDvs128, {128, 128});
};
const std::function<std::unique_ptr<AedatDecoder>()> kMakeDavis240 = [] {
  return MakeAedat2Decoder(Aedat2Layout::kDavis, {240, 180});
};

TEST(Aedat2DecoderTest, Dvs128IsMirroredAndCountsFromBelow) {
  std::vector<uint8_t> bytes;
  AppendAedat2Record(0, 10, bytes);                        // ON, the last column and row
  AppendAedat2Record(127 << 8 | 127 << 1 | 1, 11, bytes);  // OFF, the first ones
  AppendAedat2Record(3 << 8 | 5 << 1, 12, bytes);
  AppendAedat2Record(0x8000, 13, bytes);   // a mark of the device
  AppendAedat2Record(0x10000, 14, bytes);  // an address of another sensor
  const DecodedAedat decoded = DecodeInPieces(kMakeDvs128, bytes, bytes.size());
  EXPECT_THAT(decoded.events, ElementsAre(Event{10, 127, 127, 1}, Event{11, 0, 0, 0}, Event{12, 122, 124, 1}));
  EXPECT_EQ(decoded.counts, (AedatCounts{.cd_events = 3, .other_records = 1, .outside_sensor = 1}));
}

TEST(Aedat2DecoderTest, DavisHasImagesInertialMeasurementsAndTriggers) {
  std::vector<uint8_t> bytes;
  AppendAedat2Record(179u << 22 | 239u << 12 | 1 << 11, 20, bytes);
  AppendAedat2Record(0, 21, bytes);
  AppendAedat2Record(180u << 22, 22, bytes);          // beyond the last row
  AppendAedat2Record(240u << 12, 23, bytes);          // beyond the last column
  AppendAedat2Record(0x80000000 | 0xc00, 24, bytes);  // inertial measurement
  AppendAedat2Record(0x80000000 | 0x400, 25, bytes);  // sample of an image
  AppendAedat2Record(0x400, 26, bytes);               // trigger
  const DecodedAedat decoded = DecodeInPieces(kMakeDavis240, bytes, bytes.size());
  EXPECT_THAT(decoded.events, ElementsAre(Event{20, 0, 0, 1}, Event{21, 239, 179, 0}));
  EXPECT_THAT(decoded.triggers, ElementsAre(Trigger{26, 0, 1}));
  EXPECT_EQ(decoded.counts,
            (AedatCounts{.cd_events = 2, .triggers = 1, .imu_samples = 1, .image_samples = 1, .outside_sensor = 2}));
}

TEST(Aedat2DecoderTest, TimesUnwrapAndMayStepBack) {
  std::vector<uint8_t> bytes;
  for (const uint32_t t_us : {0xfffffff0u, 0xffffffe0u, 5u, 0xfffffffeu, 6u}) AppendAedat2Record(0, t_us, bytes);
  std::vector<int64_t> times;
  for (const Event& event : DecodeInPieces(kMakeDvs128, bytes, 3).events) times.push_back(event.t_us);
  const int64_t wrap = int64_t{1} << 32;
  EXPECT_THAT(times, ElementsAre(wrap - 16, wrap - 32, wrap + 5, wrap - 2, wrap + 6));
}

TEST(Aedat2DecoderTest, AStepBackBeforeZeroIsAWrap) {
  std::vector<uint8_t> bytes;
  for (const uint32_t t_us : {5u, 0xfffffff0u}) AppendAedat2Record(0, t_us, bytes);
  EXPECT_EQ(DecodeInPieces(kMakeDvs128, bytes, 8).events.back().t_us, 0xfffffff0);
}

TEST(Aedat2DecoderTest, AnIncompleteRecordIsCounted) {
  std::vector<uint8_t> bytes;
  AppendAedat2Record(0, 10, bytes);
  AppendAedat2Record(0, 11, bytes);
  bytes.resize(13);
  EXPECT_EQ(DecodeInPieces(kMakeDvs128, bytes, 4).counts, (AedatCounts{.cd_events = 1, .lost_bytes = 5}));
}

TEST(Aedat2DecoderTest, TheLayoutOfOldFilesIsGuessedFromTheAddresses) {
  std::vector<uint8_t> bytes;
  AppendAedat2Record(0xffff, 0xffffffff, bytes);
  EXPECT_EQ(GuessAedat2Layout(bytes), Aedat2Layout::kDvs128);
  AppendAedat2Record(0x10000, 0, bytes);
  EXPECT_EQ(GuessAedat2Layout(bytes), Aedat2Layout::kUnknown);
}

class Aedat2RecordingTest : public testing::TestWithParam<const char*> {};

TEST_P(Aedat2RecordingTest, HasTheExpectedEvents) {
  const std::string folder = "real/formats/";
  const std::string path = FindTestData(folder + GetParam());
  if (path.empty()) GTEST_SKIP() << GetParam() << " is not in the test data";
  std::ifstream list(FindTestData(folder + "expected.json"));
  const nlohmann::json expected = nlohmann::json::parse(list).at(GetParam());
  std::ifstream file(path, std::ios::binary);
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  AedatHeader header = ParseAedatHeader(text, true).value().value();
  const absl::Span<const uint8_t> bytes = AsBytes(text).subspan(header.size_bytes);
  if (header.sensor.empty()) {
    header.layout = GuessAedat2Layout(bytes);
    header.geometry = {128, 128};
  }
  EXPECT_EQ(header.geometry.width_px, expected.at("width"));
  EXPECT_EQ(header.geometry.height_px, expected.at("height"));
  const auto make = [&header] { return MakeAedat2Decoder(header.layout, header.geometry); };
  const DecodedAedat whole = DecodeInPieces(make, bytes, bytes.size());
  EXPECT_EQ(whole.counts.cd_events, expected.at("cd_events"));
  EXPECT_EQ(whole.events.front().t_us, expected.at("t_first_us"));
  EXPECT_EQ(whole.events.back().t_us, expected.at("t_last_us"));
  EXPECT_EQ(whole.counts.imu_samples, expected.value("imu_words", 0));
  EXPECT_EQ(whole.counts.image_samples, expected.value("aps_words", 0));
  EXPECT_EQ(whole.counts.other_records, expected.value("special", 0));
  EXPECT_EQ(Sha256OfEvents(whole.events), expected.at("sha256"));
  EXPECT_TRUE(DecodeInPieces(make, bytes, 13) == whole);
}

INSTANTIATE_TEST_SUITE_P(Files, Aedat2RecordingTest, testing::Values("dvs128.aedat", "davis240c_imu.aedat"));

}  // namespace
}  // namespace evpose::client

// SPDX-License-Identifier: Apache-2.0

// Real recordings and OpenEB's output for them. The recordings with a suitable licence are in tests/data; tests of
// others are skipped if the file is missing.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/byte_order.h"
#include "core/base/output_file.h"
#include "core/events/events_testing.h"
#include "core/numerics/hash.h"
#include "core/recordings/chunker.h"
#include "core/recordings/event_digest.h"
#include "core/recordings/recording_header.h"
#include "core/recordings/recording_reader.h"
#include "tests/data/test_data.h"

namespace evpose {
namespace {

struct RecordingCase {
  std::string file;
  Encoding encoding;
  SensorGeometry geometry;
};

struct Recording {
  RecordingHeader header;
  std::string text;
  absl::Span<const uint8_t> bytes() const { return AsBytes(text).subspan(header.size_bytes); }
};

Recording Load(const std::string& path) {
  Recording recording;
  recording.text = ReadFile(path, SIZE_MAX).value();
  recording.header = ParseRecordingHeader(recording.text, true).value().value();
  return recording;
}

std::string Sha256OfEvents(absl::Span<const Event> events) {
  EventDigest digest;
  digest.Add(events);
  return digest.FinishHex();
}

class RecordingTest : public testing::TestWithParam<RecordingCase> {
 protected:
  void SetUp() override {
    if (path().empty()) GTEST_SKIP() << GetParam().file << " is not in the test data";
    recording_ = Load(path());
  }
  static std::string path() { return FindTestData(GetParam().file); }

  Decoded Decode(const std::vector<size_t>& cuts) const {
    return DecodeInPieces(recording_.header.encoding, recording_.header.geometry, OutsideSensor::kKeep,
                          recording_.bytes(), cuts);
  }

  Recording recording_;
};

TEST_P(RecordingTest, GivesTheExpectedEvents) {
  EXPECT_EQ(recording_.header.encoding, GetParam().encoding);
  EXPECT_EQ(recording_.header.geometry, GetParam().geometry);
  const auto expected = nlohmann::json::parse(
      ReadFile(std::filesystem::path(path()).parent_path().string() + "/expected.json", SIZE_MAX).value());
  const Decoded decoded = Decode({});
  EXPECT_EQ(decoded.out.events.size(), expected["cd_events"].get<size_t>());
  EXPECT_EQ(decoded.counts.cd_events, expected["cd_events"].get<size_t>());
  EXPECT_EQ(decoded.out.triggers.size(), expected["ext_triggers"].get<size_t>());
  EXPECT_EQ(decoded.counts.triggers, expected["ext_triggers"].get<size_t>());
  EXPECT_EQ(Sha256OfEvents(decoded.out.events),
            expected["sha256_of_packed_t_u64le_x_u16le_y_u16le_p_u8"].get<std::string>());
  EXPECT_EQ(decoded.counts.dropped_events(), 0);
  EXPECT_EQ(decoded.counts.invalid_words(), 0);
  EXPECT_EQ(decoded.counts.clock_wraps, 0);
  EXPECT_EQ(decoded.pending_bytes, 0);
}

TEST_P(RecordingTest, IsTheSameHoweverItIsCut) {
  const Decoded whole = Decode({});
  for (const size_t max_piece : {7u, 100u, 5000u, 300000u}) {
    EXPECT_TRUE(SameDecoded(Decode(RandomCuts(recording_.bytes().size(), max_piece, max_piece)), whole)) << max_piece;
  }
}

TEST_P(RecordingTest, ChunksHaveItsBytesAndItsTime) {
  const auto reader = RecordingReader::Open(path()).value();
  Chunker chunker(*reader, {});
  const auto decoder = MakeEventDecoder(recording_.header.encoding, recording_.header.geometry).value();
  std::vector<uint8_t> bytes;
  DecodedEvents out;
  int64_t t_previous_us = -1;
  while (true) {
    const EventChunkBytes chunk = chunker.Next().value();
    if (chunk.bytes.empty()) break;
    bytes.insert(bytes.end(), chunk.bytes.begin(), chunk.bytes.end());
    out.events.clear();
    decoder->Decode(chunk.bytes, out);
    ASSERT_GE(chunk.t_last_us, t_previous_us);
    if (!out.events.empty()) {
      ASSERT_GE(chunk.t_last_us, out.events.back().t_us);
      ASSERT_LT(chunk.t_last_us, out.events.back().t_us + 4096);
    }
    t_previous_us = chunk.t_last_us;
  }
  EXPECT_EQ(chunker.truncated_bytes(), 0);
  EXPECT_TRUE(absl::MakeConstSpan(bytes) == recording_.bytes());
}

INSTANTIATE_TEST_SUITE_P(
    TestData, RecordingTest,
    testing::Values(RecordingCase{"dat_atis_crop/dat_sample.dat", Encoding::kDat, {1280, 720}},
                    RecordingCase{"evt2_sparklers_gen3/evt2.raw", Encoding::kEvt2, {640, 480}},
                    RecordingCase{"evt3_driving_gen41/evt3_sample.raw", Encoding::kEvt3, {1280, 720}},
                    RecordingCase{"evt3_trigger_vga_640x480/evt3_trigger_vga.raw", Encoding::kEvt3, {640, 480}},
                    RecordingCase{"evt3_trigger_vga_first_200/evt3_trigger_vga.raw", Encoding::kEvt3, {640, 480}},
                    RecordingCase{"evt21_vendor_testbench/tc_001_in.raw", Encoding::kEvt21, {1280, 720}}),
    [](const auto& test) { return test.param.file.substr(0, test.param.file.find('/')); });

class TriggersTest : public testing::TestWithParam<std::pair<std::string, size_t>> {};

TEST_P(TriggersTest, AreThoseOfTheRecord) {
  const auto& [name, count] = GetParam();
  const std::string directory = FindTestData(name);
  if (directory.empty()) GTEST_SKIP() << name << " is not in the test data";
  const Recording recording = Load(directory + "/evt3_trigger_vga.raw");
  const Decoded decoded = DecodeAll(recording.header.encoding, recording.header.geometry, recording.bytes());
  std::vector<Trigger> expected;
  std::istringstream lines(ReadFile(directory + "/triggers_t_id_pol.csv", SIZE_MAX).value());
  for (std::string line; std::getline(lines, line);) {
    std::istringstream fields(line);
    int64_t t_us = 0;
    int id = 0;
    int polarity = 0;
    char comma = 0;
    if (fields >> t_us >> comma >> id >> comma >> polarity) {
      expected.push_back({t_us, static_cast<uint8_t>(id), static_cast<uint8_t>(polarity)});
    }
  }
  EXPECT_EQ(expected.size(), count);
  EXPECT_EQ(decoded.out.triggers, expected);
}

INSTANTIATE_TEST_SUITE_P(TestData, TriggersTest,
                         testing::Values(std::pair{"evt3_trigger_vga_640x480", 4157},
                                         std::pair{"evt3_trigger_vga_first_200", 1611}));

TEST(RecordingsTest, StepsBackOfTimeLowAreCountedAndStampNoEvent) {
  const std::string path = FindTestData("evt3_driving_gen41/evt3_sample.raw");
  if (path.empty()) GTEST_SKIP() << "the recording is not in the test data";
  const Recording recording = Load(path);
  const Decoded decoded = DecodeAll(recording.header.encoding, recording.header.geometry, recording.bytes());
  EXPECT_EQ(decoded.counts.time_backsteps, 9);
  EXPECT_TRUE(std::is_sorted(decoded.out.events.begin(), decoded.out.events.end(),
                             [](const Event& a, const Event& b) { return a.t_us < b.t_us; }));
}

TEST(RecordingsTest, EventsOutsideTheSensorAreDroppedUnlessAskedFor) {
  const std::string path = FindTestData("evt21_vendor_testbench/tc_001_in.raw");
  ASSERT_FALSE(path.empty());
  const Recording recording = Load(path);
  const Decoded dropped = DecodeAll(Encoding::kEvt21, {1280, 720}, recording.bytes());
  const Decoded kept = DecodeInPieces(Encoding::kEvt21, {1280, 720}, OutsideSensor::kKeep, recording.bytes(), {});
  EXPECT_EQ(dropped.counts.dropped_outside_sensor, 4770);
  EXPECT_EQ(kept.counts.kept_outside_sensor, 4770);
  EXPECT_EQ(dropped.counts.cd_events + 4770, kept.counts.cd_events);
  EXPECT_TRUE(std::all_of(dropped.out.events.begin(), dropped.out.events.end(),
                          [](const Event& event) { return event.x < 1280 && event.y < 720; }));
}

// One test for all cases, so that their number can be checked.
TEST(RecordingsTest, GoldenCasesGiveTheEventsOfOpenEbAtEveryCut) {
  const std::string directory = FindTestData("openeb_golden_vectors");
  ASSERT_FALSE(directory.empty());
  const auto golden = nlohmann::json::parse(ReadFile(directory + "/expected.json", SIZE_MAX).value());
  int num_cases = 0;
  for (const auto& [name, expected] : golden["cases"].items()) {
    const std::string path = absl::StrCat(directory, "/", name, ".raw");
    if (!std::filesystem::exists(path)) continue;  // one recorded case has no file
    ++num_cases;
    SCOPED_TRACE(name);
    const Recording recording = Load(path);
    std::vector<Event> events;
    for (const auto& event : expected["events"]) {
      events.push_back(
          {event[0].get<int64_t>(), event[1].get<uint16_t>(), event[2].get<uint16_t>(), event[3].get<uint8_t>()});
    }
    for (const OutsideSensor outside : {OutsideSensor::kDrop, OutsideSensor::kKeep}) {
      const auto decode = [&](const std::vector<size_t>& cuts) {
        return DecodeInPieces(recording.header.encoding, recording.header.geometry, outside, recording.bytes(), cuts);
      };
      const Decoded whole = decode({});
      EXPECT_EQ(absl::MakeConstSpan(whole.out.events), absl::MakeConstSpan(events));
      for (size_t first = 0; first <= recording.bytes().size(); ++first) {
        for (size_t second = first; second <= recording.bytes().size(); ++second) {
          ASSERT_TRUE(SameDecoded(decode({first, second}), whole)) << "cut at " << first << " and " << second;
        }
      }
    }
  }
  EXPECT_EQ(num_cases, 39);
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "client/containers/text_source.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "absl/strings/str_cat.h"
#include "client/containers/containers_testing.h"
#include "client/containers/decimal.h"
#include "core/base/temporary_directory_testing.h"
#include "core/recordings/event_digest.h"
#include "tests/data/test_data.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

TEST(ScaledDecimalTest, RoundsTheDecimalDigits) {
  EXPECT_EQ(ScaledDecimal("51.980788001", 6), 51980788);
  EXPECT_EQ(ScaledDecimal("51.9807885", 6), 51980789);
  EXPECT_EQ(ScaledDecimal("-0.0000015", 6), -2);
  EXPECT_EQ(ScaledDecimal("5.198078700000000225e+01", 6), 51980787);
  EXPECT_EQ(ScaledDecimal("1468939993.067416019", 6), 1468939993067416);
  EXPECT_EQ(ScaledDecimal("9.8e+01", 0), 98);
  EXPECT_EQ(ScaledDecimal("1700000000123456789", -3), 1700000000123457);
  EXPECT_EQ(ScaledDecimal("123456789", -3), 123457);
  EXPECT_EQ(ScaledDecimal(".5", 0), 1);
  EXPECT_EQ(ScaledDecimal("1e-9999999999", 6), 0);
  EXPECT_EQ(ScaledDecimal("0e9999999999", 6), 0);
  for (const char* text : {"", "-", ".", "1e", "1e+", "nan", "1.2.3", "12x", "1e30", "99999999999999999999", " 1"}) {
    EXPECT_EQ(ScaledDecimal(text, 0), std::nullopt) << text;
  }
}

ReadRecording ReadText(const std::string& text, const OpenRecordingOptions& options = {}) {
  const TemporaryDirectory directory;
  const auto recording = ReadAll(WriteBytes(directory.File("events"), text), options);
  EXPECT_TRUE(recording.ok()) << recording.status();
  return recording.value_or(ReadRecording());
}

const std::vector<Event> kThree = {{1500000, 10, 20, 1}, {1500001, 11, 21, 0}, {1500003, 12, 22, 1}};

TEST(TextSourceTest, ColumnsAreFoundByTheirContentOrNames) {
  for (const char* text :
       {"1.5 10 20 1\n1.500001 11 21 0\n1.500003 12 22 1\n", "10,20,1,1500000\n11,21,0,1500001\n12,22,1,1500003\n",
        "1500000 10 20 1\n1500001 11 21 -1\n1500003 12 22 1",
        "10\t20\t1500000\t1\r\n11\t21\t1500001\t0\r\n12\t22\t1500003\t1\r\n",
        "# t x y p\n\n1.500000e+00 1.000000e+01 2.0e1 1\n1.500001 11 21 0\n1.500003 12 22 1\n",
        "timestamp,p,y,x\n1500000,1,20,10\n1500001,0,21,11\n1500003,1,22,12\n",
        "x;y;polarity;t [ns]\n10;20;1;1500000000\n11;21;0;1500001499\n12;22;1;1500002500\n"}) {
    EXPECT_THAT(ReadText(text).events, ::testing::ElementsAreArray(kThree)) << text;
  }
}

TEST(TextSourceTest, TheSizeIsThatOfTheFileOfTheCallerOrOfAKnownSensor) {
  const std::string rows = "10,20,1,1500000\n345,21,0,1500001\n";
  const auto check = [](const ReadRecording& recording, SensorGeometry geometry, bool stated, bool known) {
    EXPECT_EQ(recording.header.geometry, geometry);
    EXPECT_EQ(recording.header.geometry_is_stated, stated);
    EXPECT_EQ(recording.header.geometry_is_known, known);
  };
  check(ReadText("%geometry:640,480\n" + rows), {640, 480}, true, true);
  check(ReadText("640 480\n1.5 10 20 1\n1.6 10 20 1\n"), {640, 480}, true, true);
  check(ReadText(rows, {.geometry = SensorGeometry{400, 300}}), {400, 300}, false, true);
  check(ReadText(rows), {346, 260}, false, false);
}

TEST(TextSourceTest, TimesSince1970AreRelativeToTheFirstEvent) {
  const ReadRecording recording = ReadText("1468939993.067416 10 20 1\n1468939993.067420 11 21 0\n");
  EXPECT_THAT(recording.events, ElementsAre(Event{0, 10, 20, 1}, Event{4, 11, 21, 0}));
  EXPECT_EQ(recording.header.time_offset_us, 1468939993067416);
  EXPECT_EQ(ReadText("%time_offset_us:77\n1,2,0,5\n1,2,0,6\n").header.time_offset_us, 77);
}

TEST(TextSourceTest, DamagedLinesAndImpossibleEventsAreCounted) {
  const ReadRecording recording = ReadText(
      "10,20,1,1500000\n11,21,0,15x\n11,21\n11,21,7,1500001\n" + std::string(5000, '1') +
      "\n11,21,0,1500001\n99999,1,0,1500002\n1,1,0,-5\n1,1,0,99999999999\n12,22,1,1500003\n12,22,1,1500002\n5,5");
  EXPECT_THAT(recording.events, ElementsAre(kThree[0], kThree[1], kThree[2], Event{1500002, 12, 22, 1}));
  EXPECT_EQ(recording.num_skipped("lines that are not events"), 5);
  EXPECT_EQ(recording.num_skipped("events with a row or column below 0 or above 16383"), 1);
  EXPECT_EQ(recording.num_skipped("events before time 0"), 1);
  EXPECT_EQ(recording.num_skipped("events more than 35 minutes from the event before"), 1);
  EXPECT_EQ(recording.counts.time_backsteps, 1);
}

TEST(TextSourceTest, LongLinesAreNoEventsWhereverAReadEnds) {
  const std::string rows = "10,20,1,1500000\n11,21,0,1500001\n12,22,1,1500003\n";
  const std::string long_event = "10,20,1,1500000," + std::string(2000, '1') + "\n";
  const std::string very_long_event = "10,20,1,1500000," + std::string(300'000, '1') + "\n";
  const std::string long_heading = "x,y,p,t" + std::string(2000, ' ') + "\n";
  for (const std::string& text : {rows + long_event, rows + very_long_event, rows + very_long_event + "# end\n",
                                  rows + very_long_event.substr(0, very_long_event.size() - 1)}) {
    const ReadRecording recording = ReadText(text);
    EXPECT_THAT(recording.events, ::testing::ElementsAreArray(kThree));
    EXPECT_EQ(recording.num_skipped("lines that are not events"), 1);
  }
  for (const std::string& text : {absl::StrCat(rows, "# ", long_event), absl::StrCat(rows, "# ", very_long_event),
                                  absl::StrCat("# ", long_event, rows), absl::StrCat(long_heading, rows)}) {
    const ReadRecording recording = ReadText(text);
    EXPECT_THAT(recording.events, ::testing::ElementsAreArray(kThree));
    EXPECT_THAT(recording.skipped, IsEmpty());
  }
}

TEST(TextSourceTest, TheUnitOfTheTimesIsStated) {
  EXPECT_EQ(ReadText("x;y;polarity;t [ns]\n10;20;1;1500000000\n").header.container, "text (x y p t, t in ns)");
  EXPECT_EQ(ReadText("x,y,p,t_ms\n10,20,1,1500\n").header.container, "CSV (x y p t, t in ms)");
  EXPECT_EQ(ReadText("10,20,1,1500\n").header.container, "CSV (x y p t, t in us)");
}

TEST(TextSourceTest, LinesWithNanAreNoEventsAndDoNotChangeTheUnit) {
  const std::string rows = "10,20,1,1500000\n11,21,0,1500001\n12,22,1,1500003\n";
  for (const std::string& text : {"nan,20,1,1500000\n" + rows, "10,20,1,nan\n" + rows, rows + "10,20,1,inf\n",
                                  rows + "10,20,nan,0.5\n", "x,y,p,t\nnan,20,1,0.5\n" + rows}) {
    const ReadRecording recording = ReadText(text);
    EXPECT_THAT(recording.events, ::testing::ElementsAreArray(kThree)) << text;
    EXPECT_EQ(recording.num_skipped("lines that are not events"), 1) << text;
  }
}

TEST(TextSourceTest, NanInAColumnBesideThoseOfTheEventDoesNotChangeTheUnit) {
  const ReadRecording recording = ReadText("t,x,y,p,depth\n1.5,10,20,1,nan\n1.500001,11,21,0,nan\n1.500003,12,22,1,\n");
  EXPECT_THAT(recording.events, ::testing::ElementsAreArray(kThree));
  EXPECT_TRUE(recording.skipped.empty());
}

TEST(TextSourceTest, RowsThatAreNoEventsDoNotChangeTheUnit) {
  const std::string rows = "1500000,10,20,1\n1500001,11,21,0\n1500003,12,22,1\n";
  for (const std::string& text : {"t,x,y,p\n0.5,10,20,7\n" + rows, "t,x,y,p\n0.5,70000,20,1\n" + rows}) {
    const ReadRecording recording = ReadText(text);
    ASSERT_GE(recording.events.size(), 3) << text;
    EXPECT_EQ(recording.events.back(), kThree[2]) << text;
  }
  // As TakeEvent() rounds them, positions with a fraction belong to events.
  EXPECT_THAT(ReadText("t,x,y,p\n1.5,10.3,20.2,1\n1.500001,11.4,20.8,0\n1.500003,11.7,22,1\n").events,
              ::testing::ElementsAreArray(kThree));
}

TEST(TextSourceTest, OtherTextIsNotRecognised) {
  for (const char* text : {"", "hello world\n", "1 2 3\n4 5 6\n", "0.1 0.2 0.3 0.4 0.5 0.6 0.7 1\n", "t,x,y\n1,2,3\n",
                           "1.5 10.5 20 1\n1.6 10.5 20 1\n", "1 2 3 4\n5 6 7 8\n"}) {
    EXPECT_EQ(FindTextLayout(text), std::nullopt) << text;
  }
}

TEST(TextSourceTest, ThePublishedDatasetHasItsDigest) {
  const std::string path = FindTestData("real/formats/uzh_events.txt");
  if (path.empty()) GTEST_SKIP() << "EVPOSE_SHARED_DATA has no real/formats";
  const auto recording = ReadAll(path);
  ASSERT_TRUE(recording.ok()) << recording.status();
  EXPECT_EQ(recording->header.geometry, (SensorGeometry{240, 180}));
  EXPECT_EQ(recording->header.container, "text (t x y p, t in s)");
  EventDigest digest;
  digest.Add(recording->events);
  EXPECT_EQ(digest.FinishHex(), "312e69f61c8360680659eab03232872b41e5cab39a4d370c1da4701e47eae894");
  EXPECT_THAT(recording->skipped, IsEmpty());
}

}  // namespace
}  // namespace evpose::client

// SPDX-License-Identifier: Apache-2.0
#include "client/containers/aedat/aedat_header.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "absl/strings/str_cat.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

// A record of AEDAT 2.0: an address and a time.
const std::string kRecord("\x00\x12\x34\x56\x00\x00\x00\x07", 8);

AedatHeader ParseWhole(const std::string& text) { return ParseAedatHeader(text, true).value().value(); }
std::string ErrorOf(const std::string& text) { return std::string(ParseAedatHeader(text, true).status().message()); }

TEST(AedatHeaderTest, ReadsTheSensorOfAedat2) {
  const std::string header =
      "#!AER-DAT2.0\r\n# This is a raw AE data file\r\n# AEChip: eu.seebetter.ini.chips.davis.DAVIS240C\r\n# End\r\n";
  const AedatHeader parsed = ParseWhole(header + kRecord);
  EXPECT_EQ(parsed.version, AedatVersion::k2);
  EXPECT_EQ(parsed.sensor, "DAVIS240C");
  EXPECT_EQ(parsed.layout, Aedat2Layout::kDavis);
  EXPECT_EQ(parsed.geometry, (SensorGeometry{240, 180}));
  EXPECT_EQ(parsed.size_bytes, header.size());
}

TEST(AedatHeaderTest, KnowsTheSensorsByName) {
  const auto geometry = [](const char* chip) {
    return ParseWhole(absl::StrCat("#!AER-DAT2.0\r\n# AEChip: ", chip, "\r\n", kRecord)).geometry;
  };
  EXPECT_EQ(geometry("ch.unizh.ini.jaer.chip.retina.DVS128"), (SensorGeometry{128, 128}));
  EXPECT_EQ(geometry("eu.seebetter.ini.chips.davis.Davis346blue"), (SensorGeometry{346, 260}));
  EXPECT_EQ(geometry("eu.seebetter.ini.chips.davis.Davis640"), (SensorGeometry{640, 480}));
}

TEST(AedatHeaderTest, Aedat2WithoutASensorHasNoGeometry) {
  const AedatHeader parsed = ParseWhole("#!AER-DAT2.0\r\n" + kRecord);
  EXPECT_EQ(parsed.sensor, "");
  EXPECT_EQ(parsed.layout, Aedat2Layout::kUnknown);
}

// The header of AEDAT 2.0 has no end mark.
TEST(AedatHeaderTest, ARecordThatBeginsWithTheSignOfALineIsNoLine) {
  const std::string header = "#!AER-DAT2.0\r\n# AEChip: x.DAVIS240C\r\n";
  const std::string record("#\x10\x08\x00\x00\x05\x0a\x0a", 8);
  EXPECT_EQ(ParseWhole(header + record + kRecord).size_bytes, header.size());
}

TEST(AedatHeaderTest, ReadsTheSourceOfAedat31) {
  const std::string header =
      "#!AER-DAT3.1\r\n#Format: RAW\r\n#Source 1: DVS128\r\n#-Source 0: DAVIS346\r\n#Start-Time: 2016-11-20\r\n"
      "#!END-HEADER\r\n";
  const AedatHeader parsed = ParseWhole(header + "#not a line\r\n");
  EXPECT_EQ(parsed.version, AedatVersion::k31);
  EXPECT_EQ(parsed.sensor, "DVS128");
  EXPECT_EQ(parsed.geometry, (SensorGeometry{128, 128}));
  EXPECT_EQ(parsed.size_bytes, header.size());
}

TEST(AedatHeaderTest, AnUnknownSourceOfAedat31HasNoGeometry) {
  EXPECT_EQ(ParseWhole("#!AER-DAT3.1\r\n#Source 1: NewCamera\r\n#!END-HEADER\r\n").geometry, SensorGeometry{});
}

TEST(AedatHeaderTest, TheTextOfAedat4IsOneLine) {
  const AedatHeader parsed = ParseWhole("#!AER-DAT4.0\r\n#not a line\r\n");
  EXPECT_EQ(parsed.version, AedatVersion::k4);
  EXPECT_EQ(parsed.size_bytes, 14u);
}

TEST(AedatHeaderTest, APrefixOfAHeaderWaits) {
  const std::string header = "#!AER-DAT2.0\r\n# AEChip: x.DVS128\r\n";
  for (size_t size = 0; size <= header.size(); ++size) {
    EXPECT_FALSE(ParseAedatHeader(header.substr(0, size), false).value().has_value()) << size;
  }
  EXPECT_EQ(ParseAedatHeader(header + kRecord.substr(0, 1), false).value()->size_bytes, header.size());
}

TEST(AedatHeaderTest, ErrorsSayWhatToDo) {
  EXPECT_THAT(ErrorOf("#!AER-DAT3.0\r\n"), HasSubstr("AEDAT version 3.0 cannot be read, only 2.0, 3.1 and 4.0"));
  EXPECT_THAT(ErrorOf("#!AER-DAT3.1\r\n#Format: SERIALIZED\r\n"), HasSubstr("in the format SERIALIZED cannot be read"));
  EXPECT_THAT(ErrorOf("#!AER-DAT3.1\r\n#Format: RAW\r\n"), HasSubstr("is incomplete"));
  EXPECT_THAT(ErrorOf("#!AER-DAT2.0\r\n# AEChip: x.Cochlea\r\n"), HasSubstr("of the sensor Cochlea cannot be read"));
  EXPECT_THAT(ErrorOf("#!AER-DAT2.0\r\n# AEChip: x.DAVIS208\r\n"), HasSubstr("of the sensor DAVIS208 cannot be read"));
  EXPECT_THAT(ErrorOf("# a text\r\n"), HasSubstr("does not begin with #!AER-DAT"));
  EXPECT_THAT(ErrorOf(""), HasSubstr("is incomplete"));
  const std::string endless = "#!AER-DAT2.0\r\n" + std::string(kMaxAedatHeaderBytes, '#');
  EXPECT_THAT(std::string(ParseAedatHeader(endless, false).status().message()),
              HasSubstr("has more than 4194304 bytes"));
}

}  // namespace
}  // namespace evpose::client

// SPDX-License-Identifier: Apache-2.0
#include "core/recordings/recording_header.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "core/events/events_testing.h"

namespace evpose {
namespace {

using testing::HasSubstr;

constexpr SensorGeometry kHd = {1280, 720};
const std::string kData("\x00\x80\x01\x60", 4);

RecordingHeader Parse(const std::string& text) {
  const auto header = ParseRecordingHeader(text + kData, true);
  EXPECT_TRUE(header.ok()) << header.status();
  if (!header.ok()) return {};
  EXPECT_EQ((*header)->size_bytes, text.size());
  EXPECT_EQ((*header)->text, text);
  return **header;
}

std::string ErrorOf(const std::string& text) {
  const auto header = ParseRecordingHeader(text + kData, true);
  EXPECT_EQ(header.status().code(), absl::StatusCode::kInvalidArgument) << text;
  return std::string(header.status().message());
}

TEST(RecordingHeaderTest, FullHeaderOfACamera) {
  const RecordingHeader header = Parse(
      "% camera_integrator_name Prophesee\n% date 2023-03-29 16:37:46\n% evt 3.0\n% format EVT3;height=720;width=1280\n"
      "% generation 4.2\n% geometry 1280x720\n% integrator_name Prophesee\n% plugin_integrator_name Prophesee\n"
      "% plugin_name hal_plugin_imx636_evk4\n% sensor_generation 4.2\n% serial_number 00050423\n% system_ID 49\n"
      "% end\n");
  EXPECT_EQ(header.encoding, Encoding::kEvt3);
  EXPECT_EQ(header.geometry, kHd);
  EXPECT_TRUE(header.geometry_is_stated);
}

TEST(RecordingHeaderTest, TheFormatLineSuffices) {
  const RecordingHeader header = Parse("% format EVT2;width=346;height=260\n");
  EXPECT_EQ(header.encoding, Encoding::kEvt2);
  EXPECT_EQ(header.geometry, (SensorGeometry{346, 260}));
  EXPECT_TRUE(header.geometry_is_stated);
}

TEST(RecordingHeaderTest, EncodingsByName) {
  EXPECT_EQ(Parse("% evt 3.0\n% end\n").encoding, Encoding::kEvt3);
  EXPECT_EQ(Parse("% evt 2.1\n").encoding, Encoding::kEvt21);
  EXPECT_EQ(Parse("% evt 2.0\n").encoding, Encoding::kEvt2);
  EXPECT_EQ(Parse("% format EVT21\n").encoding, Encoding::kEvt21);
  EXPECT_EQ(Parse("% format EVT21;endianness=little\n% endianness little\n% evt 2.1\n").encoding, Encoding::kEvt21);
  EXPECT_EQ(Parse("% format FLAT64;height=10;width=20\n% end\n").encoding, Encoding::kFlat64);
}

TEST(RecordingHeaderTest, GeometryIsKnownWhenStatedOrOfANamedSensor) {
  EXPECT_TRUE(Parse("% evt 3.0\n% geometry 640x480\n").geometry_is_known);
  EXPECT_TRUE(Parse("% evt 3.0\n% plugin_name hal_plugin_gen41_evk3\n").geometry_is_known);
  EXPECT_FALSE(Parse("% evt 3.0\n").geometry_is_known);
}

TEST(RecordingHeaderTest, CarriageReturnsAndTrailingSpaces) {
  const RecordingHeader header = Parse("% evt 3.0\r\n%\r\n% geometry 640x480  \r\n% end\r\n");
  EXPECT_EQ(header.geometry, kVga);
}

TEST(RecordingHeaderTest, GeometryOfTheSensorWhenNoneIsStated) {
  const auto geometry = [](const std::string& line) {
    const RecordingHeader header = Parse("% evt 3.0\n" + line);
    EXPECT_FALSE(header.geometry_is_stated);
    return header.geometry;
  };
  EXPECT_EQ(geometry("% plugin_name hal_plugin_gen41_evk3\n"), kHd);
  EXPECT_EQ(geometry("% plugin_name hal_plugin_imx636_evk4\n"), kHd);
  EXPECT_EQ(geometry("% plugin_name hal_plugin_gen3_fx3\n"), kVga);
  EXPECT_EQ(geometry("% plugin_name hal_plugin_gen31_evk3\n"), kVga);
  EXPECT_EQ(geometry("% plugin_name hal_plugin_genx320\n"), (SensorGeometry{320, 320}));
  EXPECT_EQ(geometry("% sensor_name GenX320\n"), (SensorGeometry{320, 320}));
  EXPECT_EQ(geometry("% sensor_name IMX647\n"), (SensorGeometry{640, 512}));
  EXPECT_EQ(geometry("% sensor_name Gen3.1\n"), kVga);
  EXPECT_EQ(geometry("% sensor_generation 4.2\n"), kHd);
  EXPECT_EQ(geometry("% generation 3.1\n"), kVga);
  EXPECT_EQ(geometry("% system_ID 49\n"), kHd);
  EXPECT_EQ(geometry("% system_ID 21\n"), kVga);
  EXPECT_EQ(geometry("% system_ID 151\n"), kVga);
  EXPECT_EQ(geometry("% plugin_name hal_plugin_prophesee\n% system_ID 64\n"), (SensorGeometry{320, 320}));
  // An unknown sensor: the largest size.
  EXPECT_EQ(geometry("% plugin_name of_somebody_else\n% system_ID none\n"), kHd);
  EXPECT_EQ(Parse("% format FLAT64\n").geometry, (SensorGeometry{2048, 2048}));
}

TEST(RecordingHeaderTest, StatedGeometryTakesPrecedenceOverTheSensor) {
  EXPECT_EQ(Parse("% evt 3.0\n% plugin_name hal_plugin_gen41_evk3\n% geometry 640x360\n").geometry,
            (SensorGeometry{640, 360}));
}

TEST(RecordingHeaderTest, EqualOrUnknownStatementsMayBeRepeated) {
  const RecordingHeader header = Parse(
      "% evt 2.1\n% endianness little\n% time_offset_us -7\n% time_offset_us -7\n% endianness little\n"
      "% plugin_name hal_plugin_gen41_evk3\n% plugin_name of_somebody_else\n% plugin_name hal_plugin_imx636_evk4\n");
  EXPECT_EQ(header.time_offset_us, -7);
  EXPECT_EQ(header.geometry, kHd);
  EXPECT_TRUE(header.geometry_is_known);
}

TEST(RecordingHeaderTest, DataThatBeginsLikeAHeaderLineIsData) {
  // An EVT2 word whose first byte is '%', without "% end" before it.
  const std::string text = "% evt 2.0\n% geometry 640x480\n";
  for (const std::string& data :
       {std::string("%\x01\x02\x03", 4), std::string("% \x02\n", 4), std::string("%a\n", 3)}) {
    const auto header = ParseRecordingHeader(text + data, true);
    ASSERT_TRUE(header.ok());
    EXPECT_EQ((*header)->size_bytes, text.size());
  }
  // After "% end" even a complete line belongs to the data.
  const auto header = ParseRecordingHeader("% evt 2.0\n% end\n% evt 3.0\n", true);
  ASSERT_TRUE(header.ok());
  EXPECT_EQ((*header)->size_bytes, 16);
}

std::string Dat(const std::string& lines) { return "% Data file containing Event2D events.\n" + lines; }

TEST(RecordingHeaderTest, DatHeaders) {
  const auto parse = [](const std::string& text, const std::string& binary) {
    return ParseRecordingHeader(text + binary + "12345678", true);
  };
  const std::string stated = Dat("% Version 2\n% Date 2020-01-01 00:00:00\n% Height 240\n% Width 304\n");
  for (const std::string& binary : {std::string("\x00\x08", 2), std::string("\x0c\x08", 2)}) {
    const auto header = parse(stated, binary);
    ASSERT_TRUE(header.ok()) << header.status();
    EXPECT_EQ((*header)->encoding, Encoding::kDat);
    EXPECT_EQ((*header)->geometry, (SensorGeometry{304, 240}));
    EXPECT_TRUE((*header)->geometry_is_stated);
    EXPECT_EQ((*header)->size_bytes, stated.size() + 2);
    EXPECT_EQ((*header)->text, stated);
  }
  const auto unstated = parse(Dat("% Version 2\n"), std::string("\x00\x08", 2));
  ASSERT_TRUE(unstated.ok());
  EXPECT_EQ((*unstated)->geometry, kHd);
  EXPECT_FALSE((*unstated)->geometry_is_stated);
  EXPECT_FALSE((*unstated)->geometry_is_known);
  EXPECT_THAT(parse(stated, std::string("\x0e\x08", 2)).status().message(), HasSubstr("events of type 14 and 8 bytes"));
  EXPECT_THAT(parse(stated, std::string("\x00\x10", 2)).status().message(), HasSubstr("events of type 0 and 16 bytes"));
  EXPECT_THAT(ErrorOf(Dat("% Version 1\n")), HasSubstr("header line 2: version 1 of DAT is not supported"));
  EXPECT_THAT(ParseRecordingHeader(stated, true).status().message(), HasSubstr("the two bytes that end a DAT header"));
  EXPECT_FALSE(ParseRecordingHeader(stated + std::string(1, '\0'), false).value().has_value());
}

TEST(RecordingHeaderTest, ErrorsNameTheLine) {
  struct Case {
    std::string text;
    std::string message;
  };
  const std::vector<Case> cases = {
      {"% evt 3.0\n% format EVT2;height=480;width=640\n", "header line 2: says EVT2, but line 1 says EVT3"},
      {"% evt 3.0\n% date x\n% evt 2.1\n", "header line 3: says EVT2.1, but line 1 says EVT3"},
      {"% evt 2.0\n% Data file containing CD events.\n", "header line 2: says DAT, but line 1 says EVT2"},
      {"% evt 3.0\n% geometry 640x480\n% geometry 1280x480\n", "header line 3: says width 1280, but line 2 says 640"},
      {"% format EVT3;height=720;width=1280\n% geometry 1280x800\n",
       "header line 2: says height 800, but line 1 says 720"},
      {"% evt 3.0\n% geometry 1280\n", "header line 2: the geometry '1280' cannot be read"},
      {"% evt 3.0\n% geometry 12a0x720\n", "header line 2: the width '12a0' is not a positive number of pixels"},
      {"% evt 3.0\n% geometry 0x720\n", "header line 2: the width '0' is not a positive number"},
      {"% evt 3.0\n% geometry 1280x-720\n", "header line 2: the height '-720' is not a positive number"},
      {"% evt 3.0\n% geometry 1280x99999999999999999999\n", "header line 2: the height '99999999999999999999' is not"},
      {"% evt 3.0\n% geometry 4096x720\n", "header line 2: the sensor has 4096x720 pixels; EVT3 addresses 1x1 to"},
      {"% format EVT3;height=;width=1280\n", "header line 1: the height '' is not a positive number"},
      {"% evt 3.0\n% Width 640\n", "header line 2: a width, but no line gives a height"},
      {"% format EVT3;height=720\n", "header line 1: a height, but no line gives a width"},
      {"% evt 4.0\n", "header line 1: EVT 4.0 is not supported"},
      {"% evt\n", "header line 1: EVT  is not supported"},
      {"% date x\n% format HISTO3D;height=320;width=320\n", "header line 2: the format 'HISTO3D' is not supported"},
      {"% evt 2.1\n% endianness legacy\n", "header line 2: EVT2.1 words in the order 'legacy' are not supported"},
      {"% evt 2.1\n% endianness legacy\n% endianness little\n",
       "header line 3: says the order of bytes little, but line 2 says legacy"},
      {"% format EVT21;endianness=big\n% endianness little\n",
       "header line 2: says the order of bytes little, but line 1 says big"},
      {Dat("% Version 1\n% Version 2\n"), "header line 3: says version 2, but line 2 says 1"},
      {"% evt 3.0\n% time_offset_us 5\n% time_offset_us 6\n",
       "header line 3: says the time offset 6, but line 2 says 5"},
      {"% evt 3.0\n% time_offset_us x\n", "header line 2: the time offset 'x' is not a number of microseconds"},
      {"% evt 3.0\n% time_offset_us 9223372036854775807\n", "header line 2: the time offset '9223372036854775807'"},
      {"% evt 3.0\n% time_offset_us -1152921504606846977\n",
       "is not a number of microseconds within 1152921504606846976"},
      {"% evt 3.0\n% plugin_name hal_plugin_gen31_fx3\n% plugin_name hal_plugin_gen41_evk3\n",
       "header line 3: says a sensor of 1280x720, but line 2 says 640x480"},
      {"% evt 3.0\n% sensor_name IMX647\n% sensor_name Gen3.1\n",
       "header line 3: says a sensor of 640x480, but line 2 says 640x512"},
      {"% format\n", "header line 1: the format '' is not supported"},
      {"% format EVT21;endianness=legacy\n", "header line 1: EVT2.1 words in the order 'legacy'"},
      {"% date x\n% geometry 640x480\n", "the header names no format"},
      {"", "there is no header"},
      {"no header\n", "there is no header"},
  };
  for (const Case& wrong : cases) EXPECT_THAT(ErrorOf(wrong.text), HasSubstr(wrong.message)) << wrong.text;
  for (const char* key : {"evt", "format", "geometry", "format EVT3;height=1;width="}) {
    EXPECT_LT(ErrorOf("% " + std::string(key) + " " + std::string(5000, 'x') + "\n").size(), 300u) << key;
  }
}

TEST(RecordingHeaderTest, WaitsForMoreOfAPrefix) {
  const std::string text = "% evt 3.0\n% geometry 640x480\n";
  for (size_t size = 0; size <= text.size(); ++size) {
    const auto header = ParseRecordingHeader(text.substr(0, size), false);
    ASSERT_TRUE(header.ok()) << header.status();
    EXPECT_FALSE(header->has_value()) << size;
  }
  EXPECT_TRUE(ParseRecordingHeader(text + kData[0], false).value().has_value());
  EXPECT_TRUE(ParseRecordingHeader(text + "% end\n", false).value().has_value());
  // A file that ends within its header.
  const auto cut = ParseRecordingHeader("% evt 3.0\n% geome", true);
  ASSERT_TRUE(cut.ok());
  EXPECT_EQ((*cut)->size_bytes, 17);
}

TEST(RecordingHeaderTest, HostileHeadersAreBounded) {
  const std::string message = "the header is longer than 65536 bytes";
  std::string lines = "% evt 3.0\n";
  while (lines.size() < 70000) lines += "% x\n";
  EXPECT_THAT(ParseRecordingHeader(lines, false).status().message(), HasSubstr(message));
  EXPECT_THAT(ParseRecordingHeader("% " + std::string(70000, 'a'), false).status().message(), HasSubstr(message));
  EXPECT_THAT(ParseRecordingHeader("% evt 3.0\n% " + std::string(70000, 'a') + "\n", true).status().message(),
              HasSubstr(message));
}

TEST(RecordingHeaderTest, OwnHeadersReadBack) {
  for (const Encoding encoding : {Encoding::kEvt3, Encoding::kEvt21, Encoding::kEvt2, Encoding::kFlat64}) {
    const RecordingHeader header = Parse(MakeRawHeader(encoding, kHd));
    EXPECT_EQ(header.encoding, encoding);
    EXPECT_EQ(header.geometry, kHd);
    EXPECT_TRUE(header.geometry_is_stated);
  }
  EXPECT_EQ(MakeRawHeader(Encoding::kEvt3, kHd),
            "% evt 3.0\n% format EVT3;height=720;width=1280\n% geometry 1280x720\n% end\n");
}

}  // namespace
}  // namespace evpose

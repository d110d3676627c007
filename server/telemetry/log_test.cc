// SPDX-License-Identifier: Apache-2.0
#include "server/telemetry/log.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "server/runtime/errors.h"
#include "server/telemetry/log_testing.h"
#include "server/telemetry/session_log.h"

namespace evpose::server {
namespace {

using testing::HasSubstr;

// Difficult names of objects, models and peers that a client may choose.
const std::string kHostile[] = {
    "",
    "two words",
    "quote \" and backslash \\",
    "a line\nerror forged=\"1\"\r\n",
    "\x1b[31mred\x1b[0m \x7f \t \b",
    std::string("zero \0 byte", 11),
    "a=b",
    "\xc3\xa9 \xe2\x80\xa8 \xf0\x9f\x93\xb7",  // e acute, line separator, a camera
};

bool IsOneLineOfAscii(const std::string& line) {
  return std::all_of(line.begin(), line.end(), [](char c) { return c >= ' ' && c <= '~'; });
}

std::string JsonLine(const char* event, const std::vector<LogField>& fields) {
  return absl::StrCat("{", LogText(LogFormat::kJson, event, fields), "}");
}

TEST(LogTest, JsonPreservesValues) {
  for (const std::string& text : kHostile) {
    const std::string line = JsonLine("event_name", {{"text", text}, {"number", -7}});
    EXPECT_TRUE(IsOneLineOfAscii(line)) << line;
    const auto json = nlohmann::json::parse(line);
    EXPECT_EQ(json, nlohmann::json({{"event", "event_name"}, {"text", text}, {"number", -7}})) << line;
  }
}

TEST(LogTest, NumbersAndFlagsAreNoStrings) {
  const std::string line = JsonLine("e", {{"most", UINT64_MAX}, {"least", INT64_MIN}, {"yes", true}, {"no", false}});
  const auto json = nlohmann::json::parse(line);
  EXPECT_EQ(json["most"].get<uint64_t>(), UINT64_MAX);
  EXPECT_EQ(json["least"].get<int64_t>(), INT64_MIN);
  EXPECT_EQ(json["yes"], true);
  EXPECT_EQ(json["no"], false);
}

TEST(LogTest, BytesThatAreNoTextDoNotBreakTheLine) {
  const std::string line = JsonLine("e", {{"text", "\xff\xfe half \xe2\x80"}});
  EXPECT_TRUE(IsOneLineOfAscii(line));
  EXPECT_THAT(nlohmann::json::parse(line)["text"].get<std::string>(), HasSubstr(" half "));
}

TEST(LogTest, TextQuotesSpecialValues) {
  EXPECT_EQ(LogText(LogFormat::kText, "e", {{"a", "sessions/1"}, {"b", 5}, {"c", "ipv4:127.0.0.1:9"}}),
            "e a=sessions/1 b=5 c=ipv4:127.0.0.1:9");
  EXPECT_EQ(LogText(LogFormat::kText, "e", {{"a", ""}, {"b", "x y"}, {"c", "x\ny"}, {"d", "x=\"y\""}}),
            R"(e a="" b="x y" c="x\ny" d="x=\"y\"")");
  for (const std::string& text : kHostile) {
    EXPECT_TRUE(IsOneLineOfAscii(LogText(LogFormat::kText, "e", {{"text", text}})));
  }
}

TEST(LogTest, LongValuesAreCut) {
  for (const LogFormat format : {LogFormat::kText, LogFormat::kJson}) {
    const std::string line = LogText(format, "e", {{"text", std::string(1'000'000, 'x')}});
    EXPECT_LT(line.size(), 3000u);
    EXPECT_THAT(line, HasSubstr("x...\""));
  }
}

TEST(LogTest, NamesOfLevelsAndFormats) {
  for (const LogLevel level :
       {LogLevel::kDebug, LogLevel::kInfo, LogLevel::kWarning, LogLevel::kError, LogLevel::kOff}) {
    EXPECT_EQ(ParseLogLevel(LogLevelName(level)), level);
  }
  EXPECT_EQ(ParseLogLevel("loud"), std::nullopt);
  EXPECT_EQ(ParseLogFormat("json"), LogFormat::kJson);
  EXPECT_EQ(ParseLogFormat("text"), LogFormat::kText);
  EXPECT_EQ(ParseLogFormat("xml"), std::nullopt);
}

TEST(LogTest, LinesBelowTheLevelAreNotWritten) {
  captured_log.Take();
  SetLogLevel(LogLevel::kWarning);
  EXPECT_EQ(CurrentLogLevel(), LogLevel::kWarning);
  Log(LogLevel::kInfo, "quiet", {});
  Log(LogLevel::kError, "loud", {});
  SetLogLevel(LogLevel::kOff);
  Log(LogLevel::kError, "silent", {});
  SetLogLevel(LogLevel::kDebug);
  EXPECT_EQ(captured_log.Take(), "error loud\n");
}

TEST(SessionLogTest, EachLineNamesSessionTenantAndPeer) {
  captured_log.Take();
  SessionLog log("sessions/1", "lab");
  log.Created("peer:1", {});
  EXPECT_THAT(captured_log.Take(), HasSubstr("info session_created session=sessions/1 tenant=lab peer=peer:1 "));
  log.Attached("peer:2", 1, 1, false);
  log.Attached("peer:2", 2, 5, false);
  log.Attached("peer:3", 3, 7, true);
  EXPECT_EQ(captured_log.Take(),
            "info session_attached session=sessions/1 tenant=lab peer=peer:2 stream=1 next_chunk=1\n"
            "info session_reattached session=sessions/1 tenant=lab peer=peer:2 stream=2 next_chunk=5\n"
            "info session_taken_over session=sessions/1 tenant=lab peer=peer:3 stream=3 next_chunk=7\n");
  log.StreamEnded("peer:2", 2, WithReason(absl::AbortedError("another stream"), v1::FENCED));
  EXPECT_EQ(captured_log.Take(),
            "info stream_ended session=sessions/1 tenant=lab peer=peer:2 stream=2 code=ABORTED reason=FENCED "
            "message=\"another stream\"\n");
  log.Drained(7, false);
  EXPECT_EQ(captured_log.Take(),
            "warning session_drained session=sessions/1 tenant=lab peer=peer:3 poses=7 durable=false\n");
}

TEST(SessionLogTest, PhaseTransitionsAreLoggedAtLevelDebugOnly) {
  const SessionLog log("sessions/1", "lab");
  const PhaseTransition object = {0, 1'200, ObjectTransition{ObjectPhase::kVerifying, ObjectPhase::kPublished}};
  const PhaseTransition track = {0, 1'300, TrackTransition{TrackPhase::kConfirmed, TrackPhase::kCoasting}};
  captured_log.Take();
  SetLogLevel(LogLevel::kInfo);
  log.PhaseChanged("cube", object);
  EXPECT_EQ(captured_log.Take(), "");
  SetLogLevel(LogLevel::kDebug);
  log.PhaseChanged("cube", object);
  log.PhaseChanged("cube", track);
  EXPECT_EQ(captured_log.Take(),
            "debug object_phase session=sessions/1 tenant=lab peer=\"\" object=cube from=VERIFYING to=PUBLISHED "
            "sensor_time_us=1200\n"
            "debug track_phase session=sessions/1 tenant=lab peer=\"\" object=cube from=CONFIRMED to=COASTING "
            "sensor_time_us=1300\n");
}

}  // namespace
}  // namespace evpose::server

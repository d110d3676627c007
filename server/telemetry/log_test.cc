// SPDX-License-Identifier: Apache-2.0
#include "server/telemetry/log.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "core/base/trace_context.h"
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

// The fields that every line of the session has, with the span if there is one.
std::string Place(const std::string& peer, const std::string& span_id) {
  return absl::StrCat(" session=sessions/1 tenant=lab peer=", peer, " trace_id=", TraceIdOf("sessions/1"),
                      span_id.empty() ? "" : " span_id=", span_id);
}

TEST(SessionLogTest, EachLineNamesSessionTenantPeerAndTrace) {
  captured_log.Take();
  SessionLog log("sessions/1", "lab");
  log.Created("peer:1", {});
  EXPECT_THAT(captured_log.Take(), HasSubstr("info session_created" + Place("peer:1", "") + " encoding="));
  log.Attached({"peer:2", "a1", ""}, 1, 1, false);
  log.Attached({"peer:2", "b2", "0af7"}, 2, 5, false);
  log.Attached({"peer:3", "c3", ""}, 3, 7, true);
  EXPECT_EQ(captured_log.Take(),
            absl::StrCat("info session_attached", Place("peer:2", "a1"), " stream=1 next_chunk=1\n",
                         "info session_reattached", Place("peer:2", "b2"),
                         " stream=2 next_chunk=5 client_trace_id=0af7\n",  //
                         "info session_taken_over", Place("peer:3", "c3"), " stream=3 next_chunk=7\n"));
  log.StreamEnded({"peer:2", "b2", ""}, 2, WithReason(absl::AbortedError("another stream"), v1::FENCED));
  EXPECT_EQ(captured_log.Take(), absl::StrCat("info stream_ended", Place("peer:2", "b2"),
                                              " stream=2 code=ABORTED reason=FENCED message=\"another stream\"\n"));
  log.Drained(7, false);
  EXPECT_EQ(captured_log.Take(),
            absl::StrCat("warning session_drained", Place("peer:3", "c3"), " poses=7 durable=false\n"));
}

// A client can attach and detach in a loop.
TEST(SessionLogTest, LinesOfATenantAreLimited) {
  captured_log.Take();
  const auto limiter = std::make_shared<LogLimiter>(
      LogLimiter::Options{.lines_per_s = 1.0, .burst_lines = 2.0, .now = [] { return absl::UnixEpoch(); }});
  const auto num_lines = [](absl::string_view text) { return std::count(text.begin(), text.end(), '\n'); };
  SessionLog first("sessions/1", "lab", limiter), second("sessions/2", "lab", limiter),
      other("sessions/3", "a", limiter);
  for (int i = 0; i < 10; ++i) {
    first.ObjectLost("cube", i);
    second.ObjectLost("cube", i);
  }
  EXPECT_EQ(num_lines(captured_log.Take()), 2);
  other.ObjectLost("cube", 1);
  EXPECT_EQ(num_lines(captured_log.Take()), 1) << "another tenant";
  first.ObjectFound("cube", 1, true);
  EXPECT_EQ(num_lines(captured_log.Take()), 1) << "another event";
  for (int i = 0; i < 10; ++i) first.NotResumed(absl::InternalError("bad"));
  EXPECT_EQ(num_lines(captured_log.Take()), 10) << "errors are not limited";
}

TEST(SessionLogTest, ALineCountsTheSuppressedOnes) {
  absl::Time now = absl::UnixEpoch();
  const auto limiter = std::make_shared<LogLimiter>(
      LogLimiter::Options{.lines_per_s = 1.0, .burst_lines = 1.0, .now = [&now] { return now; }});
  const SessionLog log("sessions/1", "lab", limiter);
  for (int i = 0; i < 4; ++i) log.ObjectLost("cube", i);
  EXPECT_THAT(captured_log.Take(), testing::Not(HasSubstr("suppressed")));
  now += absl::Seconds(1);
  log.ObjectLost("cube", 9);
  EXPECT_THAT(captured_log.Take(), HasSubstr("sensor_time_us=9 suppressed=3\n"));
}

// The store's lines are those of the stream that attached last.
TEST(SessionLogTest, LinesAboutTheStoreNameTheStream) {
  captured_log.Take();
  SessionLog log("sessions/1", "lab");
  log.Attached({"peer:1", "a1", ""}, 1, 1, false);
  captured_log.Take();
  const std::string place = Place("peer:1", "a1");
  log.CommitSlow(absl::Milliseconds(1500), 77);
  EXPECT_EQ(captured_log.Take(), "warning session_commit_slow" + place + " duration_us=1500000 bytes=77\n");
  log.CommitFailed(WithReason(absl::AbortedError("taken"), v1::FENCED));
  EXPECT_EQ(captured_log.Take(), "info session_commit_failed" + place + " code=ABORTED reason=FENCED message=taken\n");
  log.CommitFailed(WithReason(absl::InternalError("bad page"), v1::STORE_FAILED));
  EXPECT_THAT(captured_log.Take(), HasSubstr("error session_commit_failed" + place));
  log.StoreUnavailable(absl::UnavailableError("unreachable"));
  log.StoreBack();
  EXPECT_EQ(captured_log.Take(), "warning session_waits_for_store" + place +
                                     " code=UNAVAILABLE reason=\"\" message=unreachable\ninfo session_store_back" +
                                     place + "\n");
}

TEST(SessionLogTest, OneLineHasTheSumsOfTheSession) {
  captured_log.Take();
  const SessionLog log("sessions/1", "lab");
  SessionSums sums;
  SessionHealth& health = sums.health;
  sums.lifetime = absl::Seconds(90);
  health.poses = 1;
  health.counts = {.cd_events = 2, .dropped_before_time = 1, .dropped_outside_sensor = 2, .unknown_words = 3};
  health.counts.broken_vectors = 1;
  health.skipped_events = 5;
  health.skipped_us = 6;
  health.received_bytes = 8;
  health.processed_bytes = 7;
  health.sensor_time_us = 9;
  health.processing_us = 10;
  health.latency_p50_us = 11;
  health.latency_p99_us = 12;
  health.objects.resize(2);
  health.objects[0].losses = 6;
  health.objects[1].losses = 7;
  health.reattaches = 14;
  const std::string fields =
      " lifetime_us=90000000 objects=2 poses=1 events=2 dropped_events=3 invalid_words=4 skipped_events=5 skipped_us=6 "
      "received_bytes=8 bytes=7 sensor_time_us=9 processing_us=10 latency_p50_us=11 latency_p99_us=12 losses=13 "
      "reattaches=14\n";
  const std::string place = Place("\"\"", "");
  log.Ended(sums);
  EXPECT_EQ(captured_log.Take(), "info session_ended" + place + " cause=end_of_input" + fields);
  log.Expired(sums);
  EXPECT_EQ(captured_log.Take(), "info session_expired" + place + " cause=expired" + fields);
  log.Deleted("peer:9", "request", sums);
  EXPECT_EQ(captured_log.Take(), "info session_deleted" + Place("peer:9", "") + " why=request cause=deleted" + fields);
  log.Orphaned(sums);
  EXPECT_EQ(captured_log.Take(),
            "info session_deleted" + place + " why=\"no server has it, and it has expired\" cause=expired" + fields);
  log.RolledBack({"peer:9", "a1", ""}, absl::DataLossError("lost"), sums);
  EXPECT_EQ(captured_log.Take(), "error session_rolled_back" + Place("peer:9", "a1") +
                                     " code=DATA_LOSS reason=\"\" message=lost cause=rolled_back" + fields);
  sums.was_reported = true;
  log.Expired(sums);
  log.Deleted("peer:9", "request", sums);
  EXPECT_EQ(captured_log.Take(),
            "info session_expired" + place + "\ninfo session_deleted" + Place("peer:9", "") + " why=request\n");
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
            absl::StrCat("debug object_phase", Place("\"\"", ""), " object=cube from=VERIFYING to=PUBLISHED ",
                         "sensor_time_us=1200\n", "debug track_phase", Place("\"\"", ""),
                         " object=cube from=CONFIRMED to=COASTING sensor_time_us=1300\n"));
}

}  // namespace
}  // namespace evpose::server

// SPDX-License-Identifier: Apache-2.0

// Tests the log events of a session.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_split.h"
#include "core/base/trace_context.h"
#include "server/rpc/server_testing.h"
#include "server/telemetry/log_testing.h"

namespace evpose::server {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using Kind = v1::TrackResponse;

// The first event makes FakeTracker lose its objects; the others complete the slice.
std::vector<Event> LosingEvents() { return {{4000, 0, 0, 1}, {5000, 3, 4, 1}, {6000, 3, 4, 1}}; }

class SessionLogOfServerTest : public RpcTest {
 protected:
  SessionLogOfServerTest() { captured_log.Take(); }

  // The lines of a session, without the fields that all lines have.
  static std::vector<std::string> LinesOf(const std::string& session) {
    const std::string place = " session=" + session + " tenant=\"\" peer=";
    std::vector<std::string> lines;
    for (const absl::string_view line : absl::StrSplit(captured_log.Take(), '\n', absl::SkipEmpty())) {
      if (!absl::StrContains(line, session)) continue;
      EXPECT_TRUE(absl::StrContains(line, place)) << line;
      lines.emplace_back(line);
    }
    return lines;
  }
};

TEST_F(SessionLogOfServerTest, LogsASessionFromCreationToDeletion) {
  const CreatedSession session = CreateSession();
  v1::TrackResponse::Attached first, second;
  const auto track = Attached(session, &first);
  const CreatedSession with_first_token = [&] {
    CreatedSession copy = session;
    copy.set_resume_token(first.resume_token());
    return copy;
  }();
  const auto later = Attached(with_first_token, &second);
  EXPECT_EQ(Describe(track->Finish()), "ABORTED FENCED");
  later->Events(1, Flat64(SomeEvents(1, 3)));
  later->Events(2, Flat64(LosingEvents()));
  v1::TrackRequest reset;
  reset.mutable_reset_pose()->set_seq(3);
  reset.mutable_reset_pose()->set_object_id("cube");
  reset.mutable_reset_pose()->mutable_camera_from_object()->mutable_rotation()->set_w(1.0);
  reset.mutable_reset_pose()->mutable_camera_from_object()->mutable_translation_m();
  later->Write(reset);
  later->Events(4, Flat64(SomeEvents(8, 12)));
  later->End();
  EXPECT_EQ(Describe(later->Finish()), "OK");
  RawTrack wrong(*sessions_);
  wrong.Attach(session.name(), "guess");
  EXPECT_EQ(Describe(wrong.Finish()), "PERMISSION_DENIED WRONG_TOKEN");
  EXPECT_EQ(Describe(Delete(session.name())), "OK");
  server_.reset();  // the server may log the end of a stream after the client has seen it
  std::vector<std::string> events;
  for (const std::string& line : LinesOf(session.name())) {
    const std::vector<std::string> words = absl::StrSplit(line, ' ');
    events.push_back(words[1]);
    if (words[1] == "session_ended") {
      EXPECT_THAT(line, testing::ContainsRegex(" cause=end_of_input lifetime_us=[0-9]+ objects=1 poses=[1-9].* "
                                               "events=[1-9][0-9]* .* bytes=[1-9][0-9]* .* losses=1 reattaches=1$"));
    } else {
      EXPECT_THAT(line, testing::Not(HasSubstr(" cause="))) << "the sums of a session are written once";
    }
  }
  EXPECT_THAT(events,
              testing::IsSupersetOf({"session_created", "session_attached", "session_taken_over", "object_lost",
                                     "object_found_again", "session_ended", "attach_refused", "session_deleted"}));
  EXPECT_EQ(std::count(events.begin(), events.end(), "stream_ended"), 2);
}

TEST_F(SessionLogOfServerTest, LogsTheEndOfStreamsAndDrain) {
  const CreatedSession session = CreateSession();
  {
    const auto track = Attached(session);
    track->Cancel();
    EXPECT_EQ(Describe(track->Finish()), "CANCELLED");
  }
  server_->Shutdown(absl::Seconds(10));
  std::vector<std::string> lines = LinesOf(session.name());
  EXPECT_THAT(lines, testing::Contains(AllOf(HasSubstr("debug stream_phase "), HasSubstr(" from=CONFIRMING to=OPEN"))));
  std::erase_if(lines, [](const std::string& line) { return absl::StartsWith(line, "debug "); });
  EXPECT_THAT(lines, testing::Contains(AllOf(HasSubstr("info stream_ended "), HasSubstr(" code=CANCELLED "))));
  EXPECT_THAT(lines.back(), AllOf(HasSubstr("info session_drained "), HasSubstr(" durable=true")));
}

TEST_F(SessionLogOfServerTest, EachLineNamesTheTraceAndTheStream) {
  const CreatedSession session = CreateSession();
  const std::string trace_id = TraceIdOf(session.name()), span_id = "b7ad6b7169203331";
  {
    RawTrack track(*sessions_, {Traceparent({trace_id, span_id})});
    track.Attach(session.name(), session.resume_token());
    v1::TrackResponse response;
    ASSERT_TRUE(track.ReadUntil(Kind::kAttached, response));
    track.Events(1, Flat64(SomeEvents(1, 3)));
    track.Events(2, Flat64(LosingEvents()));
    track.End();
    EXPECT_EQ(Describe(track.Finish()), "OK");
  }
  EXPECT_EQ(Describe(Delete(session.name())), "OK");
  server_.reset();
  bool has_attached = false;
  std::set<std::string> events;
  for (const std::string& line : LinesOf(session.name())) {
    has_attached = has_attached || absl::StrContains(line, " session_attached ");
    const std::vector<std::string> words = absl::StrSplit(line, ' ');
    events.insert(words[1]);
    EXPECT_THAT(line, HasSubstr(" trace_id=" + trace_id));
    const bool has_stream = has_attached && words[1] != "session_state";
    EXPECT_TRUE(!has_stream || absl::StrContains(line, " span_id=" + span_id)) << line;
  }
  EXPECT_THAT(events, testing::IsSupersetOf({"session_created", "session_attached", "object_lost", "stream_ended",
                                             "session_ended", "session_deleted", "stream_phase"}));
}

// Clients choose the header, and clients without it are admitted, too.
TEST_F(SessionLogOfServerTest, TheSpanIsMadeIfTheClientSendsNoGoodOne) {
  CreatedSession session = CreateSession();
  const std::string trace_id = TraceIdOf(session.name()), other_trace = std::string(31, '0') + "1";
  const std::string good = Traceparent({trace_id, "b7ad6b7169203331"});
  const std::string foreign = Traceparent({other_trace, "00f067aa0ba902b7"});
  const std::string made = " span_id=[0-9a-f]+ stream=[0-9]+ next_chunk=1";
  const std::string given = " span_id=b7ad6b7169203331 stream=[0-9]+ next_chunk=1";
  const std::string client_trace = " client_trace_id=" + other_trace;
  const std::string hostile = "00-" + std::string(200, 'x') + "\" level=error";
  const std::pair<std::vector<std::string>, std::string> cases[] = {
      {{}, made},
      {{hostile, "", "00-00", std::string(3000, '0')}, made},
      {{"00-" + trace_id + "-0000000000000000-01"}, made},
      {{foreign}, made + client_trace},
      {{good}, given},
      {{foreign, hostile, good}, given + client_trace},
  };
  for (const auto& [headers, expected] : cases) {
    LinesOf(session.name());
    RawTrack track(*sessions_, headers);
    track.Attach(session.name(), session.resume_token());
    v1::TrackResponse response;
    ASSERT_TRUE(track.Read(response)) << Describe(track.Finish());
    session.set_resume_token(response.attached().resume_token());
    const std::string log = captured_log.Take();
    EXPECT_THAT(log, testing::ContainsRegex(" session_(attached|reattached|taken_over) [^\n]*" + expected + "\n"));
    EXPECT_THAT(log, testing::Not(HasSubstr("xxxx")));
    EXPECT_THAT(log, testing::Not(HasSubstr("span_id=00f067aa0ba902b7"))) << "it is a span of another trace";
    track.Cancel();
    track.Finish();
  }
}

TEST_F(SessionLogOfServerTest, HostileNamesStayInTheirLine) {
  v1::CreateSessionRequest request = CreateRequest();
  request.mutable_config()->mutable_objects(0)->set_object_id("cube\nerror session=\"x\"");
  CreatedSession session;
  const grpc::Status created = Create(request, &session);
  RawTrack track(*sessions_);
  track.Attach("sessions/none\nerror forged", "guess");
  EXPECT_EQ(Describe(track.Finish()), "NOT_FOUND SESSION_NOT_FOUND");
  const std::string log = captured_log.Take();
  EXPECT_THAT(log, HasSubstr(R"(info attach_refused session="sessions/none\nerror forged" )"));
  for (const absl::string_view line : absl::StrSplit(log, '\n', absl::SkipEmpty())) {
    EXPECT_FALSE(absl::StartsWith(line, "error")) << line;
  }
}

}  // namespace
}  // namespace evpose::server

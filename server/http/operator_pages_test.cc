// SPDX-License-Identifier: Apache-2.0

// Tests the pages of a server with fake trackers, to which raw stubs send events.
#include "server/http/operator_pages.h"

#include <set>
#include <string>

#include "core/base/poll_testing.h"
#include "core/base/trace_context.h"
#include "server/http/http_client_testing.h"
#include "server/rpc/server_testing.h"
#include "server/sessions/store_testing.h"
#include "server/stores/memory/memory_store.h"
#include "server/telemetry/prometheus_testing.h"

namespace evpose::server {
namespace {

using testing::HasSubstr;
using Kind = v1::TrackResponse;

class OperatorPagesTest : public RpcTest {
 protected:
  OperatorPagesTest() {
    ServerOptions options = Options();
    options.store_check_period = absl::Milliseconds(1);
    options.max_sessions = 64;
    server_ = StartServer(options, FakeTrackers(gate_), std::make_unique<FaultInjectingStore>(store_, fault_)).value();
    Use(server_->InProcessChannel());
    pages_ = OperatorPages::Start("127.0.0.1:0", {"1.2.3", "abc1234"}).value();
    pages_->Show(*server_);
  }
  ~OperatorPagesTest() override { pages_.reset(); }  // the pages must be destroyed before the server

  HttpResponse Get(const std::string& path) const { return Ask(pages_->port(), path); }
  ParsedMetrics Scrape() const {
    const HttpResponse answer = Get("/metrics");
    EXPECT_EQ(answer.status, 200);
    EXPECT_THAT(answer.head, HasSubstr("Content-Type: text/plain; version=0.0.4; charset=utf-8\r\n"));
    return ParseMetrics(answer.body);
  }

  const std::shared_ptr<InjectedFault> fault_ = std::make_shared<InjectedFault>();
  const std::shared_ptr<Store> store_ = MakeMemoryStore();
  std::unique_ptr<OperatorPages> pages_;
};

TEST_F(OperatorPagesTest, AStartingServerIsLiveAndNotReady) {
  const auto pages = OperatorPages::Start("127.0.0.1:0", {"1.2.3", "abc1234"}).value();
  EXPECT_EQ(Ask(pages->port(), "/healthz").status, 200);
  EXPECT_EQ(Ask(pages->port(), "/readyz").status, 503);
  EXPECT_THAT(Ask(pages->port(), "/readyz").body, testing::MatchesRegex("the server is starting[^\n]*\n"));
  EXPECT_EQ(Ask(pages->port(), "/metrics").status, 503);
  pages->Show(*server_);
  EXPECT_EQ(Ask(pages->port(), "/readyz").status, 200);
  EXPECT_EQ(Ask(pages->port(), "/metrics").status, 200);
}

TEST_F(OperatorPagesTest, ReadyWhileTheStoreResponds) {
  EXPECT_EQ(Get("/readyz").status, 200);
  EXPECT_EQ(Scrape().At("evpose_ready"), 1.0);
  for (int i = 0; i < 2; ++i) {
    fault_->Set(absl::UnavailableError("gone\nfor lunch"));
    const HttpResponse answer = WaitUntilReadyIs(pages_->port(), 503);
    EXPECT_THAT(answer.body, testing::MatchesRegex("the store does not respond: gone for lunch\n"));
    EXPECT_EQ(Scrape().At("evpose_ready"), 0.0);
    EXPECT_EQ(Get("/healthz").status, 200) << "restarting the process would not help";
    fault_->Set(absl::OkStatus());
    WaitUntilReadyIs(pages_->port(), 200);
  }
}

TEST_F(OperatorPagesTest, NotReadyAfterDrain) {
  const auto track = Attached(CreateSession());
  grpc::ClientContext context;
  v1::DrainResponse response;
  ASSERT_TRUE(admin_->Drain(&context, {}, &response).ok());
  const HttpResponse answer = Get("/readyz");
  EXPECT_EQ(answer.status, 503);
  EXPECT_THAT(answer.body, testing::MatchesRegex("the server is shutting down[^\n]*\n"));
  EXPECT_EQ(Get("/healthz").status, 200);
  EXPECT_EQ(Scrape().At("evpose_ready"), 0.0);
  EXPECT_EQ(Scrape().At("evpose_sessions{state=\"attached\"}"), 1.0);
  server_->Shutdown(absl::ZeroDuration());
  EXPECT_EQ(Get("/readyz").status, 503);
  EXPECT_EQ(Get("/healthz").status, 200);
  EXPECT_EQ(Scrape().At("evpose_stream_ends_total{stream=\"track\",code=\"UNAVAILABLE\"}"), 1.0);
}

// With LATEST, the notices of the stream, the session's health and the metrics have the same counts.
TEST_F(OperatorPagesTest, SkippedEventsAreCountedEquallyEverywhere) {
  CreatedSession session;
  uint64_t sent_bytes = 0;
  const auto track = OverloadedLatest(&session, &sent_bytes);
  ParsedMetrics waiting;
  ASSERT_TRUE(Poll([&] {
    waiting = Scrape();
    return waiting.At("evpose_received_bytes_total") >= static_cast<double>(sent_bytes);
  }));
  EXPECT_EQ(waiting.At("evpose_queue_bytes"), static_cast<double>(sent_bytes));
  EXPECT_GT(waiting.At("evpose_queue_age_seconds"), 0.0);
  EXPECT_EQ(waiting.At("evpose_events_skipped_total{reason=\"memory\"}"), 0.0);
  gate_->Open();
  ASSERT_TRUE(track->End());

  uint64_t skipped = 0;
  std::vector<v1::TrackResponse> before;
  v1::TrackResponse response;
  ASSERT_TRUE(track->ReadUntil(Kind::kSummary, response, &before));
  for (const v1::TrackResponse& message : before) skipped += message.notice().dropped().num_events();
  ASSERT_EQ(Describe(track->Finish()), "OK");
  const v1::SessionHealth& health = response.summary().health();
  const ParsedMetrics metrics = Scrape();
  EXPECT_GT(skipped, 0u);
  EXPECT_EQ(health.skipped_events(), skipped);
  EXPECT_EQ(metrics.At("evpose_events_skipped_total{reason=\"memory\"}"), static_cast<double>(skipped));
  EXPECT_EQ(metrics.At("evpose_events_skipped_total{reason=\"lag\"}"), 0.0);
  EXPECT_EQ(metrics.At("evpose_events_skipped_total{reason=\"reader\"}"), 0.0);
  EXPECT_EQ(metrics.At("evpose_events_decoded_total"), static_cast<double>(health.decoded_events()));
  EXPECT_EQ(metrics.At("evpose_poses_total"), static_cast<double>(health.poses()));
  EXPECT_EQ(metrics.At("evpose_pose_latency_seconds_count"), static_cast<double>(health.poses()));
  EXPECT_EQ(metrics.At("evpose_queue_bytes"), 0.0);
  EXPECT_EQ(metrics.At("evpose_sessions{state=\"ended\"}"), 1.0);
  EXPECT_EQ(metrics.At("evpose_stream_ends_total{stream=\"track\",code=\"OK\"}"), 1.0);
  EXPECT_EQ(Describe(Delete(session.name())), "OK");
  EXPECT_EQ(Scrape().At("evpose_events_skipped_total{reason=\"memory\"}"), static_cast<double>(skipped));
}

TEST_F(OperatorPagesTest, StreamsAreCountedByTheirEnds) {
  const CreatedSession session = CreateSession();
  {
    RawTrack wrong(*sessions_);
    wrong.Attach(session.name(), "guess");
    EXPECT_EQ(Describe(wrong.Finish()), "PERMISSION_DENIED WRONG_TOKEN");
  }
  grpc::ClientContext context;
  v1::WatchPosesRequest watch;
  watch.set_session("sessions/none");
  EXPECT_EQ(Describe(sessions_->WatchPoses(&context, watch)->Finish()), "NOT_FOUND SESSION_NOT_FOUND");
  const ParsedMetrics metrics = Scrape();
  EXPECT_EQ(metrics.At("evpose_stream_ends_total{stream=\"track\",code=\"PERMISSION_DENIED\"}"), 1.0);
  EXPECT_EQ(metrics.At("evpose_stream_ends_total{stream=\"watch\",code=\"NOT_FOUND\"}"), 1.0);
  EXPECT_EQ(metrics.At("evpose_stream_ends_total{stream=\"track\",code=\"OK\"}"), 0.0);
}

// The size of the page does not depend on the number of tenants and sessions, and the page does not name them.
TEST_F(OperatorPagesTest, SessionsAddNoSeries) {
  const auto series = [](const ParsedMetrics& metrics) {
    std::set<std::string> names;
    for (const auto& [name, value] : metrics.values) names.insert(name);
    return names;
  };
  const std::set<std::string> without = series(Scrape());
  const v1::CreateSessionRequest request = CreateRequest();
  std::vector<CreatedSession> sessions(64);
  for (CreatedSession& session : sessions) ASSERT_EQ(Describe(Create(request, &session)), "OK");
  CreatedSession one_too_many;
  EXPECT_EQ(Describe(Create(request, &one_too_many)), "RESOURCE_EXHAUSTED TOO_MANY_SESSIONS");
  const HttpResponse answer = Get("/metrics");
  const ParsedMetrics with = ParseMetrics(answer.body);
  EXPECT_EQ(series(with), without);
  EXPECT_EQ(with.At("evpose_sessions{state=\"detached\"}"), 64.0);
  EXPECT_EQ(with.At("evpose_max_sessions"), 64.0);
  EXPECT_EQ(with.At("evpose_quota_refusals_total{limit=\"max_sessions\"}"), 1.0);
  for (const CreatedSession& session : sessions) {
    EXPECT_THAT(answer.body, testing::Not(HasSubstr(session.name())));
    EXPECT_THAT(answer.body, testing::Not(HasSubstr(session.resume_token())));
  }
}

TEST_F(OperatorPagesTest, OpenMetricsHaveExemplarsOfTheTrace) {
  const CreatedSession session = CreateSession();
  const auto track = Attached(session);
  track->Events(1, Flat64(SomeEvents(1, 11)));
  track->End();
  EXPECT_EQ(Describe(track->Finish()), "OK");
  const std::string exemplar = " # {trace_id=\"" + TraceIdOf(session.name()) + "\"} ";
  const HttpResponse plain = Get("/metrics");
  EXPECT_THAT(plain.body, testing::Not(HasSubstr("trace_id")));
  const HttpResponse answer =
      Ask(pages_->port(), "/metrics", "GET", "",
          "Accept: application/openmetrics-text;version=1.0.0,text/plain;version=0.0.4;q=0.5,*/*;q=0.1\r\n");
  EXPECT_EQ(answer.status, 200);
  EXPECT_THAT(answer.head, HasSubstr("Content-Type: application/openmetrics-text; version=1.0.0; charset=utf-8\r\n"));
  for (const char* histogram : {"pose_latency", "turn", "decode_duration", "track_duration", "checkpoint_duration"}) {
    EXPECT_THAT(answer.body, testing::ContainsRegex(absl::StrCat("\nevpose_", histogram, "_seconds_bucket[^\n]*",
                                                                 TraceIdOf(session.name()))));
  }
  EXPECT_THAT(answer.body, HasSubstr(exemplar));
  EXPECT_THAT(answer.body, testing::EndsWith("\n# EOF\n"));
  EXPECT_THAT(answer.body, testing::Not(HasSubstr(session.name()))) << "the port has no authentication";
}

}  // namespace
}  // namespace evpose::server

// SPDX-License-Identifier: Apache-2.0

// One ID names a session in the messages of its client, in the logs of its servers and in their metrics, also after its
// server was killed and started again.
#include <gmock/gmock.h>

#include <algorithm>
#include <iterator>
#include <memory>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "core/base/byte_order.h"
#include "evpose/client.h"
#include "server/http/http_client_testing.h"
#include "tests/integration/cutting_proxy.h"
#include "tests/integration/survival_testing.h"

namespace evpose {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsSupersetOf;
using Line = nlohmann::json;

// A server with its log as JSON and its metrics.
class TracedServer {
 public:
  explicit TracedServer(const std::string& data_dir)
      : server_(WithMetrics(
            {"--store", "sqlite", "--data-dir", data_dir, "--log-format", "json", "--log-level", "debug"})) {}

  int port() const { return server::PortOf(server_.address()); }
  void Kill() { server_.Kill(); }
  // The metrics in the format that has exemplars.
  std::string Metrics() const {
    return server::Ask(server::PortOf(server_.metrics_address()), "/metrics", "GET", "",
                       "Accept: application/openmetrics-text\r\n")
        .body;
  }
  // The lines of the log about a session.
  std::vector<Line> LinesOf(const std::string& session) {
    std::vector<Line> lines;
    for (const absl::string_view text : absl::StrSplit(server_.program().Stderr(), '\n', absl::SkipEmpty())) {
      const Line line = Line::parse(text, nullptr, false);
      EXPECT_FALSE(line.is_discarded()) << text;
      if (line.value("session", "") == session) lines.push_back(line);
    }
    return lines;
  }
  void AwaitEnd() {
    server_.program().Signal(SIGTERM);
    EXPECT_EQ(server_.program().Wait(), 0);
  }

 private:
  RunningServer server_;
};

std::vector<std::string> EventsOf(const std::vector<Line>& lines) {
  std::vector<std::string> events;
  for (const Line& line : lines) events.push_back(line["event"]);
  return events;
}

// The span IDs of the lines with one of these events.
std::vector<std::string> SpansOf(const std::vector<Line>& lines, const std::set<std::string>& events) {
  std::vector<std::string> spans;
  for (const Line& line : lines) {
    if (events.contains(line["event"])) spans.push_back(line.value("span_id", ""));
  }
  return spans;
}

const std::set<std::string> kAttachments = {"session_attached", "session_reattached", "session_taken_over"};

class TraceTest : public CliTest {
 protected:
  void SetUp() override {
    CliTest::SetUp();
    SimulateCube(0.5);
  }

  static client::Session Create(client::Client& client, const std::string& model_file, const std::string& camera_file) {
    const auto model = client.UploadModel(AsBytes(model_file), {});
    EXPECT_TRUE(model.ok()) << model.status();
    client::SessionConfig config;
    config.camera = client::LoadCamera(camera_file).value();
    config.objects.push_back({.object_id = "cube", .model = model->name});
    return client.CreateSession(config).value();
  }

  absl::StatusOr<client::TrackSummary> Track(client::Client& client, const client::Session& session,
                                             const client::TrackCallbacks& callbacks) const {
    const auto recording = client::Recording::Open(Path("cube/recording.raw")).value();
    return client.Track(session, [&recording] { return recording->Next(); }, callbacks, {});
  }
};

// What client and servers have reported of a session.
struct Reports {
  std::vector<client::StreamTrace> broken, back;  // by the client
  std::vector<std::string> metrics;
  std::vector<Line> first, second;  // the logs of the servers
};

class RestartTest : public TraceTest {
 protected:
  // Tracks the recording, with a kill of the server at pose 50 and a start of another one on its store; then deletes
  // the session, and attaches again.
  void TrackAndFail() {
    auto first = std::make_unique<TracedServer>(Path("data"));
    std::unique_ptr<TracedServer> second;
    proxy_.SetTarget(first->port());
    const auto client = client::Client::Connect(proxy_.address()).value();
    session_ = Create(*client, ReadText("cube/model.obj"), Path("cube/camera.yaml"));
    client::TrackCallbacks callbacks;
    callbacks.on_pose = [&](const client::Pose& pose) {
      if (second != nullptr || pose.seq < 50) return;
      reports_.metrics.push_back(first->Metrics());
      first->Kill();
      second = std::make_unique<TracedServer>(Path("data"));
      proxy_.SetTarget(second->port());
    };
    callbacks.on_connection = [&](const client::ConnectionChange& change) {
      (change.is_unreachable ? reports_.broken : reports_.back).push_back(change.trace);
    };
    summary_ = Track(*client, session_, callbacks);
    ASSERT_TRUE(summary_.ok()) << summary_.status();
    ASSERT_NE(second, nullptr);
    described_ = Run({"sessions", "get", session_.name, "--server", proxy_.address(), "--json"}).Json();
    reports_.metrics.push_back(second->Metrics());
    ASSERT_TRUE(client->DeleteSession(session_.name).ok());
    failed_ = Track(*client, session_, {}).status();
    second->AwaitEnd();
    reports_.first = first->LinesOf(session_.name);
    reports_.second = second->LinesOf(session_.name);
  }

  CuttingProxy proxy_;
  client::Session session_;
  absl::StatusOr<client::TrackSummary> summary_ = absl::UnknownError("");
  nlohmann::json described_;
  absl::Status failed_;
  Reports reports_;
};

TEST_F(RestartTest, OneIdIsInMessagesLogsAndMetrics) {
  TrackAndFail();
  if (HasFatalFailure()) return;
  const std::string trace_id = client::TraceId(session_.name);
  EXPECT_EQ(described_["trace_id"], trace_id);
  for (const std::string& metrics : reports_.metrics) {
    EXPECT_THAT(metrics, HasSubstr(absl::StrCat(" # {trace_id=\"", trace_id, "\"} ")));
  }
  for (const auto* lines : {&reports_.first, &reports_.second}) {
    for (const Line& line : *lines) EXPECT_EQ(line.value("trace_id", ""), trace_id) << line;
  }
  EXPECT_THAT(EventsOf(reports_.first), IsSupersetOf({"session_created", "session_attached", "object_initialized"}));
  EXPECT_THAT(EventsOf(reports_.second), IsSupersetOf({"session_resumed", "session_reattached", "session_ended",
                                                       "stream_ended", "session_deleted", "attach_refused"}));
  // A stream has the same span at the client and at its server.
  ASSERT_FALSE(reports_.broken.empty());
  ASSERT_FALSE(reports_.back.empty());
  EXPECT_EQ(summary_->trace, reports_.back.back());
  EXPECT_THAT(SpansOf(reports_.first, kAttachments), ElementsAre(reports_.broken.front().span_id));
  EXPECT_THAT(SpansOf(reports_.second, kAttachments), Contains(summary_->trace.span_id));
  EXPECT_THAT(SpansOf(reports_.second, {"session_ended"}), ElementsAre(summary_->trace.span_id));
  EXPECT_EQ(failed_.code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(std::string(failed_.message()),
              HasSubstr(absl::StrCat("; trace_id=", trace_id,
                                     " span_id=", SpansOf(reports_.second, {"attach_refused"}).back())));
}

TEST_F(RestartTest, OneLineOfAllLogsHasTheSums) {
  TrackAndFail();
  if (HasFatalFailure()) return;
  std::vector<Line> ends;
  for (const auto* lines : {&reports_.first, &reports_.second}) {
    std::copy_if(lines->begin(), lines->end(), std::back_inserter(ends),
                 [](const Line& line) { return line.contains("cause"); });
  }
  ASSERT_EQ(ends.size(), 1u);
  EXPECT_EQ(ends[0]["cause"], "end_of_input");
  EXPECT_EQ(ends[0]["poses"], summary_->health.poses);
  EXPECT_EQ(ends[0]["events"], summary_->health.decoded_events);
  EXPECT_EQ(ends[0]["bytes"], summary_->sent_bytes);
  EXPECT_GE(ends[0]["reattaches"], 1);
  EXPECT_GT(ends[0]["processing_us"], 0);
  EXPECT_GT(ends[0]["latency_p99_us"], 0);
  EXPECT_GT(ends[0]["lifetime_us"], 0);
}

TEST_F(TraceTest, TheReportOfAReplayHasTheTraceOfItsSession) {
  TracedServer server(Path("data"));
  const CliResult replay =
      Run(ReplayArguments("poses.csv", {"--server", absl::StrCat("127.0.0.1:", server.port()), "--keep-session"}));
  ASSERT_EQ(replay.status, 0) << replay.err;
  const std::string session = replay.Json()["session"];
  EXPECT_EQ(replay.Json()["trace_id"], client::TraceId(session));
  server.AwaitEnd();
  const std::vector<Line> lines = server.LinesOf(session);
  ASSERT_FALSE(lines.empty());
  for (const Line& line : lines) EXPECT_EQ(line["trace_id"], replay.Json()["trace_id"]);
}

}  // namespace
}  // namespace evpose

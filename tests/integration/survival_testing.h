// SPDX-License-Identifier: Apache-2.0

// What the tests of survival share: servers as processes, a client that continues a session, and a short recording.
#pragma once

#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "client/lib/messages/conversion.h"
#include "core/geometry/camera.h"
#include "core/recordings/recording_reader.h"
#include "evpose/recording.h"
#include "evpose/v1/model_service.grpc.pb.h"
#include "evpose/v1/session_service.grpc.pb.h"
#include "server/program/program_testing.h"
#include "server/rpc/raw_requests_testing.h"
#include "tests/integration/cli_fixture.h"

namespace evpose {

// The number of chunks in transit, which a kill interrupts.
inline constexpr uint64_t kChunksAhead = 16;

// Returns the number in an environment variable.
inline int NumberFrom(const char* variable, int by_default) {
  const char* number = std::getenv(variable);
  return number == nullptr ? by_default : std::atoi(number);
}

// A server process and stubs connected to it.
class RunningServer {
 public:
  explicit RunningServer(std::vector<std::string> arguments, const char* program = EVPOSE_SERVER)
      : program_(WithAddress(std::move(arguments)), program) {
    const std::string line = program_.ReadLine();
    EXPECT_TRUE(absl::StartsWith(line, "listening on ")) << line << program_.Stderr();
    address_ = line.substr(line.rfind(' ') + 1);
    channel_ = grpc::CreateChannel(address_, grpc::InsecureChannelCredentials());
    sessions_ = v1::SessionService::NewStub(channel_);
    models_ = v1::ModelService::NewStub(channel_);
  }

  void Kill() {
    program_.Signal(SIGKILL);
    program_.Wait();
  }
  server::Program& program() { return program_; }
  const std::string& address() const { return address_; }
  v1::SessionService::Stub& sessions() { return *sessions_; }
  v1::ModelService::Stub& models() { return *models_; }

 private:
  static std::vector<std::string> WithAddress(std::vector<std::string> arguments) {
    arguments.insert(arguments.end(), {"--listen", "127.0.0.1:0"});
    return arguments;
  }

  server::Program program_;
  std::string address_;
  std::shared_ptr<grpc::Channel> channel_;
  std::unique_ptr<v1::SessionService::Stub> sessions_;
  std::unique_ptr<v1::ModelService::Stub> models_;
};

// Measures the longest time between two calls of Note().
class PauseTimer {
 public:
  // The next call of Note() is the first one.
  void Reset() { last_.reset(); }
  void Note() {
    const auto now = std::chrono::steady_clock::now();
    if (last_.has_value()) longest_ = std::max(longest_, now - *last_);
    last_ = now;
  }
  double longest_s() const { return std::chrono::duration<double>(longest_).count(); }

 private:
  std::optional<std::chrono::steady_clock::time_point> last_;
  std::chrono::steady_clock::duration longest_{};
};

// A client that keeps the state for continuing at another server, or at the same one after a restart.
class RawClient {
 public:
  RawClient(std::vector<std::string> chunks, server::CreatedSession session)
      : chunks_(std::move(chunks)), session_(std::move(session)) {}

  // Streams until the client has this number of poses, or until the stream breaks (if allowed), or to the end; returns
  // true if the summary was received.
  bool Stream(RunningServer& server, size_t stop_at_poses) {
    grpc::ClientContext context;
    const auto stream = server.sessions().Track(&context);
    v1::TrackRequest request;
    request.mutable_attach()->set_session(session_.name());
    request.mutable_attach()->set_resume_token(session_.resume_token());
    request.mutable_attach()->set_last_pose_seq(poses_.size());
    stream->Write(request);
    v1::TrackResponse response;
    bool summary = false;
    uint64_t next_seq = 0;
    uint64_t processed_seq = 0;
    bool end_was_sent = false;
    while (!summary && (next_seq == 0 || poses_.size() < stop_at_poses)) {
      if (!stream->Read(&response)) {
        const grpc::Status status = stream->Finish();
        EXPECT_TRUE(may_break_) << status.error_code() << " " << status.error_message();
        return false;
      }
      if (response.has_attached()) {
        next_seq = response.attached().next_seq();
        processed_seq = next_seq - 1;
        session_.set_resume_token(response.attached().resume_token());
        pose_pause_.Reset();
        durable_pause_.Reset();
        durable_pause_.Note();
        // Chunks that are not durable are kept; durable ones are never sent again.
        EXPECT_GE(next_seq, durable_seq_ + 1);
        EXPECT_EQ(response.attached().first_pose_seq(), poses_.size() + 1);
      }
      if (response.has_pose()) AddPose(*response.mutable_pose());
      if (response.has_ack()) {
        processed_seq = std::max(processed_seq, response.ack().processed_seq());
        RaiseDurable(response.ack().durable_seq());
      }
      if (response.notice().has_go_away() && on_go_away_ != nullptr) on_go_away_();
      summary = response.has_summary();
      if (summary) {
        pose_pause_.Note();
        durable_pause_.Note();
        EXPECT_EQ(response.summary().health().poses(), poses_.size());
      }
      for (; next_seq > 0 && next_seq <= chunks_.size() && next_seq <= processed_seq + kChunksAhead; ++next_seq) {
        v1::TrackRequest chunk;
        chunk.mutable_events()->set_seq(next_seq);
        chunk.mutable_events()->set_payload(chunks_[next_seq - 1]);
        stream->Write(chunk);
      }
      if (next_seq == chunks_.size() + 1 && !end_was_sent) {
        end_was_sent = true;
        v1::TrackRequest end;
        end.mutable_end();
        stream->Write(end);
      }
    }
    context.TryCancel();
    while (stream->Read(&response)) continue;
    (void)stream->Finish();
    return summary;
  }

  // Sets a callback that is called after each pose, with the number of poses so far.
  void OnPose(std::function<void(size_t)> on_pose) { on_pose_ = std::move(on_pose); }
  // Sets a callback for GoAway.
  void OnGoAway(std::function<void()> on_go_away) { on_go_away_ = std::move(on_go_away); }

  void MayBreak(bool may_break) { may_break_ = may_break; }

  const std::string& session() const { return session_.name(); }
  const std::vector<std::string>& poses() const { return poses_; }
  uint64_t durable_seq() const { return durable_seq_; }
  // The longest time between two poses of a stream, or the last pose and the summary.
  const PauseTimer& pose_pause() const { return pose_pause_; }
  // The longest time in a stream in which no further chunk became durable.
  const PauseTimer& durable_pause() const { return durable_pause_; }

 private:
  void RaiseDurable(uint64_t durable_seq) {
    if (durable_seq <= durable_seq_) return;
    durable_pause_.Note();
    durable_seq_ = durable_seq;
  }

  void AddPose(v1::Pose& pose) {
    EXPECT_EQ(pose.pose_seq(), poses_.size() + 1) << "no pose twice, none missing";
    pose_pause_.Note();
    pose.clear_latency();
    poses_.push_back(pose.SerializeAsString());
    if (on_pose_ != nullptr) on_pose_(poses_.size());
  }

  const std::vector<std::string> chunks_;
  server::CreatedSession session_;
  std::vector<std::string> poses_;  // without the fields that depend on the clock
  uint64_t durable_seq_ = 0;
  PauseTimer pose_pause_;
  PauseTimer durable_pause_;
  std::function<void(size_t)> on_pose_;
  std::function<void()> on_go_away_;
  bool may_break_ = false;
};

// Simulates a recording of 2 s and splits it into chunks.
class SurvivalFixture : public CliTest {
 protected:
  void SetUp() override {
    CliTest::SetUp();
    SimulateCube(2.0);
    auto reader = RecordingReader::Open(Path("cube/recording.raw")).value();
    Chunker chunker(*reader, {});
    for (EventChunkBytes chunk = chunker.Next().value(); !chunk.bytes.empty(); chunk = chunker.Next().value()) {
      chunks_.emplace_back(chunk.bytes.begin(), chunk.bytes.end());
    }
  }

  std::vector<std::string> Sqlite(const std::string& name) const {
    return {"--store", "sqlite", "--data-dir", Path(name), "--log-level", "warning"};
  }

  // Creates a session that tracks the recording's cube without an initial pose.
  RawClient MakeClient(RunningServer& server) {
    v1::CreateSessionRequest request;
    *request.mutable_config() =
        client::ToProto(client::SessionConfig{.camera = client::LoadCamera(Path("cube/camera.yaml")).value(),
                                              .objects = {{.object_id = "cube", .model = Upload(server)}}});
    server::CreatedSession session;
    grpc::ClientContext context;
    const grpc::Status status = server.sessions().CreateSession(&context, request, session.response());
    EXPECT_TRUE(status.ok()) << status.error_message();
    return RawClient(chunks_, session);
  }

  std::string Upload(RunningServer& server) {
    v1::Model model;
    const grpc::Status status =
        server::UploadModel(server.models(), server::UploadRequests(ReadText("cube/model.obj")), &model);
    EXPECT_TRUE(status.ok()) << status.error_message();
    return model.name();
  }

  std::vector<std::string> Undisturbed() {
    RunningServer server({"--store", "memory", "--log-level", "warning"});
    RawClient client = MakeClient(server);
    EXPECT_TRUE(client.Stream(server, SIZE_MAX));
    return client.poses();
  }

 private:
  std::vector<std::string> chunks_;
};

}  // namespace evpose

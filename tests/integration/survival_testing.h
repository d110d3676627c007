// SPDX-License-Identifier: Apache-2.0

// What the tests of survival share: a client that continues a session, and a short recording.
#pragma once

#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "client/lib/messages/conversion.h"
#include "core/geometry/camera.h"
#include "core/recordings/chunker.h"
#include "core/recordings/recording_reader.h"
#include "evpose/recording.h"
#include "evpose/v1/model_service.grpc.pb.h"
#include "evpose/v1/session_service.grpc.pb.h"
#include "server/rpc/raw_requests_testing.h"
#include "tests/integration/cli_fixture.h"
#include "tests/integration/running_server_testing.h"

namespace evpose {

// The number of chunks in transit, which a kill interrupts.
inline constexpr uint64_t kChunksAhead = 16;

// Returns the number in an environment variable.
inline int NumberFrom(const char* variable, int by_default) {
  const char* number = std::getenv(variable);
  return number == nullptr ? by_default : std::atoi(number);
}

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
    server::RawTrack track(server.sessions());
    track.Attach(session_, poses_.size());
    Position position;
    while (!position.has_summary && (position.next_seq == 0 || poses_.size() < stop_at_poses)) {
      v1::TrackResponse response;
      if (!track.Read(response)) {
        const grpc::Status status = track.Finish();
        EXPECT_TRUE(may_break_) << status.error_code() << " " << status.error_message();
        return false;
      }
      HandleResponse(response, position);
      SendAhead(track, position);
    }
    return position.has_summary;
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
  // The state of one stream.
  struct Position {
    uint64_t next_seq = 0;  // of the next chunk to send; 0 until the stream is attached
    uint64_t processed_seq = 0;
    bool end_was_sent = false;
    bool has_summary = false;
  };

  void HandleResponse(v1::TrackResponse& response, Position& position) {
    if (response.has_attached()) {
      position.next_seq = response.attached().next_seq();
      position.processed_seq = position.next_seq - 1;
      session_.set_resume_token(response.attached().resume_token());
      pose_pause_.Reset();
      durable_pause_.Reset();
      durable_pause_.Note();
      // Chunks that are not durable are kept; durable ones are never sent again.
      EXPECT_GE(position.next_seq, durable_seq_ + 1);
      EXPECT_EQ(response.attached().first_pose_seq(), poses_.size() + 1);
    }
    if (response.has_pose()) AddPose(*response.mutable_pose());
    if (response.has_ack()) {
      position.processed_seq = std::max(position.processed_seq, response.ack().processed_seq());
      RaiseDurable(response.ack().durable_seq());
    }
    if (response.notice().has_go_away() && on_go_away_ != nullptr) on_go_away_();
    position.has_summary = response.has_summary();
    if (position.has_summary) {
      pose_pause_.Note();
      durable_pause_.Note();
      EXPECT_EQ(response.summary().health().poses(), poses_.size());
    }
  }

  // Sends the chunks that are not processed yet, up to kChunksAhead, and after the last one the end.
  void SendAhead(server::RawTrack& track, Position& position) const {
    uint64_t& next_seq = position.next_seq;
    for (; next_seq > 0 && next_seq <= chunks_.size() && next_seq <= position.processed_seq + kChunksAhead;
         ++next_seq) {
      track.Events(next_seq, chunks_[next_seq - 1]);
    }
    if (next_seq == chunks_.size() + 1 && !position.end_was_sent) {
      position.end_was_sent = true;
      track.End();
    }
  }

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

  std::vector<std::string> chunks_;  // of the recording
};

}  // namespace evpose

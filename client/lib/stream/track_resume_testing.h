// SPDX-License-Identifier: Apache-2.0

// Fixture for tests of reconnection: each stream that the client opens is served by a script of its own.
#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <mutex>
#include <string>
#include <vector>

#include "client/lib/fake_clock_testing.h"
#include "client/lib/stream/scripted_server_testing.h"
#include "evpose/client.h"

namespace evpose::client {

inline const grpc::Status kCut(grpc::StatusCode::UNAVAILABLE, "connection reset");

inline v1::TrackResponse AttachedAt(uint64_t next_seq, uint64_t first_pose_seq, const std::string& token) {
  v1::TrackResponse response = Attached(1 << 20);
  response.mutable_attached()->set_next_seq(next_seq);
  response.mutable_attached()->set_first_pose_seq(first_pose_seq);
  response.mutable_attached()->set_resume_token(token);
  return response;
}

inline v1::TrackResponse AckUpTo(uint64_t processed_seq, uint64_t durable_seq) {
  v1::TrackResponse response = Ack(processed_seq, 1 << 20);
  response.mutable_ack()->set_durable_seq(durable_seq);
  return response;
}

inline v1::TrackResponse GoAwayNotice() {
  v1::TrackResponse response;
  response.mutable_notice()->mutable_go_away()->mutable_deadline()->set_seconds(10);
  return response;
}

// The server's side of one stream: receives the attach message and runs the script of the test.
using StreamScript = std::function<grpc::Status(const v1::TrackRequest::Attach&, ServerStream&)>;

class TrackResumeTest : public TrackTest {
 protected:
  void SetUp() override {
    TrackTest::SetUp();
    options_.clock = &clock_;
    options_.retry.random = [] { return 1.0; };
    service_.script = [this](ServerStream& stream) {
      v1::TrackRequest request;
      if (!stream.Read(&request)) return grpc::Status::CANCELLED;
      StreamScript script;
      {
        const std::lock_guard lock(mutex_);
        attaches_.push_back(request.attach());
        if (attaches_.size() > scripts_.size()) return grpc::Status(grpc::StatusCode::UNAUTHENTICATED, "no more");
        script = scripts_[attaches_.size() - 1];
      }
      return script(request.attach(), stream);
    };
  }

  // Removes the recorded attaches, and replaces the stop source because a requested stop cannot be reset.
  void ClearStreams() {
    attaches_.clear();
    options_.stop = std::stop_source();
  }

  // Five chunks of eight bytes.
  absl::StatusOr<TrackSummary> Run() {
    TrackCallbacks callbacks = Callbacks();
    callbacks.on_position = [this](const TrackPosition& position, bool has_new_token) {
      if (has_new_token) positions_.push_back(position);
      return absl::OkStatus();
    };
    return client_->Track(session_, Source({8, 8, 8, 8, 8}), callbacks, options_);
  }

  std::vector<uint64_t> PoseSeqs() const {
    std::vector<uint64_t> seqs;
    for (const Pose& pose : poses_) seqs.push_back(pose.seq);
    return seqs;
  }

  // Receives all chunks from `next_seq` on and sends the summary.
  static StreamScript FinishFrom(uint64_t next_seq, uint64_t first_pose_seq, uint64_t last_pose_seq,
                                 const std::string& token = "") {
    return [=](const v1::TrackRequest::Attach&, ServerStream& stream) {
      stream.Write(AttachedAt(next_seq, first_pose_seq, token));
      uint64_t expected = next_seq;
      for (const v1::TrackRequest::EventChunk& chunk : ReadToEnd(stream)) {
        if (chunk.seq() != expected || chunk.payload() != std::string(8, static_cast<char>(chunk.seq() - 1))) {
          return grpc::Status(grpc::StatusCode::UNAUTHENTICATED, "not the expected chunk");
        }
        ++expected;
      }
      if (expected != 6) return grpc::Status(grpc::StatusCode::UNAUTHENTICATED, "chunks are missing");
      for (uint64_t seq = first_pose_seq; seq <= last_pose_seq; ++seq) stream.Write(PoseMessage(seq));
      stream.Write(SummaryMessage(last_pose_seq));
      return grpc::Status::OK;
    };
  }

  // Attaches, receives chunks up to `chunk_seq`, sends the given poses and the ack, and ends the stream with `status`.
  static StreamScript BreakAfter(uint64_t chunk_seq, uint64_t first_pose_seq, uint64_t last_pose_seq,
                                 const grpc::Status& status, const std::string& token = "", uint64_t next_seq = 1) {
    return [=](const v1::TrackRequest::Attach&, ServerStream& stream) {
      stream.Write(AttachedAt(next_seq, first_pose_seq, token));
      v1::TrackRequest request;
      while (stream.Read(&request) && request.events().seq() < chunk_seq) continue;
      for (uint64_t seq = first_pose_seq; seq <= last_pose_seq; ++seq) stream.Write(PoseMessage(seq));
      stream.Write(AckUpTo(chunk_seq, next_seq - 1));
      return status;
    };
  }

  static StreamScript Refuse(const grpc::Status& status) {
    return [=](const v1::TrackRequest::Attach&, ServerStream&) { return status; };
  }

  FakeClock clock_;
  TrackOptions options_;
  std::vector<StreamScript> scripts_;  // scripts of the streams, in their order
  std::vector<TrackPosition> positions_;
  std::mutex mutex_;
  std::vector<v1::TrackRequest::Attach> attaches_;
};

}  // namespace evpose::client

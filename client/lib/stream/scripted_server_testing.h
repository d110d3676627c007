// SPDX-License-Identifier: Apache-2.0

// A server for tests of streams. It runs the script of each test.
#pragma once

#include <gmock/gmock.h>
#include <grpcpp/server.h>
#include <grpcpp/server_builder.h>
#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "client/lib/client_access.h"
#include "client/lib/fake_clock_testing.h"
#include "evpose/client.h"
#include "evpose/v1/session_service.grpc.pb.h"
#include "google/rpc/error_details.pb.h"
#include "google/rpc/status.pb.h"

namespace evpose::client {

// A status with an ErrorReason, as the server sends it.
inline grpc::Status WithReason(grpc::StatusCode code, const std::string& reason) {
  google::rpc::Status details;
  google::rpc::ErrorInfo info;
  info.set_reason(reason);
  details.add_details()->PackFrom(info);
  return grpc::Status(code, "because of " + reason, details.SerializeAsString());
}

// RESOURCE_EXHAUSTED with RetryInfo.
inline grpc::Status Refusal(const std::string& reason, int64_t retry_s) {
  google::rpc::Status details;
  details.ParseFromString(WithReason(grpc::StatusCode::RESOURCE_EXHAUSTED, reason).error_details());
  google::rpc::RetryInfo retry;
  retry.mutable_retry_delay()->set_seconds(retry_s);
  details.add_details()->PackFrom(retry);
  return grpc::Status(grpc::StatusCode::RESOURCE_EXHAUSTED, "because of " + reason, details.SerializeAsString());
}

using ServerStream = grpc::ServerReaderWriter<v1::TrackResponse, v1::TrackRequest>;

class ScriptedService final : public v1::SessionService::Service {
 public:
  grpc::Status Track(grpc::ServerContext* context, ServerStream* stream) override {
    const auto sent = context->client_metadata().find("traceparent");
    if (sent != context->client_metadata().end()) traceparents.emplace_back(sent->second.begin(), sent->second.end());
    return script(*stream);
  }
  grpc::Status WatchPoses(grpc::ServerContext*, const v1::WatchPosesRequest* request,
                          grpc::ServerWriter<v1::WatchPosesResponse>* writer) override {
    return watch_poses(*request, *writer);
  }
  grpc::Status WatchHealth(grpc::ServerContext*, const v1::WatchHealthRequest* request,
                           grpc::ServerWriter<v1::WatchHealthResponse>* writer) override {
    return watch_health(*request, *writer);
  }
  grpc::Status WatchEvents(grpc::ServerContext*, const v1::WatchEventsRequest* request,
                           grpc::ServerWriter<v1::WatchEventsResponse>* writer) override {
    return watch_events(*request, *writer);
  }
  std::vector<std::string> traceparents;  // of the streams so far
  std::function<grpc::Status(ServerStream&)> script;
  std::function<grpc::Status(const v1::WatchPosesRequest&, grpc::ServerWriter<v1::WatchPosesResponse>&)> watch_poses;
  std::function<grpc::Status(const v1::WatchHealthRequest&, grpc::ServerWriter<v1::WatchHealthResponse>&)> watch_health;
  std::function<grpc::Status(const v1::WatchEventsRequest&, grpc::ServerWriter<v1::WatchEventsResponse>&)> watch_events;
};

inline v1::TrackResponse Attached(uint64_t limit_bytes, uint32_t max_chunk_bytes = 1 << 20) {
  v1::TrackResponse response;
  response.mutable_attached()->set_next_seq(1);
  response.mutable_attached()->set_first_pose_seq(1);
  response.mutable_attached()->set_send_limit_bytes(limit_bytes);
  response.mutable_attached()->set_max_chunk_bytes(max_chunk_bytes);
  return response;
}

inline v1::TrackResponse Ack(uint64_t seq, uint64_t limit_bytes) {
  v1::TrackResponse response;
  response.mutable_ack()->set_processed_seq(seq);
  response.mutable_ack()->set_send_limit_bytes(limit_bytes);
  return response;
}

inline v1::TrackResponse PoseMessage(uint64_t seq) {
  v1::TrackResponse response;
  v1::Pose& pose = *response.mutable_pose();
  pose.set_pose_seq(seq);
  pose.set_object_id("object");
  pose.set_t_us(1000 * static_cast<int64_t>(seq));
  pose.mutable_camera_from_object()->mutable_translation_m()->set_z(1.0);
  pose.mutable_camera_from_object()->mutable_rotation()->set_w(1.0);
  for (int i = 0; i < 21; ++i) pose.mutable_covariance()->add_upper_triangle(i);
  pose.mutable_twist()->mutable_linear_m_per_s()->set_y(1);
  pose.mutable_twist()->mutable_angular_rad_per_s()->set_z(5);
  pose.set_state(v1::TRACK_STATE_TRACKING);
  return response;
}

inline v1::TrackResponse SummaryMessage(uint64_t poses) {
  v1::TrackResponse response;
  response.mutable_summary()->mutable_health()->set_poses(poses);
  return response;
}

// Reads until `end`; returns the chunks.
inline std::vector<v1::TrackRequest::EventChunk> ReadToEnd(ServerStream& stream) {
  std::vector<v1::TrackRequest::EventChunk> chunks;
  v1::TrackRequest request;
  while (stream.Read(&request) && !request.has_end()) chunks.push_back(request.events());
  return chunks;
}

class TrackTest : public ::testing::Test {
 protected:
  void SetUp() override {
    grpc::ServerBuilder builder;
    builder.RegisterService(&service_);
    server_ = builder.BuildAndStart();
    client_ = ClientAccess::OverChannel(server_->InProcessChannel({}), "test server", clock_);
    session_.name = "sessions/1";
    session_.resume_token = "secret";
    session_.config.objects.emplace_back();
  }
  void TearDown() override { server_->Shutdown(); }

  // Returns chunks of these sizes in bytes, 1 ms apart.
  ChunkSource Source(std::vector<size_t> sizes) {
    return [sizes, next = size_t{0}]() mutable -> absl::StatusOr<EventChunk> {
      if (next == sizes.size()) return EventChunk{};
      EventChunk chunk;
      chunk.bytes.assign(sizes[next], static_cast<uint8_t>(next));
      chunk.t_last_us = static_cast<int64_t>(1000 * next++);
      return chunk;
    };
  }

  TrackCallbacks Callbacks() {
    TrackCallbacks callbacks;
    callbacks.on_pose = [this](const Pose& pose) { poses_.push_back(pose); };
    callbacks.on_notice = [this](const Notice& notice) { notices_.push_back(notice); };
    callbacks.on_progress = [this](const TrackProgress& progress) { progress_.push_back(progress); };
    callbacks.on_connection = [this](const ConnectionChange& change) { changes_.push_back(change); };
    return callbacks;
  }

  absl::StatusOr<TrackSummary> Track(std::vector<size_t> sizes, const TrackOptions& options = NoRetries()) {
    return client_->Track(session_, Source(std::move(sizes)), Callbacks(), options);
  }

  // Options for one stream without retries.
  static TrackOptions NoRetries() {
    TrackOptions options;
    options.retry.max_outage = absl::ZeroDuration();
    return options;
  }

  void ExpectError(const absl::StatusOr<TrackSummary>& result, absl::StatusCode code, const std::string& text) {
    EXPECT_EQ(result.status().code(), code);
    EXPECT_THAT(result.status().message(), ::testing::HasSubstr(text));
    EXPECT_THAT(result.status().message(), ::testing::HasSubstr("test server: "));
  }

  FakeClock clock_;  // of the streams of watchers
  ScriptedService service_;
  std::unique_ptr<grpc::Server> server_;
  std::unique_ptr<Client> client_;
  Session session_;
  std::vector<Pose> poses_;
  std::vector<Notice> notices_;
  std::vector<TrackProgress> progress_;
  std::vector<ConnectionChange> changes_;
};

}  // namespace evpose::client

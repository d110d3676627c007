// SPDX-License-Identifier: Apache-2.0

// Readers of poses and health, and resets of poses, against a scripted server.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "client/lib/fake_clock_testing.h"
#include "client/lib/stream/scripted_server_testing.h"
#include "google/rpc/error_details.pb.h"
#include "google/rpc/status.pb.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

grpc::Status Fenced() {
  google::rpc::Status details;
  google::rpc::ErrorInfo info;
  info.set_reason("FENCED");
  details.add_details()->PackFrom(info);
  return grpc::Status(grpc::StatusCode::ABORTED, "the session moved", details.SerializeAsString());
}

PoseReset ResetAt(double z_m, const std::string& object_id = "object") {
  PoseReset reset;
  reset.object_id = object_id;
  reset.camera_from_object.translation_m.z() = z_m;
  return reset;
}

using WatchTest = TrackTest;

TEST_F(WatchTest, PosesAreRequestedAtTheRateAndAfterTheFenceAgain) {
  std::vector<v1::WatchPosesRequest> requests;
  service_.watch_poses = [&](const v1::WatchPosesRequest& request, auto& writer) {
    requests.push_back(request);
    v1::WatchPosesResponse response;
    *response.add_poses() = PoseMessage(request.after_pose_seq() + 2).pose();
    response.set_num_skipped(1);
    writer.Write(response);
    return requests.size() == 1 ? Fenced() : grpc::Status::OK;
  };
  WatchPosesOptions options;
  options.after_pose_seq = 5;
  options.max_rate_hz = 25.0;
  std::vector<uint64_t> seqs;
  uint64_t num_skipped = 0;
  const absl::Status status =
      client_->WatchPoses("sessions/1", options, [&](const std::vector<Pose>& poses, uint64_t skipped) {
        for (const Pose& pose : poses) seqs.push_back(pose.seq);
        num_skipped += skipped;
      });
  EXPECT_TRUE(status.ok()) << status;
  EXPECT_THAT(seqs, ElementsAre(7, 9));
  EXPECT_EQ(num_skipped, 2u);
  ASSERT_EQ(requests.size(), 2u);
  for (const v1::WatchPosesRequest& request : requests) EXPECT_EQ(request.max_rate_hz(), 25.0);
  EXPECT_EQ(requests[0].after_pose_seq(), 5u);
  EXPECT_EQ(requests[1].after_pose_seq(), 7u);
  EXPECT_EQ(requests[0].session(), "sessions/1");
}

TEST_F(WatchTest, WithoutARateAllPosesAreRequested) {
  bool has_rate = true;
  service_.watch_poses = [&](const v1::WatchPosesRequest& request, auto&) {
    has_rate = request.has_max_rate_hz();
    return grpc::Status::OK;
  };
  EXPECT_TRUE(client_->WatchPoses("sessions/1", {}, [](const auto&, uint64_t) {}).ok());
  EXPECT_FALSE(has_rate);
}

TEST_F(WatchTest, AnInvalidPoseIsAnErrorOfTheServer) {
  service_.watch_poses = [&](const v1::WatchPosesRequest&, auto& writer) {
    v1::WatchPosesResponse response;
    response.add_poses()->set_pose_seq(3);
    writer.Write(response);
    return grpc::Status::OK;
  };
  const absl::Status status = client_->WatchPoses("sessions/1", {}, [](const auto&, uint64_t) {});
  EXPECT_EQ(status.code(), absl::StatusCode::kInternal);
  EXPECT_THAT(status.message(), HasSubstr("test server: pose 3: covariance"));
}

TEST_F(WatchTest, HealthIsDeliveredUntilTheSessionEnds) {
  std::vector<v1::WatchHealthRequest> requests;
  service_.watch_health = [&](const v1::WatchHealthRequest& request, auto& writer) {
    requests.push_back(request);
    v1::WatchHealthResponse response;
    for (uint64_t poses : {10, 20}) {
      response.mutable_health()->set_poses(poses * requests.size());
      writer.Write(response);
    }
    return requests.size() == 1 ? Fenced() : grpc::Status::OK;
  };
  std::vector<uint64_t> poses;
  const absl::Status status = client_->WatchHealth("sessions/1", absl::Milliseconds(1500),
                                                   [&](const SessionHealth& health) { poses.push_back(health.poses); });
  EXPECT_TRUE(status.ok()) << status;
  EXPECT_THAT(poses, ElementsAre(10, 20, 20, 40));
  ASSERT_EQ(requests.size(), 2u);
  EXPECT_EQ(requests[0].session(), "sessions/1");
  EXPECT_EQ(requests[0].period().seconds(), 1);
  EXPECT_EQ(requests[0].period().nanos(), 500'000'000);
}

v1::EventImage EmptyImage() {
  v1::EventImage image;
  image.set_cell_px(4);
  image.set_width(5);
  image.set_height(1);
  image.set_encoding(v1::EventImage::ENCODING_PACKED);
  image.set_cells(std::string(2, '\0'));
  return image;
}

TEST_F(WatchTest, ImagesOfEventsAreDeliveredAfterTheFenceAgain) {
  std::vector<v1::WatchEventsRequest> requests;
  service_.watch_events = [&](const v1::WatchEventsRequest& request, auto& writer) {
    requests.push_back(request);
    v1::WatchEventsResponse response;
    *response.mutable_image() = EmptyImage();
    response.mutable_image()->set_num_events(10 * requests.size());
    writer.Write(response);
    return requests.size() == 1 ? Fenced() : grpc::Status::OK;
  };
  std::vector<uint64_t> num_events;
  const absl::Status status =
      client_->WatchEvents("sessions/1", {.cell_px = 4, .max_rate_hz = 12.5},
                           [&](const EventImage& image) { num_events.push_back(image.num_events); });
  EXPECT_TRUE(status.ok()) << status;
  EXPECT_THAT(num_events, ElementsAre(10, 20));
  ASSERT_EQ(requests.size(), 2u);
  for (const v1::WatchEventsRequest& request : requests) {
    EXPECT_EQ(request.session(), "sessions/1");
    EXPECT_EQ(request.cell_px(), 4u);
    EXPECT_EQ(request.max_rate_hz(), 12.5);
  }
}

TEST_F(WatchTest, AServerThatStaysFencedIsAskedAfterGrowingDelays) {
  int num_requests = 0;
  bool responds = false;
  service_.watch_health = [&](const v1::WatchHealthRequest&, auto& writer) {
    if (++num_requests == 7) return grpc::Status::OK;
    if (responds) writer.Write(v1::WatchHealthResponse());
    return Fenced();
  };
  const auto watch = [&] {
    num_requests = 0;
    const absl::Time begin = clock_.Now();
    EXPECT_TRUE(client_->WatchHealth("sessions/1", absl::Seconds(1), [](const SessionHealth&) {}).ok());
    EXPECT_EQ(num_requests, 7);
    return clock_.Now() - begin;
  };
  // Without jitter the delays are 0.1, 0.2, 0.4, 0.8, 1.6 and 3.2 s, 6.3 s together. The jitter shortens each of them
  // by up to a half.
  const absl::Duration without_responses = watch();
  EXPECT_GE(without_responses, absl::Seconds(3.15));
  EXPECT_LE(without_responses, absl::Seconds(6.3));
  // After a response the first delay comes again.
  responds = true;
  const absl::Duration with_responses = watch();
  EXPECT_GE(with_responses, absl::Seconds(0.3));
  EXPECT_LE(with_responses, absl::Seconds(0.6));
}

TEST_F(WatchTest, AStopRequestEndsTheDelay) {
  std::stop_source stop;
  service_.watch_poses = [&](const v1::WatchPosesRequest&, auto&) {
    stop.request_stop();
    return Fenced();
  };
  const absl::Status status = client_->WatchPoses(
      "sessions/1", {}, [](const auto&, uint64_t) {}, stop.get_token());
  EXPECT_EQ(status.code(), absl::StatusCode::kCancelled) << status;
}

TEST_F(WatchTest, ImagesThatCannotBeDeliveredAreErrors) {
  const auto ignore = [](const EventImage&) {};
  service_.watch_events = [](const v1::WatchEventsRequest&, auto& writer) {
    v1::WatchEventsResponse response;
    *response.mutable_image() = EmptyImage();
    response.mutable_image()->set_width(100);
    writer.Write(response);
    return grpc::Status::OK;
  };
  absl::Status status = client_->WatchEvents("sessions/1", {}, ignore);
  EXPECT_EQ(status.code(), absl::StatusCode::kInternal);
  EXPECT_THAT(status.message(), HasSubstr("test server: image: its size and that of its cells contradict each other"));
  service_.watch_events = [](const v1::WatchEventsRequest&, auto&) {
    return WithReason(grpc::StatusCode::FAILED_PRECONDITION, "EVENT_IMAGES_OFF");
  };
  status = client_->WatchEvents("sessions/1", {}, ignore);
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(status.message(), HasSubstr("EVENT_IMAGES_OFF"));
  // The only server of this client does not track the events.
  service_.watch_events = [](const v1::WatchEventsRequest&, auto&) {
    return WithReason(grpc::StatusCode::FAILED_PRECONDITION, "SESSION_NOT_TRACKED_HERE");
  };
  EXPECT_EQ(client_->WatchEvents("sessions/1", {}, ignore).code(), absl::StatusCode::kFailedPrecondition);
  status = client_->WatchEvents("sessions/1", {.cell_px = 3}, ignore);
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(status.message(), HasSubstr("cell_px: is 3"));
}

TEST_F(WatchTest, HealthOfAnUnknownSessionIsAnError) {
  service_.watch_health = [](const v1::WatchHealthRequest&, auto&) {
    return grpc::Status(grpc::StatusCode::NOT_FOUND, "sessions/2: there is no such session");
  };
  const absl::Status status = client_->WatchHealth("sessions/2", absl::Seconds(1), [](const SessionHealth&) {});
  EXPECT_EQ(status.code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(status.message(), "test server: sessions/2: there is no such session");
}

TEST_F(WatchTest, AStopRequestEndsTheStreamOfHealth) {
  service_.watch_health = [](const v1::WatchHealthRequest&, auto& writer) {
    v1::WatchHealthResponse response;
    while (writer.Write(response)) continue;
    return grpc::Status::CANCELLED;
  };
  std::stop_source stop;
  const absl::Status status = client_->WatchHealth(
      "sessions/1", absl::Seconds(1), [&](const SessionHealth&) { stop.request_stop(); }, stop.get_token());
  EXPECT_EQ(status.code(), absl::StatusCode::kCancelled);
}

class ResetTest : public TrackTest {
 protected:
  // A chunk of eight bytes.
  static EventChunk Chunk(uint8_t value) { return {std::vector<uint8_t>(8, value), int64_t{1000} * value}; }

  // Reads all messages up to `end` and acknowledges each of them.
  static grpc::Status ReadAll(ServerStream& stream, std::vector<v1::TrackRequest>& requests) {
    v1::TrackRequest request;
    stream.Read(&request);  // attach
    stream.Write(Attached(1 << 20));
    while (stream.Read(&request) && !request.has_end()) requests.push_back(request);
    stream.Write(SummaryMessage(0));
    return grpc::Status::OK;
  }

  void SetUp() override {
    TrackTest::SetUp();
    service_.script = [this](ServerStream& stream) { return ReadAll(stream, requests_); };
  }

  static std::string Describe(const v1::TrackRequest& request) {
    if (request.has_events()) return "events " + std::to_string(request.events().seq());
    const v1::TrackRequest::ResetPose& reset = request.reset_pose();
    return reset.object_id() + " " + std::to_string(reset.seq()) + " z " +
           std::to_string(static_cast<int>(reset.camera_from_object().translation_m().z()));
  }
  std::vector<std::string> Requests() const {
    std::vector<std::string> texts;
    for (const v1::TrackRequest& request : requests_) texts.push_back(Describe(request));
    return texts;
  }

  std::vector<v1::TrackRequest> requests_;
};

TEST_F(ResetTest, ResetsOfTheSourceAreNumberedWithItsChunks) {
  const ChunkSource source = [next = 0]() mutable -> absl::StatusOr<EventChunk> {
    EventChunk chunk = next < 2 ? Chunk(static_cast<uint8_t>(next)) : EventChunk{};
    if (next == 1) chunk.resets = {ResetAt(2, "a"), ResetAt(3, "b")};
    if (next == 2) chunk.resets = {ResetAt(4, "c")};
    ++next;
    return chunk;
  };
  const auto summary = client_->Track(session_, source, {}, NoRetries());
  ASSERT_TRUE(summary.ok()) << summary.status();
  EXPECT_THAT(Requests(), ElementsAre("events 1", "a 2 z 2", "b 3 z 3", "events 4", "c 5 z 4"));
  EXPECT_EQ(requests_[1].reset_pose().camera_from_object().rotation().w(), 1.0);
  EXPECT_EQ(summary->sent_bytes, 16u);
  EXPECT_EQ(summary->sent_chunks, 5u);
}

TEST_F(ResetTest, AResetOfTheCallerFollowsTheChunksReadBefore) {
  const ChunkSource source = [this, next = 0]() mutable -> absl::StatusOr<EventChunk> {
    if (next == 1) {
      EXPECT_TRUE(client_->ResetPose(session_.name, ResetAt(2)).ok());
    }
    if (next == 2) {
      EXPECT_TRUE(client_->ResetPose(session_.name, ResetAt(3)).ok());
    }
    return next < 2 ? Chunk(static_cast<uint8_t>(next++)) : EventChunk{};
  };
  const auto summary = client_->Track(session_, source, {}, NoRetries());
  ASSERT_TRUE(summary.ok()) << summary.status();
  EXPECT_THAT(Requests(), ElementsAre("events 1", "object 2 z 2", "events 3", "object 4 z 3"));
}

TEST_F(ResetTest, AResetIsSentAgainAfterABrokenStream) {
  FakeClock clock;
  int num_streams = 0;
  service_.script = [&](ServerStream& stream) {
    if (++num_streams == 2) return ReadAll(stream, requests_);
    v1::TrackRequest request;
    stream.Read(&request);
    stream.Write(Attached(1 << 20));
    while (stream.Read(&request) && !request.has_reset_pose()) continue;
    return grpc::Status(grpc::StatusCode::UNAVAILABLE, "connection reset");
  };
  const ChunkSource source = [next = 0]() mutable -> absl::StatusOr<EventChunk> {
    EventChunk chunk = next < 2 ? Chunk(static_cast<uint8_t>(next)) : EventChunk{};
    if (next++ == 1) chunk.resets = {ResetAt(2)};
    return chunk;
  };
  TrackOptions options;
  options.clock = &clock;
  const auto summary = client_->Track(session_, source, {}, options);
  ASSERT_TRUE(summary.ok()) << summary.status();
  EXPECT_EQ(num_streams, 2);
  EXPECT_THAT(Requests(), ElementsAre("events 1", "object 2 z 2", "events 3"));
}

TEST_F(ResetTest, WithoutAStreamThereIsNothingToReset) {
  const absl::Status status = client_->ResetPose("sessions/1", ResetAt(1));
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(status.message(), HasSubstr("sessions/1: no Track() of this session runs in this client"));
}

TEST_F(ResetTest, InvalidResetsAreRefused) {
  PoseReset turned = ResetAt(1);
  turned.camera_from_object.rotation(0, 0) = 2.0;
  PoseReset mirrored = ResetAt(1);
  mirrored.camera_from_object.rotation(0, 0) = -1.0;
  const std::vector<std::pair<PoseReset, std::string>> resets = {
      {ResetAt(1, ""), "object_id"},
      {ResetAt(std::numeric_limits<double>::quiet_NaN()), "must be finite"},
      {turned, "not a rotation"},
      {mirrored, "not a rotation"}};
  const ChunkSource source = [&, next = size_t{0}]() mutable -> absl::StatusOr<EventChunk> {
    for (const auto& [reset, text] : resets) {
      const absl::Status status = client_->ResetPose(session_.name, reset);
      EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
      EXPECT_THAT(status.message(), HasSubstr(text));
    }
    EventChunk chunk = Chunk(0);
    chunk.resets = {resets[2].first};
    return chunk;
  };
  ExpectError(client_->Track(session_, source, {}, NoRetries()), absl::StatusCode::kInvalidArgument, "not a rotation");
}

}  // namespace
}  // namespace evpose::client

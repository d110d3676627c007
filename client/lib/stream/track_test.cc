// SPDX-License-Identifier: Apache-2.0

// The stream against a server with a script for each test. Most scripts violate the API.
#include "evpose/track.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <limits>
#include <stop_token>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/lib/fake_clock_testing.h"
#include "client/lib/stream/scripted_server_testing.h"
#include "core/numerics/hash.h"
#include "evpose/client.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

TEST_F(TrackTest, WholeStream) {
  v1::TrackRequest attach;
  std::vector<v1::TrackRequest::EventChunk> chunks;
  service_.script = [&](ServerStream& stream) {
    stream.Read(&attach);
    stream.Write(Attached(1000));
    chunks = ReadToEnd(stream);
    stream.Write(PoseMessage(1));
    v1::TrackResponse notice;
    notice.mutable_notice()->mutable_decode_fault()->set_count(3);
    stream.Write(notice);
    stream.Write(PoseMessage(2));
    stream.Write(Ack(2, 2000));
    stream.Write(SummaryMessage(2));
    return grpc::Status::OK;
  };
  const auto summary = Track({16, 24});
  ASSERT_TRUE(summary.ok()) << summary.status();
  EXPECT_EQ(attach.attach().session(), "sessions/1");
  EXPECT_EQ(attach.attach().resume_token(), "secret");
  ASSERT_EQ(chunks.size(), 2u);
  EXPECT_EQ(chunks[0].seq(), 1u);
  EXPECT_EQ(chunks[0].payload(), std::string(16, '\0'));
  EXPECT_EQ(chunks[1].seq(), 2u);
  EXPECT_EQ(chunks[1].payload(), std::string(24, '\1'));
  EXPECT_EQ(chunks[1].crc32c(), Crc32c(std::vector<uint8_t>(24, 1)));
  EXPECT_EQ(summary->sent_bytes, 40u);
  EXPECT_EQ(summary->sent_chunks, 2u);
  EXPECT_EQ(summary->poses, 2u);
  ASSERT_EQ(poses_.size(), 2u);
  EXPECT_EQ(poses_[1].t_us, 2000);
  EXPECT_EQ(poses_[1].covariance(0, 1), 1.0);
  EXPECT_EQ(poses_[1].covariance(1, 0), 1.0);
  EXPECT_EQ(poses_[1].covariance(5, 5), 20.0);
  EXPECT_EQ(poses_[1].twist[5], 5.0);
  ASSERT_EQ(notices_.size(), 1u);
  EXPECT_EQ(std::get<DecodeFault>(notices_[0]).count, 3u);
  ASSERT_EQ(progress_.size(), 1u);
  EXPECT_EQ(progress_[0].sent_bytes, 40u);
  EXPECT_EQ(progress_[0].processed_chunks, 2u);
  EXPECT_EQ(progress_[0].poses, 2u);
}

TEST_F(TrackTest, NeverSendsMoreThanItsCredit) {
  service_.script = [&](ServerStream& stream) {
    v1::TrackRequest request;
    stream.Read(&request);
    uint64_t limit = 24;
    stream.Write(Attached(limit));
    uint64_t received = 0;
    while (stream.Read(&request) && !request.has_end()) {
      received += request.events().payload().size();
      if (received > limit) return grpc::Status(grpc::StatusCode::INTERNAL, "more than its credit");
      // A second chunk of 16 bytes exceeds the credit of 24: the client must not send it before this ack.
      limit = received + 24;
      stream.Write(Ack(request.events().seq(), limit));
    }
    stream.Write(SummaryMessage(0));
    return received == 80 ? grpc::Status::OK : grpc::Status(grpc::StatusCode::INTERNAL, "bytes are missing");
  };
  const auto summary = Track({16, 16, 16, 16, 16});
  EXPECT_TRUE(summary.ok()) << summary.status();
}

TEST_F(TrackTest, LargeChunksAreSplitToTheServersLimit) {
  std::vector<size_t> sizes;
  service_.script = [&](ServerStream& stream) {
    v1::TrackRequest request;
    stream.Read(&request);
    stream.Write(Attached(1000, 20));
    for (const v1::TrackRequest::EventChunk& chunk : ReadToEnd(stream)) sizes.push_back(chunk.payload().size());
    stream.Write(SummaryMessage(0));
    return grpc::Status::OK;
  };
  ASSERT_TRUE(Track({40, 8}).ok());
  EXPECT_THAT(sizes, ElementsAre(16, 16, 8, 8));  // whole words of 8
}

TEST_F(TrackTest, PacedBySensorTime) {
  service_.script = [&](ServerStream& stream) {
    v1::TrackRequest request;
    stream.Read(&request);
    stream.Write(Attached(1000));
    ReadToEnd(stream);
    stream.Write(SummaryMessage(0));
    return grpc::Status::OK;
  };
  FakeClock clock;
  const absl::Time begin = clock.Now();
  TrackOptions options;
  options.clock = &clock;
  options.rate = 0.5;
  ASSERT_TRUE(Track({8, 8, 8, 8}, options).ok());
  EXPECT_EQ(clock.Now() - begin, absl::Milliseconds(6));  // 3 ms at half the speed
}

TEST_F(TrackTest, ServerDiesMidStream) {
  service_.script = [&](ServerStream& stream) {
    v1::TrackRequest request;
    stream.Read(&request);
    stream.Write(Attached(16));
    stream.Read(&request);
    stream.Write(PoseMessage(1));
    return grpc::Status(grpc::StatusCode::UNAVAILABLE, "power cut");
  };
  const auto result = Track({16, 16});  // the second chunk waits for credit that never comes
  ExpectError(result, absl::StatusCode::kUnavailable,
              "the stream broke: power cut (after 16 bytes sent, 1 poses received)");
  EXPECT_EQ(poses_.size(), 1u);
}

TEST_F(TrackTest, AServerThatStopsToGrantCreditIsAnOutage) {
  for (const uint64_t credit : {uint64_t{0}, uint64_t{16}}) {
    service_.script = [&](ServerStream& stream) {
      v1::TrackRequest request;
      stream.Read(&request);
      stream.Write(Attached(credit));
      while (stream.Read(&request)) continue;  // until the client cancels the call
      return grpc::Status::CANCELLED;
    };
    TrackOptions options;
    options.retry.max_outage = absl::Milliseconds(20);
    ExpectError(Track({16, 16}, options), absl::StatusCode::kDeadlineExceeded,
                absl::StrCat("the server has granted no credit for 20ms (after ", credit, " bytes sent"));
  }
}

TEST_F(TrackTest, EmptyChunksKeepAQuietStreamAlive) {
  for (const bool has_credit : {true, false}) {
    std::stop_source was_heard;
    bool is_empty = false;
    std::vector<uint64_t> seqs;
    service_.script = [&](ServerStream& stream) {
      v1::TrackRequest request;
      stream.Read(&request);
      v1::TrackResponse attached = Attached(has_credit ? 1000 : 0);
      attached.mutable_attached()->mutable_idle_timeout()->set_nanos(60'000'000);
      stream.Write(attached);
      // The source waits for this message, or the chunk for credit.
      stream.Read(&request);
      is_empty = request.has_events() && request.events().seq() == 0 && request.events().payload().empty();
      was_heard.request_stop();
      stream.Write(Ack(0, 1000));
      for (const v1::TrackRequest::EventChunk& chunk : ReadToEnd(stream)) {
        if (chunk.seq() != 0) seqs.push_back(chunk.seq());
      }
      stream.Write(SummaryMessage(0));
      return grpc::Status::OK;
    };
    const ChunkSource source = [&, chunks = Source({16, 16})]() {
      if (has_credit) SystemClock().SleepUntil(absl::InfiniteFuture(), was_heard.get_token());
      return chunks();
    };
    const auto summary = client_->Track(session_, source, Callbacks(), NoRetries());
    ASSERT_TRUE(summary.ok()) << summary.status();
    EXPECT_TRUE(is_empty);
    EXPECT_THAT(seqs, ElementsAre(1, 2));
  }
}

// The server has chunks that this process has not read yet.
TEST_F(TrackTest, PosesOfEventsOfAnEarlierProcessMayBeLaterThanThoseReadSoFar) {
  service_.script = [](ServerStream& stream) {
    v1::TrackRequest request;
    stream.Read(&request);
    v1::TrackResponse attached = Attached(1000);
    attached.mutable_attached()->set_next_seq(2);
    stream.Write(attached);
    v1::TrackResponse pose = PoseMessage(1);
    pose.mutable_pose()->set_t_us(3'600'000'000);
    stream.Write(pose);
    ReadToEnd(stream);
    stream.Write(SummaryMessage(1));
    return grpc::Status::OK;
  };
  TrackOptions options = NoRetries();
  std::stop_source was_delivered;
  const std::stop_callback at_the_end(options.stop.get_token(), [&] { was_delivered.request_stop(); });
  TrackCallbacks callbacks = Callbacks();
  callbacks.on_pose = [&](const Pose&) { was_delivered.request_stop(); };
  const ChunkSource source = [&, chunks = Source({16, 16})]() {
    SystemClock().SleepUntil(absl::InfiniteFuture(), was_delivered.get_token());
    return chunks();
  };
  const auto summary = client_->Track(session_, source, callbacks, options);
  EXPECT_TRUE(summary.ok()) << summary.status();
}

TEST_F(TrackTest, RefusedAttach) {
  service_.script = [&](ServerStream&) { return grpc::Status(grpc::StatusCode::NOT_FOUND, "no such session"); };
  ExpectError(Track({16}), absl::StatusCode::kNotFound, "no such session (after 0 bytes sent");
}

TEST_F(TrackTest, ServerThatDoesNotRespond) {
  service_.script = [&](ServerStream& stream) {
    v1::TrackRequest request;
    while (stream.Read(&request)) continue;  // until the client cancels the call
    return grpc::Status::CANCELLED;
  };
  TrackOptions options = NoRetries();
  options.attach_timeout = absl::Milliseconds(20);
  ExpectError(Track({16}, options), absl::StatusCode::kDeadlineExceeded, "no response to `attach` within 20ms");
}

TEST_F(TrackTest, SourceThatFailsCancelsTheStream) {
  service_.script = [&](ServerStream& stream) {
    v1::TrackRequest request;
    stream.Read(&request);
    stream.Write(Attached(1000));
    EXPECT_TRUE(ReadToEnd(stream).empty());
    return grpc::Status::CANCELLED;
  };
  const ChunkSource source = []() -> absl::StatusOr<EventChunk> { return absl::DataLossError("disk gone"); };
  ExpectError(client_->Track(session_, source, {}, NoRetries()), absl::StatusCode::kDataLoss, "disk gone");
}

TEST_F(TrackTest, CallerCancels) {
  TrackOptions options;
  service_.script = [&](ServerStream& stream) {
    v1::TrackRequest request;
    stream.Read(&request);
    stream.Write(Attached(8));
    stream.Read(&request);
    options.stop.request_stop();
    while (stream.Read(&request)) continue;
    return grpc::Status::OK;
  };
  ExpectError(Track({8, 8}, options), absl::StatusCode::kCancelled, "cancelled (after 8 bytes sent");
}

TEST_F(TrackTest, EndOfTheStreamReleasesAWaitingSource) {
  service_.script = [&](ServerStream& stream) {
    v1::TrackRequest request;
    stream.Read(&request);
    stream.Write(Attached(1000));
    return grpc::Status(grpc::StatusCode::ABORTED, "fenced");
  };
  TrackOptions options = NoRetries();
  const ChunkSource source = [&options]() -> absl::StatusOr<EventChunk> {
    SystemClock().SleepUntil(absl::InfiniteFuture(), options.stop.get_token());  // a camera without events
    return EventChunk{};
  };
  ExpectError(client_->Track(session_, source, {}, options), absl::StatusCode::kAborted, "fenced");
}

TEST_F(TrackTest, APoseInAnUnknownStateIsCountedAndNotDelivered) {
  service_.script = [](ServerStream& stream) {
    v1::TrackRequest request;
    stream.Read(&request);
    stream.Write(Attached(1000));
    ReadToEnd(stream);
    v1::TrackResponse of_later_server = PoseMessage(1);
    of_later_server.mutable_pose()->set_state(static_cast<v1::TrackState>(99));
    stream.Write(of_later_server);
    stream.Write(PoseMessage(2));
    stream.Write(Ack(1, 2000));
    stream.Write(SummaryMessage(2));
    return grpc::Status::OK;
  };
  const auto summary = Track({16});
  ASSERT_TRUE(summary.ok()) << summary.status();
  ASSERT_EQ(poses_.size(), 1u);
  EXPECT_EQ(poses_[0].seq, 2u);
}

// Sequences of messages that violate the API, with a part of the error that the client reports.
struct Misbehaviour {
  const char* name;
  std::vector<v1::TrackResponse> responses;
  const char* message;
};
class MalformedServerTest : public TrackTest, public ::testing::WithParamInterface<Misbehaviour> {};

TEST_P(MalformedServerTest, IsAnErrorThatNamesTheViolation) {
  service_.script = [&](ServerStream& stream) {
    v1::TrackRequest request;
    stream.Read(&request);
    for (const v1::TrackResponse& response : GetParam().responses) stream.Write(response);
    ReadToEnd(stream);
    return grpc::Status::OK;
  };
  ExpectError(Track({16}), absl::StatusCode::kInternal, GetParam().message);
}

v1::TrackResponse BadPose(const std::function<void(v1::Pose&)>& spoil) {
  v1::TrackResponse response = PoseMessage(1);
  spoil(*response.mutable_pose());
  return response;
}

v1::TrackResponse PoseAt(uint64_t seq, int64_t t_us) {
  v1::TrackResponse response = PoseMessage(seq);
  response.mutable_pose()->set_t_us(t_us);
  return response;
}

v1::TrackResponse AttachedWithNext(uint64_t next_seq) {
  v1::TrackResponse response = Attached(1000);
  response.mutable_attached()->set_next_seq(next_seq);
  return response;
}

v1::TrackResponse DurableAck(uint64_t processed_seq, uint64_t durable_seq) {
  v1::TrackResponse response = Ack(processed_seq, 1000);
  response.mutable_ack()->set_durable_seq(durable_seq);
  return response;
}

INSTANTIATE_TEST_SUITE_P(
    All, MalformedServerTest,
    ::testing::Values(
        Misbehaviour{"NoAttached", {Ack(0, 8)}, "its first message is not `attached`"},
        Misbehaviour{"NoRoom", {Attached(1000, 7)}, "no room for a single word"},
        Misbehaviour{"AttachedTwice", {Attached(1000), Attached(1000)}, "`attached` twice"},
        Misbehaviour{"PoseGap", {Attached(1000), PoseMessage(2)}, "pose 2 arrived instead of pose 1"},
        Misbehaviour{"PoseTwice", {Attached(1000), PoseMessage(1), PoseMessage(1)}, "pose 1 arrived instead of pose 2"},
        Misbehaviour{"ShortCovariance",
                     {Attached(1000), BadPose([](v1::Pose& pose) {
                        pose.mutable_covariance()->mutable_upper_triangle()->RemoveLast();
                      })},
                     "covariance does not have 21 numbers"},
        Misbehaviour{
            "NoTwist", {Attached(1000), BadPose([](v1::Pose& pose) { pose.clear_twist(); })}, "twist is missing"},
        Misbehaviour{"PoseWhileLost",
                     {Attached(1000), BadPose([](v1::Pose& pose) { pose.set_state(v1::TRACK_STATE_LOST); })},
                     "the state LOST has no pose"},
        Misbehaviour{
            "NoRotation",
            {Attached(1000), BadPose([](v1::Pose& pose) { pose.mutable_camera_from_object()->clear_rotation(); })},
            "camera_from_object"},
        Misbehaviour{"PoseOfAnotherObject",
                     {Attached(1000), BadPose([](v1::Pose& pose) { pose.set_object_id("../\x1b"); })},
                     "pose 1: the session has no object \"../\\x1b\""},
        Misbehaviour{"PoseThatGoesBack", {Attached(1000), PoseMessage(1), PoseAt(2, 1000)}, "is not after 1000 us"},
        Misbehaviour{"PoseBeforeAllTimes", {Attached(1000), PoseAt(1, -1)}, "its time, -1 us, is not one of the"},
        Misbehaviour{"PoseAfterTheEvents", {Attached(1000), PoseAt(1, 2'000'000)}, "is not one of the events"},
        Misbehaviour{
            "PoseAfterAllTimes", {Attached(1000), PoseAt(1, std::numeric_limits<int64_t>::max())}, "is not one of the"},
        Misbehaviour{"AckOfAChunkThatWasNotSent",
                     {Attached(1000), Ack(2, 1000)},
                     "it acknowledges chunk 2, but the last one sent is"},
        Misbehaviour{"DurableBeforeProcessed",
                     {AttachedWithNext(2), DurableAck(0, 1)},
                     "it has stored chunk 1, but processed only those up to 0"},
        Misbehaviour{"NoSummary", {Attached(1000)}, "ended without a summary"},
        Misbehaviour{"SummaryOfOthers", {Attached(1000), SummaryMessage(5)}, "the summary counts 5 poses"},
        Misbehaviour{"AfterSummary", {Attached(1000), SummaryMessage(0), PoseMessage(1)}, "follows the summary"}),
    [](const auto& test) { return std::string(test.param.name); });

}  // namespace
}  // namespace evpose::client

// SPDX-License-Identifier: Apache-2.0

// Tests SessionService.Track through a raw stub.
#include <thread>

#include "core/base/byte_order.h"
#include "core/base/poll_testing.h"
#include "core/numerics/hash.h"
#include "server/rpc/server_testing.h"

namespace evpose::server {
namespace {

using Kind = v1::TrackResponse;

uint32_t CrcOf(const std::string& payload) { return Crc32c(AsBytes(payload)); }

class TrackTest : public RpcTest {
 protected:
  // Sends `events` in chunks of this size and `end`. Returns all poses, without the fields that depend on the clock.
  std::string PosesOf(const std::vector<Event>& events, size_t chunk_bytes) {
    const std::string bytes = Flat64(events);
    const CreatedSession session = CreateSession();
    const auto track = Attached(session);
    std::string poses;
    uint64_t seq = 0;
    v1::TrackResponse response;
    for (size_t begin = 0; begin < bytes.size(); begin += chunk_bytes) {
      EXPECT_TRUE(track->Events(++seq, bytes.substr(begin, chunk_bytes)));
      bool is_acked = false;
      while (!is_acked && track->Read(response)) {
        AppendPose(response, poses);
        is_acked = response.ack().processed_seq() == seq;
      }
    }
    track->End();
    while (track->Read(response)) AppendPose(response, poses);
    EXPECT_EQ(Describe(track->Finish()), "OK");
    Delete(session.name());
    return poses;
  }
  static void AppendPose(v1::TrackResponse& response, std::string& poses) {
    if (!response.has_pose()) return;
    response.mutable_pose()->clear_latency();
    poses += response.pose().SerializeAsString();
  }

  // Starts a server with a log of 4096 poses, and creates a session with three objects.
  CreatedSession ThreeObjectsAndASmallLog(v1::OverloadPolicy policy) {
    ServerOptions options = Options();
    options.pose_log_capacity = 4096;
    Connect(options);
    v1::CreateSessionRequest request = CreateRequest();
    v1::SessionConfig& config = *request.mutable_config();
    config.set_overload_policy(policy);
    if (policy == v1::OVERLOAD_POLICY_LATEST) config.mutable_max_lag()->set_seconds(10);
    for (int i = 1; i < 3; ++i) {
      *config.add_objects() = config.objects(0);
      config.mutable_objects(i)->set_object_id(absl::StrCat("cube", i));
    }
    CreatedSession session;
    EXPECT_EQ(Describe(Create(request, &session)), "OK");
    return session;
  }
  // A chunk that produces 6141 poses, more than the log holds; three more follow at the end of the session.
  static std::string ManyPoses() { return Flat64(SomeEvents(1, 2049, 1)); }
  // Expects the poses with these numbers, each once and in order.
  static void ExpectPoses(RawTrack& track, uint64_t first, uint64_t last) {
    v1::TrackResponse response;
    for (uint64_t seq = first; seq <= last; ++seq) {
      ASSERT_TRUE(track.ReadUntil(Kind::kPose, response)) << seq << ": " << Describe(track.Finish());
      ASSERT_EQ(response.pose().pose_seq(), seq);
    }
  }
};

TEST_F(TrackTest, GivesPosesAcksAndASummary) {
  const CreatedSession session = CreateSession();
  v1::TrackResponse::Attached attached;
  const auto track = Attached(session, &attached);
  EXPECT_EQ(attached.next_seq(), 1u);
  EXPECT_EQ(attached.send_limit_bytes(), 256u * 1024);
  EXPECT_EQ(attached.max_chunk_bytes(), 64u * 1024);
  EXPECT_EQ(attached.resume_window().seconds(), 600);
  EXPECT_EQ(attached.first_pose_seq(), 1u);
  EXPECT_NE(attached.resume_token(), session.resume_token());
  CreatedSession seen;
  Get(session.name(), &seen);
  EXPECT_EQ(seen.state(), v1::SESSION_STATE_ATTACHED);
  EXPECT_FALSE(seen.session().has_expire_time());

  const std::string payload = Flat64(SomeEvents(1, 11));
  ASSERT_TRUE(track->Events(1, payload));
  v1::TrackResponse response;
  std::vector<v1::TrackResponse> before;
  ASSERT_TRUE(track->ReadUntil(Kind::kAck, response, &before));
  EXPECT_EQ(response.ack().processed_seq(), 1u);
  EXPECT_EQ(response.ack().durable_seq(), 1u);
  EXPECT_EQ(response.ack().send_limit_bytes(), uint64_t{256} * 1024 + payload.size());
  ASSERT_EQ(before.size(), 9u) << "the poses of a chunk come before its ack";
  const v1::Pose& pose = before[0].pose();
  EXPECT_EQ(pose.pose_seq(), 1u);
  EXPECT_EQ(pose.object_id(), "cube");
  EXPECT_EQ(pose.t_us(), 1500);
  EXPECT_EQ(pose.camera_from_object().translation_m().x(), 3.0);
  EXPECT_EQ(pose.camera_from_object().rotation().w(), 1.0);
  ASSERT_EQ(pose.covariance().upper_triangle_size(), 21);
  EXPECT_EQ(pose.covariance().upper_triangle(1), 1.0) << "row 0, column 1";
  EXPECT_EQ(pose.covariance().upper_triangle(6), 11.0) << "row 1, column 1";
  EXPECT_EQ(pose.covariance().upper_triangle(20), 55.0);
  const auto& [linear, angular] = std::pair(pose.twist().linear_m_per_s(), pose.twist().angular_rad_per_s());
  EXPECT_THAT((std::vector{linear.x(), linear.y(), linear.z(), angular.x(), angular.y(), angular.z()}),
              testing::ElementsAre(1, 2, 3, 4, 5, 6));
  EXPECT_EQ(pose.state(), v1::TRACK_STATE_TRACKING);
  EXPECT_EQ(pose.num_events(), 3u);
  EXPECT_TRUE(pose.has_latency());

  ASSERT_TRUE(track->End());
  ASSERT_TRUE(track->ReadUntil(Kind::kSummary, response));
  const v1::SessionHealth& health = response.summary().health();
  EXPECT_EQ(health.poses(), 10u);
  EXPECT_EQ(health.decoded_events(), 30u);
  EXPECT_EQ(health.received_bytes(), payload.size());
  EXPECT_EQ(health.t_us(), 10'600);
  EXPECT_NEAR(health.event_rate_hz(), 30 / 9.6e-3, 1e-6);
  EXPECT_EQ(health.objects(0).object_id(), "cube");
  EXPECT_FALSE(track->Read(response)) << "the summary is the last message";
  EXPECT_EQ(Describe(track->Finish()), "OK");
  Get(session.name(), &seen);
  EXPECT_EQ(seen.state(), v1::SESSION_STATE_ENDED);
}

TEST_F(TrackTest, PosesAreTheSameBytesWhateverTheChunkingAndTheChannel) {
  ServerOptions options = Options();
  options.listen_address = "127.0.0.1:0";
  Connect(options);
  const std::vector<Event> events = SomeEvents(1, 3000);
  const std::string poses = PosesOf(events, size_t{64} * 1024);
  EXPECT_FALSE(poses.empty());
  EXPECT_EQ(PosesOf(events, 1000), poses);
  Use(grpc::CreateChannel(absl::StrCat("127.0.0.1:", server_->port()), grpc::InsecureChannelCredentials()));
  EXPECT_EQ(PosesOf(events, size_t{64} * 1024), poses);
  EXPECT_EQ(PosesOf(events, 4096), poses);
}

TEST_F(TrackTest, RejectsViolationsOfTheProtocol) {
  const CreatedSession session = CreateSession();
  const auto first_message = [this](const v1::TrackRequest& request) {
    RawTrack track(*sessions_);
    track.Write(request);
    return Describe(track.Finish());
  };
  v1::TrackRequest request;
  EXPECT_EQ(first_message(request), "INVALID_ARGUMENT message");
  request.mutable_end();
  EXPECT_EQ(first_message(request), "INVALID_ARGUMENT attach");
  request.mutable_events()->set_seq(1);
  EXPECT_EQ(first_message(request), "INVALID_ARGUMENT attach");
  request.mutable_attach()->set_session("sessions/none");
  EXPECT_EQ(first_message(request), "NOT_FOUND SESSION_NOT_FOUND");
  request.mutable_attach()->set_session(session.name());
  request.mutable_attach()->set_resume_token("guess");
  EXPECT_EQ(first_message(request), "PERMISSION_DENIED WRONG_TOKEN");
  request.mutable_attach()->set_resume_token(session.resume_token());
  request.mutable_attach()->set_last_pose_seq(1);
  EXPECT_EQ(first_message(request), "INVALID_ARGUMENT attach.last_pose_seq");
  RawTrack nothing(*sessions_);
  nothing.WritesDone();
  EXPECT_EQ(Describe(nothing.Finish()), "INVALID_ARGUMENT attach");
}

TEST_F(TrackTest, RefusesBadMessagesAndTheSessionContinues) {
  CreatedSession session = CreateSession();
  std::vector<std::pair<std::string, v1::TrackRequest>> cases;
  const auto add = [&cases](const std::string& expected) -> v1::TrackRequest& {
    return cases.emplace_back(expected, v1::TrackRequest()).second;
  };
  add("INVALID_ARGUMENT message");
  add("INVALID_ARGUMENT attach").mutable_attach()->set_session(session.name());
  add("INVALID_ARGUMENT events.seq").mutable_events()->set_payload(Flat64(SomeEvents(1, 2)));
  v1::TrackRequest::EventChunk* events = add("INVALID_ARGUMENT events.payload").mutable_events();
  events->set_seq(1);
  events->set_payload("not whole words");
  events = add("INVALID_ARGUMENT events.payload").mutable_events();
  events->set_seq(1);
  events->set_payload(std::string(64 * 1024 + 8, '\0'));
  events = add("DATA_LOSS CRC_MISMATCH").mutable_events();
  events->set_seq(1);
  events->set_crc32c(7);
  events->set_payload(Flat64(SomeEvents(1, 2)));
  events = add("FAILED_PRECONDITION SEQ_GAP").mutable_events();
  events->set_seq(2);
  v1::TrackRequest::ResetPose* reset =
      add("INVALID_ARGUMENT reset_pose.camera_from_object.rotation").mutable_reset_pose();
  reset->set_object_id("cube");
  reset->mutable_camera_from_object()->mutable_rotation()->set_w(2.0);
  const auto add_reset = [&add](const std::string& expected, uint64_t seq, const std::string& object_id) {
    v1::TrackRequest::ResetPose& added = *add(expected).mutable_reset_pose();
    added.set_seq(seq);
    added.set_object_id(object_id);
    added.mutable_camera_from_object()->mutable_rotation()->set_w(1.0);
  };
  add_reset("INVALID_ARGUMENT reset_pose.object_id", 1, "cone");
  add_reset("INVALID_ARGUMENT reset_pose.seq", 0, "cube");
  add_reset("FAILED_PRECONDITION SEQ_GAP", 2, "cube");

  for (const auto& [expected, request] : cases) {
    v1::TrackResponse::Attached attached;
    const auto track = Attached(session, &attached);
    EXPECT_EQ(attached.next_seq(), 1u) << expected;
    session.set_resume_token(attached.resume_token());
    ASSERT_TRUE(track->Write(request));
    const grpc::Status status = track->Finish();
    EXPECT_EQ(Describe(status), expected) << status.error_message();
    if (expected == "FAILED_PRECONDITION SEQ_GAP") {
      const auto info = DetailOf<google::rpc::ErrorInfo>(status);
      EXPECT_EQ(info.metadata().at("expected_seq"), "1");
      EXPECT_EQ(info.metadata().at("seq"), "2");
    }
    if (expected == "DATA_LOSS CRC_MISMATCH") {
      EXPECT_EQ(DetailOf<google::rpc::ErrorInfo>(status).metadata().at("seq"), "1");
    }
  }
  const auto track = Attached(session);
  track->Events(1, Flat64(SomeEvents(1, 4)));
  track->End();
  v1::TrackResponse response;
  EXPECT_TRUE(track->ReadUntil(Kind::kSummary, response));
  EXPECT_EQ(response.summary().health().reattaches(), cases.size());
}

TEST_F(TrackTest, AnOversizedMessageIsRefusedByTheTransport) {
  const auto track = Attached(CreateSession());
  track->Events(1, std::string(1u << 20, '\0'));
  EXPECT_EQ(Describe(track->Finish()), "RESOURCE_EXHAUSTED");
}

TEST_F(TrackTest, IgnoresRepeatedChunksAndTakesADigestThatIsRight) {
  const auto track = Attached(CreateSession());
  v1::TrackRequest request;
  request.mutable_events()->set_seq(1);
  request.mutable_events()->set_payload(Flat64(SomeEvents(1, 3)));
  request.mutable_events()->set_crc32c(CrcOf(request.events().payload()));
  v1::TrackResponse response;
  for (uint64_t repetition = 1; repetition <= 3; ++repetition) {
    ASSERT_TRUE(track->Write(request));
    const uint64_t wanted = uint64_t{256} * 1024 + repetition * request.events().payload().size();
    do {
      ASSERT_TRUE(track->ReadUntil(Kind::kAck, response));
    } while (response.ack().send_limit_bytes() < wanted);
    EXPECT_EQ(response.ack().processed_seq(), 1u);
  }
  track->End();
  ASSERT_TRUE(track->ReadUntil(Kind::kSummary, response));
  EXPECT_EQ(response.summary().health().decoded_events(), 6u);
}

TEST_F(TrackTest, ResumesABrokenStreamWithoutLosingOrRepeatingAPose) {
  CreatedSession session = CreateSession();
  v1::TrackResponse response;
  v1::TrackResponse::Attached attached;
  {
    const auto track = Attached(session, &attached);
    track->Events(1, Flat64(SomeEvents(1, 11)));
    for (int i = 0; i < 4; ++i) ASSERT_TRUE(track->ReadUntil(Kind::kPose, response));
    EXPECT_EQ(response.pose().pose_seq(), 4u);
    track->Cancel();
    EXPECT_EQ(Describe(track->Finish()), "CANCELLED");
  }
  RawTrack track(*sessions_);
  track.Attach(session.name(), attached.resume_token(), 4);
  ASSERT_TRUE(track.Read(response));
  EXPECT_EQ(response.attached().next_seq(), 2u);
  EXPECT_EQ(response.attached().first_pose_seq(), 5u);
  track.Events(2, Flat64(SomeEvents(11, 21)));
  track.End();
  uint64_t expected = 5;
  while (track.Read(response)) {
    if (!response.has_pose()) continue;
    EXPECT_EQ(response.pose().pose_seq(), expected++);
  }
  EXPECT_EQ(expected, 21u);
  EXPECT_EQ(Describe(track.Finish()), "OK");
}

TEST_F(TrackTest, AStreamWithBlockGetsMorePosesAtOnceThanTheLogHolds) {
  const auto track = Attached(ThreeObjectsAndASmallLog(v1::OVERLOAD_POLICY_BLOCK));
  ASSERT_TRUE(track->Events(1, ManyPoses()));
  ASSERT_TRUE(track->End());
  ExpectPoses(*track, 1, 6144);
  v1::TrackResponse response;
  ASSERT_TRUE(track->ReadUntil(Kind::kSummary, response));
  EXPECT_EQ(response.summary().health().poses(), 6144u);
  EXPECT_EQ(Describe(track->Finish()), "OK");
}

TEST_F(TrackTest, AClientThatAttachesBeforePosesAreComputedReceivesThem) {
  CreatedSession session = ThreeObjectsAndASmallLog(v1::OVERLOAD_POLICY_BLOCK);
  v1::TrackResponse::Attached attached;
  gate_->Close();
  {
    const auto track = Attached(session, &attached);
    ASSERT_TRUE(track->Events(1, ManyPoses()));
    CreatedSession seen;
    ASSERT_TRUE(Poll([&] {
      Get(session.name(), &seen);
      return seen.health().received_bytes() > 0;
    }));
    track->Cancel();
    EXPECT_EQ(Describe(track->Finish()), "CANCELLED");
  }
  session.set_resume_token(attached.resume_token());
  const auto track = Attached(session, &attached);
  EXPECT_EQ(attached.first_pose_seq(), 1u);
  gate_->Open();
  ExpectPoses(*track, 1, 6141);
}

TEST_F(TrackTest, WithLatestAStreamIsNotifiedOfDeletedPoses) {
  CreatedSession session = ThreeObjectsAndASmallLog(v1::OVERLOAD_POLICY_LATEST);
  v1::TrackResponse::Attached attached;
  {
    const auto track = Attached(session, &attached);
    ASSERT_TRUE(track->Events(1, ManyPoses()));
    const grpc::Status status = track->Finish();
    EXPECT_EQ(Describe(status), "ABORTED POSES_EXPIRED");
    EXPECT_THAT(status.error_message(), testing::HasSubstr("pose 1 is no longer stored"));
  }
  session.set_resume_token(attached.resume_token());
  const auto track = Attached(session, &attached);
  EXPECT_EQ(attached.next_seq(), 2u);
  EXPECT_EQ(attached.first_pose_seq(), 6141u - 4096 + 1) << "the poses continue after the gap";
  ExpectPoses(*track, attached.first_pose_seq(), 6141);
}

TEST_F(TrackTest, ALaterAttachFencesTheOlderStream) {
  CreatedSession session = CreateSession();
  v1::TrackResponse::Attached attached;
  const auto older = Attached(session, &attached);
  session.set_resume_token(attached.resume_token());
  const auto newer = Attached(session, &attached);
  EXPECT_EQ(Describe(older->Finish()), "ABORTED FENCED");
  newer->Events(1, Flat64(SomeEvents(1, 2)));
  v1::TrackResponse response;
  EXPECT_TRUE(newer->ReadUntil(Kind::kAck, response));
}

TEST_F(TrackTest, NoticesAndPosesAreInOrder) {
  v1::CreateSessionRequest request = CreateRequest();
  request.mutable_config()->mutable_objects(0)->clear_initial_camera_from_object();
  CreatedSession session;
  ASSERT_EQ(Describe(Create(request, &session)), "OK");
  const auto track = Attached(session);
  std::vector<Event> events = SomeEvents(1, 3);
  events.push_back({2900, 4000, 1, 0});  // outside the sensor
  track->Events(1, Flat64(events));
  v1::TrackRequest reset;
  reset.mutable_reset_pose()->set_seq(2);
  reset.mutable_reset_pose()->set_object_id("cube");
  reset.mutable_reset_pose()->mutable_camera_from_object()->mutable_rotation()->set_w(1.0);
  track->Write(reset);
  events = SomeEvents(3, 5);
  events.push_back({5100, 0, 0, 1});  // lost
  events.push_back({6100, 9, 9, 1});
  track->Write(reset);  // a repetition is ignored; otherwise the object would be found again below
  track->Events(3, Flat64(events));
  track->Write(reset);
  track->End();
  std::vector<std::string> seen;
  v1::TrackResponse response;
  while (track->Read(response)) {
    if (response.has_pose()) seen.push_back(absl::StrCat("pose ", response.pose().t_us()));
    if (response.notice().has_decode_fault()) {
      seen.push_back(absl::StrCat("fault in ", response.notice().decode_fault().seq()));
    }
    if (response.notice().has_state_change()) {
      const auto& change = response.notice().state_change();
      seen.push_back(absl::StrCat(change.object_id(), " ", v1::TrackState_Name(change.state()), " ", change.t_us()));
    }
  }
  EXPECT_THAT(seen, testing::ElementsAre("fault in 1", "cube TRACK_STATE_TRACKING 3000", "pose 2500", "pose 3500",
                                         "pose 4500", "cube TRACK_STATE_LOST 6000"));
}

TEST_F(TrackTest, ModelsAndSessionsAreCreatedWhileAllWorkersTrack) {
  std::vector<std::unique_ptr<RawTrack>> busy;
  gate_->Close();
  for (int i = 0; i < Options().worker_threads; ++i) {
    CreatedSession session = CreateSession();
    busy.push_back(Attached(session));
    ASSERT_TRUE(busy.back()->Events(1, Flat64(SomeEvents(1, 11))));
    ASSERT_TRUE(Poll([&] {
      Get(session.name(), &session);
      return session.health().received_bytes() > 0;
    }));
  }
  CreateSession();  // also uploads a model
  gate_->Open();
}

TEST_F(TrackTest, DroppedEventsAreReportedEquallyEverywhere) {
  CreatedSession session;
  uint64_t sent_bytes = 0;
  const auto track = OverloadedLatest(&session, &sent_bytes);
  v1::TrackResponse response;
  while (response.ack().send_limit_bytes() < sent_bytes + uint64_t{256} * 1024) {
    ASSERT_TRUE(track->ReadUntil(Kind::kAck, response)) << "credit is granted although no events are tracked";
  }
  gate_->Open();
  ASSERT_TRUE(track->End());
  uint64_t dropped = 0;
  std::vector<v1::TrackResponse> before;
  ASSERT_TRUE(track->ReadUntil(Kind::kSummary, response, &before));
  for (const v1::TrackResponse& message : before) {
    if (!message.notice().has_dropped()) continue;
    dropped += message.notice().dropped().num_events();
    EXPECT_EQ(message.notice().dropped().reason(), v1::DROP_REASON_MEMORY);
    EXPECT_GT(message.notice().dropped().to_t_us(), message.notice().dropped().from_t_us());
  }
  EXPECT_GT(dropped, 0u);
  EXPECT_EQ(response.summary().health().skipped_events(), dropped);
  EXPECT_GT(response.summary().health().skipped_us(), 0);
  EXPECT_EQ(response.summary().health().decoded_events() * 8, sent_bytes);
  Delete(session.name());
  grpc::ClientContext context;
  v1::ServerInfo info;
  ASSERT_TRUE(admin_->GetServerInfo(&context, {}, &info).ok());
  EXPECT_EQ(info.skipped_events(), dropped);
}

}  // namespace
}  // namespace evpose::server

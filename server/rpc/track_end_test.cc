// SPDX-License-Identifier: Apache-2.0

// Tests the ends of the stream SessionService.Track through a raw stub.
#include <thread>

#include "server/rpc/server_testing.h"

namespace evpose::server {
namespace {

using Kind = v1::TrackResponse;

class TrackEndTest : public RpcTest {};

TEST_F(TrackEndTest, AfterTheEndOnlyTheSummaryIsSentAgain) {
  CreatedSession session = CreateSession();
  v1::TrackResponse response;
  for (int i = 0; i < 2; ++i) {
    v1::TrackResponse::Attached attached;
    const auto track = Attached(session, &attached);
    session.set_resume_token(attached.resume_token());
    if (i == 0) track->Events(1, Flat64(SomeEvents(1, 11)));
    track->End();
    std::vector<v1::TrackResponse> before;
    ASSERT_TRUE(track->ReadUntil(Kind::kSummary, response, &before));
    EXPECT_EQ(response.summary().health().poses(), 10u);
    EXPECT_EQ(std::count_if(before.begin(), before.end(), [](const auto& message) { return message.has_pose(); }), 10);
  }
  v1::TrackRequest more[2];
  more[0].mutable_events()->set_seq(2);
  more[1].mutable_reset_pose()->set_seq(2);
  more[1].mutable_reset_pose()->set_object_id("cube");
  more[1].mutable_reset_pose()->mutable_camera_from_object()->mutable_rotation()->set_w(1.0);
  for (const v1::TrackRequest& request : more) {
    v1::TrackResponse::Attached attached;
    const auto track = Attached(session, &attached);
    session.set_resume_token(attached.resume_token());
    EXPECT_TRUE(track->Write(request));
    EXPECT_EQ(Describe(track->Finish()), "FAILED_PRECONDITION SESSION_ENDED");
  }
}

TEST_F(TrackEndTest, HalfCloseWithoutEndDrainsAndLeavesTheSession) {
  const CreatedSession session = CreateSession();
  const auto track = Attached(session);
  track->Events(1, Flat64(SomeEvents(1, 11)));
  track->WritesDone();
  v1::TrackResponse response;
  int poses = 0;
  while (track->Read(response)) poses += response.has_pose();
  EXPECT_EQ(poses, 9);
  EXPECT_EQ(Describe(track->Finish()), "OK");
  CreatedSession seen;
  Get(session.name(), &seen);
  EXPECT_EQ(seen.state(), v1::SESSION_STATE_DETACHED);
}

TEST_F(TrackEndTest, DeletingASessionEndsItsStreams) {
  const CreatedSession session = CreateSession();
  const auto track = Attached(session);
  track->Events(1, Flat64(SomeEvents(1, 11)));
  v1::TrackResponse response;
  ASSERT_TRUE(track->ReadUntil(Kind::kAck, response));
  grpc::ClientContext watch_context;
  v1::WatchPosesRequest watch;
  watch.set_session(session.name());
  const auto watcher = sessions_->WatchPoses(&watch_context, watch);
  v1::WatchPosesResponse poses;
  ASSERT_TRUE(watcher->Read(&poses));
  Delete(session.name());
  EXPECT_EQ(Describe(track->Finish()), "NOT_FOUND SESSION_DELETED");
  while (watcher->Read(&poses)) continue;
  EXPECT_EQ(Describe(watcher->Finish()), "NOT_FOUND SESSION_DELETED");
}

TEST_F(TrackEndTest, ACancelledStreamLeavesTheSessionDetached) {
  const CreatedSession session = CreateSession();
  v1::TrackResponse::Attached attached;
  const auto track = Attached(session, &attached);
  gate_->Close();
  track->Events(1, Flat64(SomeEvents(1, 11)));
  track->Cancel();
  EXPECT_EQ(Describe(track->Finish()), "CANCELLED");
  gate_->Open();
  RawTrack next(*sessions_);
  next.Attach(session.name(), attached.resume_token());
  v1::TrackResponse response;
  EXPECT_TRUE(next.Read(response)) << "the session can be resumed";
}

TEST_F(TrackEndTest, AServerThatShutsDownNotifiesItsStreamsAndLetsThemFinish) {
  ConnectThroughSocket(Options());
  const CreatedSession session = CreateSession();
  const auto track = Attached(session);
  const CreatedSession other = CreateSession();
  const auto silent = Attached(other);
  const v1::CreateSessionRequest request = CreateRequest();
  std::thread shutdown([this] { server_->Shutdown(absl::Seconds(4)); });
  v1::TrackResponse response;
  ASSERT_TRUE(track->ReadUntil(Kind::kNotice, response));
  EXPECT_TRUE(response.notice().has_go_away());
  CreatedSession refused;
  EXPECT_EQ(Describe(Create(request, &refused)), "UNAVAILABLE DRAINING");
  track->Events(1, Flat64(SomeEvents(1, 11)));
  track->End();
  ASSERT_TRUE(track->ReadUntil(Kind::kSummary, response));
  EXPECT_EQ(response.summary().health().poses(), 10u);
  EXPECT_EQ(Describe(track->Finish()), "OK");
  EXPECT_EQ(Describe(silent->Finish()), "UNAVAILABLE DRAINING") << "a stream that is open at the deadline is ended";
  shutdown.join();
}

TEST_F(TrackEndTest, ShutdownDoesNotWaitForAClientThatReadsNothing) {
  const CreatedSession session = CreateSession();
  const auto track = Attached(session);
  for (uint64_t seq = 1; seq <= 20; ++seq) {
    const auto begin_ms = static_cast<int64_t>(100 * seq);
    ASSERT_TRUE(track->Events(seq, Flat64(SomeEvents(begin_ms, begin_ms + 100))));
  }
  server_->Shutdown(absl::ZeroDuration());
  EXPECT_FALSE(track->Finish().ok());
}

}  // namespace
}  // namespace evpose::server

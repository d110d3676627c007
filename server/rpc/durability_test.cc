// SPDX-License-Identifier: Apache-2.0

// Tests, through raw stubs, of the end of a stream with a slow store, and of sessions on a store that has lost its last
// writes, because a replica without them was made the master.
#include <string>
#include <utility>
#include <vector>

#include "core/base/poll_testing.h"
#include "core/base/temporary_directory_testing.h"
#include "server/rpc/server_testing.h"
#include "server/sessions/durability/session_codec.h"
#include "server/sessions/store_testing.h"
#include "server/stores/memory/memory_store.h"

namespace evpose::server {
namespace {

class DurableEndTest : private TemporaryDirectory, public RpcTest {  // the server is destroyed before its directory
 protected:
  DurableEndTest() : RpcTest(OnSqlite(path())) {}

  static ServerOptions OnSqlite(const std::string& directory) {
    ServerOptions options = Options();
    options.store.store = "sqlite";
    options.store.data_dir = directory;
    return options;
  }
};

// The client sends `end` and closes its half of the stream, as client libraries do, long before the last poses are
// stored.
TEST_F(DurableEndTest, AClientThatHalfClosesBehindItsEndGetsTheSummary) {
  for (int i = 0; i < 3; ++i) {
    const CreatedSession session = CreateSession();
    const auto track = Attached(session);
    ASSERT_TRUE(track->Events(1, Flat64(SomeEvents(0, 50))));
    ASSERT_TRUE(track->End());
    track->WritesDone();
    v1::TrackResponse response;
    EXPECT_TRUE(track->ReadUntil(v1::TrackResponse::kSummary, response));
    EXPECT_EQ(response.summary().health().poses(), 50u);
    EXPECT_EQ(Describe(track->Finish()), "OK");
    EXPECT_EQ(Describe(Delete(session.name())), "OK");
  }
}

// The client of a server that shuts down closes its half of the stream and attaches at another server, which has only
// what is stored.
TEST_F(DurableEndTest, AStreamThatTheClientLeavesEndsWhenAllIsStored) {
  CreatedSession session = CreateSession();
  for (uint64_t seq = 1; seq <= 5; ++seq) {
    RawTrack track(*sessions_);
    ASSERT_TRUE(track.Attach(session.name(), session.resume_token()));
    v1::TrackResponse response;
    ASSERT_TRUE(track.ReadUntil(v1::TrackResponse::kAttached, response));
    session.set_resume_token(response.attached().resume_token());
    const auto begin_ms = static_cast<int64_t>(10 * seq);
    ASSERT_TRUE(track.Events(seq, Flat64(SomeEvents(begin_ms, begin_ms + 10))));
    track.WritesDone();
    uint64_t durable_seq = 0;
    while (track.Read(response)) {
      if (response.has_ack()) durable_seq = response.ack().durable_seq();
    }
    EXPECT_EQ(Describe(track.Finish()), "OK");
    EXPECT_EQ(durable_seq, seq);
  }
}

class RollbackTest : public RpcTest {
 protected:
  RollbackTest() { Start(); }

  void Start() {
    std::shared_ptr<Store> store = MakeMemoryStore(replicated_);
    server_ = StartServer(Options(), FakeTrackers(gate_), std::make_unique<FaultInjectingStore>(store, fault_)).value();
    Use(server_->InProcessChannel());
  }

  // Attaches, sends the chunk `seq` with 10 ms of events, and ends the stream. Returns its poses, 9 of the first chunk
  // and 10 of each later one, when all is stored. The token of `session` is then the new one.
  std::vector<std::string> Feed(CreatedSession& session, uint64_t seq, uint64_t last_pose_seq) {
    RawTrack track(*sessions_);
    EXPECT_TRUE(track.Attach(session.name(), session.resume_token(), last_pose_seq));
    v1::TrackResponse response;
    EXPECT_TRUE(track.Read(response));
    EXPECT_EQ(response.attached().next_seq(), seq);
    session.set_resume_token(response.attached().resume_token());
    EXPECT_TRUE(
        track.Events(seq, Flat64(SomeEvents(static_cast<int64_t>(10 * seq), static_cast<int64_t>(10 * seq + 10)))));
    track.WritesDone();
    std::vector<std::string> poses;
    while (track.Read(response)) {
      if (response.has_pose()) poses.push_back(WithoutLatency(response.pose()));
    }
    EXPECT_EQ(Describe(track.Finish()), "OK");
    EXPECT_EQ(replicated_->Read(session.name(), 0)->poses.back().last_pose_seq, 10 * seq - 1);
    // The lifecycle record is written behind the end of the stream.
    const auto lifecycle = [&] { return DecodeLifecycle(replicated_->Read(session.name(), 0)->lifecycle).value(); };
    EXPECT_TRUE(Poll([&] { return lifecycle().detached_at.has_value(); }));
    return poses;
  }

  static std::string WithoutLatency(v1::Pose pose) {
    pose.clear_latency();
    return pose.SerializeAsString();
  }

  grpc::Status AttachError(const CreatedSession& session, uint64_t first_seq) {
    v1::TrackRequest request;
    request.mutable_attach()->set_session(session.name());
    request.mutable_attach()->set_resume_token(session.resume_token());
    request.mutable_attach()->set_first_seq(first_seq);
    RawTrack track(*sessions_);
    track.Write(request);
    return track.Finish();
  }

  std::unique_ptr<grpc::ClientReader<v1::WatchPosesResponse>> Watch(grpc::ClientContext& context,
                                                                    const std::string& name, uint64_t after_pose_seq) {
    v1::WatchPosesRequest request;
    request.set_session(name);
    request.set_after_pose_seq(after_pose_seq);
    return sessions_->WatchPoses(&context, request);
  }

  const std::shared_ptr<MemorySessions> replicated_ = std::make_shared<MemorySessions>(UINT64_MAX);
  const std::shared_ptr<InjectedFault> fault_ = std::make_shared<InjectedFault>();
};

TEST_F(RollbackTest, TheSessionContinuesFromWhatTheStoreHas) {
  CreatedSession session = CreateSession();
  Feed(session, 1, 0);
  const CreatedSession as_stored = session;
  const MemorySessions::Contents replica = replicated_->Copy();
  const std::vector<std::string> poses = Feed(session, 2, 9);
  EXPECT_EQ(poses.size(), 10u);
  replicated_->Replace(replica);

  // The server still has the session. It notices at its next write that the store has lost the last ones.
  EXPECT_EQ(Describe(AttachError(session, 1)), "UNAVAILABLE ROLLED_BACK");
  EXPECT_EQ(Describe(AttachError(session, 1)), "PERMISSION_DENIED WRONG_TOKEN") << "the store does not know the attach";
  session = as_stored;
  EXPECT_EQ(Feed(session, 2, 9), poses);
}

TEST_F(RollbackTest, AWriterThatCannotSendAgainEndsTheSession) {
  CreatedSession session = CreateSession();
  Feed(session, 1, 0);
  const CreatedSession as_stored = session;
  const MemorySessions::Contents replica = replicated_->Copy();
  Feed(session, 2, 9);
  server_.reset();
  replicated_->Replace(replica);
  Start();
  UploadCube();  // the models of a store in memory end with it
  session = as_stored;
  CreatedSession other = session;
  other.set_resume_token("guessed");
  EXPECT_EQ(Describe(AttachError(other, 3)), "PERMISSION_DENIED WRONG_TOKEN") << "no one else can end it";
  const grpc::Status status = AttachError(session, 3);
  EXPECT_EQ(Describe(status), "DATA_LOSS ROLLED_BACK");
  EXPECT_THAT(status.error_message(), testing::HasSubstr("from 2 on, and the client can no longer send them"));
  EXPECT_EQ(DetailOf<google::rpc::ErrorInfo>(status).metadata().at("expected_seq"), "2");
  EXPECT_EQ(Describe(AttachError(session, 3)), "DATA_LOSS ROLLED_BACK");
}

TEST_F(RollbackTest, OpenReadersEndWithTheSession) {
  CreatedSession session = CreateSession();
  Feed(session, 1, 0);
  grpc::ClientContext context;
  const auto watcher = Watch(context, session.name(), 0);
  v1::WatchPosesResponse response;
  ASSERT_TRUE(watcher->Read(&response));
  EXPECT_FALSE(response.has_continues_after_pose_seq());
  EXPECT_EQ(Describe(AttachError(session, 3)), "DATA_LOSS ROLLED_BACK");
  while (watcher->Read(&response)) continue;
  EXPECT_EQ(Describe(watcher->Finish()), "DATA_LOSS ROLLED_BACK");
}

TEST_F(RollbackTest, ReadersAtOtherServersAreTold) {
  CreatedSession session = CreateSession();
  const std::vector<std::string> poses = Feed(session, 1, 0);
  EXPECT_EQ(Describe(AttachError(session, 3)), "DATA_LOSS ROLLED_BACK");
  server_.reset();  // writes what waits
  Start();
  UploadCube();
  grpc::ClientContext context;
  const auto watcher = Watch(context, session.name(), 0);
  v1::WatchPosesResponse response;
  size_t num_poses = 0;
  while (watcher->Read(&response)) num_poses += static_cast<size_t>(response.poses_size());
  EXPECT_EQ(Describe(watcher->Finish()), "DATA_LOSS ROLLED_BACK");
  EXPECT_EQ(num_poses, poses.size()) << "what the store has stays readable";
  EXPECT_EQ(Describe(AttachError(session, 1)), "DATA_LOSS ROLLED_BACK");
}

TEST_F(RollbackTest, AReaderBeyondTheLastPoseIsToldWhereTheSessionContinues) {
  CreatedSession session = CreateSession();
  Feed(session, 1, 0);
  grpc::ClientContext context;
  const auto watcher = Watch(context, session.name(), 15);
  v1::WatchPosesResponse response;
  ASSERT_TRUE(watcher->Read(&response));
  EXPECT_TRUE(response.has_continues_after_pose_seq());
  EXPECT_EQ(response.continues_after_pose_seq(), 9u);
  EXPECT_TRUE(response.poses().empty());
  Feed(session, 2, 9);
  std::vector<uint64_t> seqs;
  while (seqs.size() < 4 && watcher->Read(&response)) {
    EXPECT_FALSE(response.has_continues_after_pose_seq());
    for (const v1::Pose& pose : response.poses()) seqs.push_back(pose.pose_seq());
  }
  EXPECT_THAT(seqs, testing::ElementsAre(16, 17, 18, 19));
}

}  // namespace
}  // namespace evpose::server

// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/stores/commit_replay.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "server/sessions/store_testing.h"
#include "server/stores/memory/memory_store.h"
#include "server/stores/store_suite_testing.h"
#include "tests/bench/stores/commit_recording.h"

namespace evpose::server {
namespace {

using std::chrono::microseconds;

// Commits with poses; the log keeps those of the last two.
SessionRecording SomeRecording() {
  SessionRecording recording;
  recording.record = {.name = "sessions/recorded", .tenant = "lab", .request_id = "request", .config = "config"};
  recording.lifecycle = "life";
  for (uint64_t i = 1; i <= 10; ++i) {
    SessionCommit commit = {.checkpoint = std::string(100, 'c'), .lifecycle = std::nullopt, .poses = {}};
    commit.poses.push_back({2 * i - 1, 2 * i, "poses"});
    commit.first_pose_seq_kept = i < 2 ? 1 : 2 * i - 3;
    if (i == 10) commit.ended_at = absl::FromUnixSeconds(1);
    recording.commits.push_back({microseconds(static_cast<int64_t>(3000 * i)), commit});
  }
  return recording;
}

TEST(CommitReplayTest, WritesTheCommitsUnderManyNames) {
  const SessionRecording recording = SomeRecording();
  const std::unique_ptr<Store> store = MakeMemoryStore();
  const auto result = Replay(*store, recording, {.sessions = 5, .deletes_sessions = false});
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->commits + result->unwritten, 5u * 9) << "the last commit is due at the end of the measurement";
  EXPECT_LE(result->written, 5u * 10);
  EXPECT_EQ(result->bytes, result->written * 105);
  EXPECT_EQ(result->repeated, 0u);
  EXPECT_TRUE(result->errors.empty());
  EXPECT_FALSE(result->cores.has_value()) << "this store reports no processor time";
  EXPECT_GT(result->bytes_after, result->bytes_before);
  std::set<std::string> names;
  uint64_t num_poses = 0;
  const std::vector<SessionOwner> owners = store->ListOwners().value();
  for (const SessionOwner& owner : owners) {
    names.insert(owner.name);
    const StoredSession session = store->ReadSession(owner.name).value();
    EXPECT_EQ(session.record.config, "config");
    EXPECT_EQ(session.record.tenant, "lab");
    if (!session.poses.empty()) num_poses += session.poses.back().last_pose_seq;
    EXPECT_LE(session.poses.size(), 2u) << "the log is as long as that of the recorded session";
  }
  EXPECT_EQ(names.size(), 5u);
  EXPECT_GE(num_poses, 2 * result->commits);
  EXPECT_TRUE(store->DeleteEnded(absl::InfiniteFuture())->empty()) << "the sessions have not ended";
}

// A store that refuses the first commits of each session.
class RefusingStore : public FaultInjectingStore {
 public:
  RefusingStore(absl::Status status, int num_refusals)
      : FaultInjectingStore(MakeMemoryStore(), std::make_shared<InjectedFault>()),
        status_(std::move(status)),
        num_refusals_(num_refusals) {}

  absl::StatusOr<std::unique_ptr<SessionLease>> CreateSession(const SessionRecord& record,
                                                              const std::string& lifecycle) override {
    auto lease = FaultInjectingStore::CreateSession(record, lifecycle);
    return std::make_unique<Lease>(*std::move(lease), status_, num_refusals_);
  }

 private:
  class Lease : public SessionLease {
   public:
    Lease(std::unique_ptr<SessionLease> lease, const absl::Status& status, int num_refusals)
        : lease_(std::move(lease)), status_(status), num_left_(num_refusals) {}
    void Commit(SessionCommit commit, Done done) override {
      if (num_left_-- > 0) return done(status_);
      lease_->Commit(std::move(commit), std::move(done));
    }
    const FencingToken& token() const override { return lease_->token(); }

   private:
    const std::unique_ptr<SessionLease> lease_;
    const absl::Status status_;
    int num_left_;
  };

  const absl::Status status_;
  const int num_refusals_;
};

TEST(CommitReplayTest, RepeatsCommitsThatTheStoreMayNotHaveWritten) {
  SessionRecording recording = SomeRecording();
  recording.commits.back().at = std::chrono::seconds(2);
  RefusingStore store(absl::UnavailableError("unreachable"), 2);
  const auto result = Replay(store, recording, {.sessions = 1});
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->repeated, 2u);
  EXPECT_EQ(result->commits + result->unwritten, 9u);
  EXPECT_GE(result->max_latency_us, 200'000) << "from the time at which the commit was due";
}

TEST(CommitReplayTest, ASessionEndsWithAnotherError) {
  SessionRecording recording = SomeRecording();
  recording.commits.back().at = std::chrono::seconds(2);
  RefusingStore store(absl::ResourceExhaustedError("full"), 1);
  const auto result = Replay(store, recording, {.sessions = 2});
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_THAT(result->errors, testing::ElementsAre(testing::Pair("RESOURCE_EXHAUSTED", 2)));
  EXPECT_EQ(result->commits, 0u);
}

TEST(CommitReplayTest, DeletesTheSessions) {
  const std::unique_ptr<Store> store = MakeMemoryStore();
  ASSERT_TRUE(Replay(*store, SomeRecording(), {.sessions = 3}).ok());
  EXPECT_TRUE(store->ListOwners()->empty());
}

TEST(CommitReplayTest, NeedsAMeasurement) {
  const std::unique_ptr<Store> store = MakeMemoryStore();
  const auto result =
      Replay(*store, SomeRecording(), {.spread = microseconds(20'000), .warm_up = microseconds(10'000)});
  EXPECT_EQ(result.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_TRUE(store->ListOwners()->empty());
}

TEST(CommitRecordingTest, RecordsTheCommitsOfASession) {
  const auto recorder = std::make_shared<CommitRecorder>();
  RecordingStore store(recorder);
  EXPECT_TRUE(store.outlives_process()) << "sessions write checkpoints";
  auto lease = store.CreateSession({.name = "sessions/a", .config = "config"}, "life").value();
  ASSERT_TRUE(CommitNow(*lease, {.checkpoint = "check", .poses = {{1, 2, "pose"}}}).ok());
  ASSERT_TRUE(CommitNow(*lease, {.lifecycle = "later", .poses = {{3, 7, "poses"}}}).ok());
  const SessionRecording recording = recorder->Get();
  EXPECT_EQ(recording.record.config, "config");
  EXPECT_EQ(recording.lifecycle, "life");
  ASSERT_EQ(recording.commits.size(), 2u);
  EXPECT_LE(recording.commits[0].at, recording.commits[1].at);
  EXPECT_EQ(LastPoseSeq(recording), 7u);
  const CommitBytes bytes = BytesOf(recording);
  EXPECT_EQ(bytes.checkpoints, 5u);
  EXPECT_EQ(bytes.lifecycles, 5u);
  EXPECT_EQ(bytes.poses, 9u);
  EXPECT_EQ(store.ReadSession("sessions/a")->poses.size(), 2u) << "the store has them, too";
}

}  // namespace
}  // namespace evpose::server

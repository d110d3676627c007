// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/durability/session_committer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <condition_variable>
#include <deque>

#include "core/base/trace_context.h"
#include "server/runtime/errors.h"
#include "server/runtime/failing_allocations_testing.h"
#include "server/runtime/out_of_memory.h"
#include "server/telemetry/log_testing.h"
#include "server/telemetry/metrics_testing.h"

namespace evpose::server {
namespace {

using Progress = SessionCommitter::Progress;

// A lease with results that the test chooses.
class TestLease : public SessionLease {
 public:
  struct Commits {
    std::mutex mutex;
    std::condition_variable came;
    std::deque<std::pair<SessionCommit, Done>> waiting;
  };
  explicit TestLease(std::shared_ptr<Commits> commits) : commits_(std::move(commits)) {}

  void Commit(SessionCommit commit, Done done) override {
    const std::lock_guard lock(commits_->mutex);
    commits_->waiting.emplace_back(std::move(commit), std::move(done));
    commits_->came.notify_all();
  }
  const FencingToken& token() const override { return token_; }

 private:
  const FencingToken token_ = {1, "holder"};
  const std::shared_ptr<Commits> commits_;
};

class SessionCommitterTest : public testing::Test {
 protected:
  SessionCommitterTest() {
    committer_->SetListener([this] { ++num_changes_; });
  }
  ~SessionCommitterTest() override {
    committer_->Close();
    pool_.Join();
    commits_->waiting.clear();  // each keeps the committer, which keeps the lease
  }

  // Waits for the next commit and ends it with this status.
  SessionCommit EndCommit(const absl::Status& status) {
    std::unique_lock lock(commits_->mutex);
    commits_->came.wait(lock, [this] { return !commits_->waiting.empty(); });
    auto [commit, done] = std::move(commits_->waiting.front());
    commits_->waiting.pop_front();
    lock.unlock();
    done(status);
    return std::move(commit);
  }
  size_t NumWaiting() {
    const std::lock_guard lock(commits_->mutex);
    return commits_->waiting.size();
  }
  static SessionCommit State(const std::string& state, uint64_t first, uint64_t last) {
    return {.checkpoint = state, .poses = {{first, last, "poses"}}, .first_pose_seq_kept = first};
  }

  const std::shared_ptr<TestLease::Commits> commits_ = std::make_shared<TestLease::Commits>();
  std::atomic<int> num_changes_ = 0;
  WorkerPool pool_{1};
  const std::shared_ptr<ServerMetrics> metrics_ = std::make_shared<ServerMetrics>();
  const std::shared_ptr<SessionCommitter> committer_ = std::make_shared<SessionCommitter>(
      std::make_shared<SessionLog>("sessions/test", ""), std::make_unique<TestLease>(commits_), Progress(), pool_,
      SessionCommitter::Backoff{.first = absl::Microseconds(1), .longest = absl::Microseconds(10)}, metrics_);
};

TEST_F(SessionCommitterTest, OneCommitAtATimeAndWaitingDataShareTheNext) {
  committer_->CommitLifecycle(1, "first");
  committer_->CommitLifecycle(2, "second");
  committer_->CommitLifecycle(1, "late");
  committer_->CommitCheckpoint(State("state", 1, 10), 7);
  EXPECT_EQ(NumWaiting(), 1u);
  EXPECT_TRUE(committer_->progress().has_waiting);
  EXPECT_EQ(EndCommit(absl::OkStatus()).lifecycle, "first");
  EXPECT_EQ(committer_->progress().lifecycle, 1u);
  EXPECT_EQ(committer_->progress().seq, 0u);
  EXPECT_EQ(NumIn(metrics_->checkpoint_time), 0u);
  const SessionCommit second = EndCommit(absl::OkStatus());
  EXPECT_EQ(second.lifecycle, "second");
  EXPECT_EQ(second.checkpoint, "state");
  const Progress progress = committer_->progress();
  EXPECT_EQ(progress.lifecycle, 2u);
  EXPECT_EQ(progress.seq, 7u);
  EXPECT_EQ(progress.last_pose_seq, 10u);
  EXPECT_FALSE(progress.has_waiting);
  EXPECT_FALSE(progress.has_ended);
  EXPECT_EQ(NumIn(metrics_->checkpoint_time), 1u);
  EXPECT_EQ(NumWaiting(), 0u) << "nothing is committed twice";
  EXPECT_EQ(num_changes_, 2);
}

TEST_F(SessionCommitterTest, AnUnavailableCommitIsRepeatedWithTheLaterData) {
  committer_->CommitCheckpoint(State("one", 1, 10), 1);
  const SessionCommit first = EndCommit(absl::UnavailableError("unreachable"));
  EXPECT_TRUE(committer_->progress().is_store_unavailable);
  EXPECT_EQ(committer_->progress().seq, 0u);
  const SessionCommit again = EndCommit(absl::UnavailableError("unreachable"));
  EXPECT_EQ(again.checkpoint, "one");
  EXPECT_EQ(&*again.checkpoint, &*first.checkpoint) << "shared, not copied";
  SessionCommit end = State("two", 11, 20);
  end.ended_at = absl::UnixEpoch();
  committer_->CommitCheckpoint(std::move(end), 2);
  SessionCommit commit = EndCommit(absl::UnavailableError("unreachable"));
  uint64_t num_failures = 3;
  for (; commit.checkpoint == "one"; ++num_failures) commit = EndCommit(absl::UnavailableError("unreachable"));
  EXPECT_EQ(commit.checkpoint, "two");
  ASSERT_EQ(commit.poses.size(), 2u);
  EXPECT_EQ(commit.poses[0].first_pose_seq, 1u);
  EXPECT_EQ(commit.poses[1].last_pose_seq, 20u);
  EndCommit(absl::OkStatus());
  const Progress progress = committer_->progress();
  EXPECT_EQ(progress.seq, 2u);
  EXPECT_EQ(progress.last_pose_seq, 20u);
  EXPECT_TRUE(progress.has_ended);
  EXPECT_FALSE(progress.is_store_unavailable);
  EXPECT_EQ(metrics_->checkpoint_failures[CheckpointFailure::kStoreUnavailable].value(), num_failures);
  EXPECT_EQ(NumIn(metrics_->checkpoint_time), 1u);
}

TEST_F(SessionCommitterTest, PosesMayBeCommittedWithoutACheckpoint) {
  committer_->CommitCheckpoint(State("one", 1, 10), 1);
  EndCommit(absl::OkStatus());
  committer_->CommitCheckpoint({.poses = {{11, 12, "poses"}}}, 2);
  EXPECT_FALSE(EndCommit(absl::OkStatus()).checkpoint.has_value());
  EXPECT_EQ(committer_->progress().seq, 1u);
  EXPECT_EQ(committer_->progress().last_pose_seq, 12u);
}

TEST_F(SessionCommitterTest, EveryEndHasItsReason) {
  const std::vector<std::pair<absl::Status, std::string>> cases = {
      {absl::AbortedError("taken"), "FENCED"},
      {absl::NotFoundError("gone"), "SESSION_DELETED"},
      {absl::ResourceExhaustedError("disk full"), "STORE_FULL"},
      {absl::CancelledError("closed"), "DRAINING"},
      {absl::OutOfRangeError("lost"), "ROLLED_BACK"},
      {absl::DataLossError("bad page"), "STORE_FAILED"},
  };
  for (const auto& [status, reason] : cases) {
    const auto commits = std::make_shared<TestLease::Commits>();
    const auto committer = std::make_shared<SessionCommitter>(std::make_shared<SessionLog>("sessions/a", ""),
                                                              std::make_unique<TestLease>(commits), Progress(), pool_,
                                                              SessionCommitter::Backoff(), metrics_);
    committer->CommitCheckpoint(State("x", 1, 10), 1);
    committer->CommitLifecycle(2, "y");
    SessionLease::Done done = std::move(commits->waiting.front().second);
    commits->waiting.clear();
    captured_log.Take();
    done(status);
    EXPECT_THAT(captured_log.Take(), testing::ContainsRegex("^[a-z]+ session_commit_failed .* reason=" + reason));
    EXPECT_EQ(GetErrorDetails(committer->progress().failure).reason, reason);
    EXPECT_TRUE(commits->waiting.empty()) << "no commit starts after the end";
  }
  EXPECT_EQ(metrics_->checkpoint_failures[CheckpointFailure::kFenced].value(), 1u);
  EXPECT_EQ(metrics_->checkpoint_failures[CheckpointFailure::kRolledBack].value(), 1u);
  EXPECT_EQ(metrics_->checkpoint_failures[CheckpointFailure::kStoreFull].value(), 1u);
  EXPECT_EQ(metrics_->checkpoint_failures[CheckpointFailure::kStoreFailed].value(), 1u);
  EXPECT_EQ(metrics_->checkpoint_failures[CheckpointFailure::kStoreUnavailable].value(), 0u);
}

TEST_F(SessionCommitterTest, ASlowCommitIsLoggedOnceInASeries) {
  const auto commit = [this](std::chrono::seconds age) {
    captured_log.Take();
    committer_->CommitCheckpoint(State("12345", 1, 10), 1, std::chrono::steady_clock::now() - age);
    EndCommit(absl::OkStatus());
    return captured_log.Take();
  };
  const std::chrono::hours soon(-1);  // begins later, so that no pause of this process makes it slow
  EXPECT_EQ(commit(soon), "");
  const std::string slow = commit(std::chrono::hours(1));
  EXPECT_THAT(slow, testing::StartsWith("warning session_commit_slow session=sessions/test "));
  EXPECT_THAT(slow, testing::ContainsRegex(" trace_id=[0-9a-f]+ duration_us=36[0-9]+ bytes=10\n"));
  EXPECT_EQ(commit(std::chrono::hours(1)), "");
  EXPECT_EQ(commit(soon), "");
  EXPECT_NE(commit(std::chrono::hours(1)), "");
  const auto exemplars = metrics_->checkpoint_time.ReadExemplars();
  ASSERT_TRUE(exemplars.back().has_value());
  EXPECT_EQ(exemplars.back()->trace_id_text(), TraceIdOf("sessions/test"));
}

TEST_F(SessionCommitterTest, AnOutageOfTheStoreHasItsOwnLines) {
  captured_log.Take();
  committer_->CommitCheckpoint(State("1", 1, 10), 1, std::chrono::steady_clock::now() - std::chrono::hours(1));
  EndCommit(absl::UnavailableError("unreachable"));
  EndCommit(absl::OkStatus());
  const std::string log = captured_log.Take();
  EXPECT_THAT(log,
              testing::ContainsRegex("^warning session_waits_for_store [^\n]*\ninfo session_store_back [^\n]*\n$"));
}

TEST_F(SessionCommitterTest, AFinishedCommitterStillCommitsWhatWaits) {
  committer_->CommitLifecycle(1, "first");
  committer_->CommitLifecycle(2, "second");
  committer_->Finish();
  committer_->CommitLifecycle(3, "third");
  committer_->Close();
  EXPECT_EQ(EndCommit(absl::OkStatus()).lifecycle, "first");
  EXPECT_EQ(EndCommit(absl::UnavailableError("the network")).lifecycle, "second");
  EXPECT_EQ(EndCommit(absl::OkStatus()).lifecycle, "second") << "the commit is repeated";
  EXPECT_EQ(NumWaiting(), 0u);
  EXPECT_EQ(committer_->progress().lifecycle, 2u);
}

TEST_F(SessionCommitterTest, AClosedCommitterStartsNoCommit) {
  committer_->CommitLifecycle(1, "x");
  committer_->CommitLifecycle(2, "y");
  committer_->Close();
  EndCommit(absl::OkStatus());
  EXPECT_EQ(NumWaiting(), 0u);
  committer_->CommitLifecycle(3, "z");
  EXPECT_EQ(NumWaiting(), 0u);
}

// The allocation fails on the thread of the store, where nothing handles the failure.
TEST_F(SessionCommitterTest, AFailedAllocationEndsTheSessionAndNotTheProcess) {
  FailingAllocation& failing = ThisThreadsFailingAllocation();
  committer_->CommitCheckpoint(State("first", 1, 3), 10);
  committer_->CommitCheckpoint(State("second", 4, 5), 20);
  failing.successes_before = 0;
  EndCommit(absl::OkStatus());
  failing.successes_before = -1;
  EXPECT_EQ(committer_->progress().seq, 10u) << "what was written is known as written";
  EXPECT_TRUE(IsOutOfMemory(committer_->progress().failure)) << "the next commit had no memory";
  EXPECT_EQ(NumWaiting(), 0u);
  EXPECT_EQ(num_changes_, 2);
}

TEST_F(SessionCommitterTest, AFailedAllocationForARepetitionEndsTheSession) {
  FailingAllocation& failing = ThisThreadsFailingAllocation();
  committer_->CommitLifecycle(1, "first");
  const absl::Status unreachable = absl::UnavailableError("the store is unreachable");
  failing.successes_before = 0;
  EndCommit(unreachable);
  failing.successes_before = -1;
  EXPECT_TRUE(IsOutOfMemory(committer_->progress().failure));
  EXPECT_EQ(num_changes_, 1);
}

}  // namespace
}  // namespace evpose::server

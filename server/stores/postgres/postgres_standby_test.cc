// SPDX-License-Identifier: Apache-2.0

// Tests the store on a primary that acknowledges a commit only after its synchronous standby has it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <condition_variable>
#include <future>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/poll_testing.h"
#include "server/stores/postgres/postgres_store.h"
#include "server/stores/postgres/postgres_testing.h"
#include "server/stores/store_suite_testing.h"

namespace evpose::server {
namespace {

using absl::StatusCode;
using testing::HasSubstr;

std::unique_ptr<Store> OpenAt(const std::string& url, absl::Duration timeout) {
  PostgresStoreOptions options;
  options.client.address = ParsePostgresAddress(url).value();
  options.client.timeout = timeout;
  options.client.first_backoff = absl::ZeroDuration();
  options.client.longest_backoff = absl::ZeroDuration();
  return OpenPostgresStore(options).value();
}

void AwaitWaitingCommits(const PostgresServer& primary, const std::string& number) {
  EXPECT_TRUE(Poll(
      [&] { return primary.Run("SELECT count(*) FROM pg_stat_activity WHERE wait_event = 'SyncRep'") == number; }));
}

class PostgresStandbyTest : public testing::Test {
 protected:
  PostgresServer primary_;
};

TEST_F(PostgresStandbyTest, WithoutItsStandbyNothingIsAcknowledged) {
  const std::unique_ptr<Store> patient = OpenAt(primary_.url(), absl::Seconds(60));
  const std::unique_ptr<Store> store = OpenAt(primary_.url(), absl::Seconds(2));
  auto lease = store->CreateSession(Record("sessions/a"), "").value();
  auto other = patient->CreateSession(Record("sessions/b"), "").value();
  ASSERT_TRUE(patient->CheckHealth().ok());
  primary_.SetSynchronous("missing");
  const SessionCommit commit = {.checkpoint = "1", .poses = {Segment("a", 1, 3)}};
  // The commit ends at the limit of the wait, and PostgreSQL does not continue to wait for the client that has left.
  const absl::Status status = CommitNow(*lease, commit);
  EXPECT_EQ(status.code(), StatusCode::kUnavailable) << status;
  AwaitWaitingCommits(primary_, "0");
  EXPECT_EQ(store->CheckHealth().code(), StatusCode::kUnavailable);

  AwaitWaitingCommits(primary_, "0");

  // Somebody cancels the wait: PostgreSQL reports success, with a warning.
  std::promise<absl::Status> cancelled;
  other->Commit({.checkpoint = "1"}, [&](absl::Status outcome) { cancelled.set_value(std::move(outcome)); });
  AwaitWaitingCommits(primary_, "1");
  primary_.Run("SELECT pg_cancel_backend(pid) FROM pg_stat_activity WHERE wait_event = 'SyncRep'");
  const absl::Status warned = cancelled.get_future().get();
  EXPECT_EQ(warned.code(), StatusCode::kUnavailable);
  EXPECT_THAT(std::string(warned.message()), HasSubstr("synchronous replication"));

  primary_.SetSynchronous("");
  const SessionCommit next = {.checkpoint = "2", .poses = {Segment("a", 1, 3), Segment("a", 4, 4)}};
  ASSERT_TRUE(Poll([&] { return CommitNow(*lease, next).ok(); }));
  EXPECT_EQ(Ranges(store->ReadSession("sessions/a")->poses), "1-3 4-4");
  EXPECT_EQ(CommitNow(*other, {.checkpoint = "2"}), absl::OkStatus());
}

// A session that commits one pose after the other until a commit fails.
class Committer {
 public:
  Committer(Store& store, const std::string& name)
      : name_(name), lease_(store.CreateSession(Record(name), "").value()) {}
  void Start() { Next(); }
  uint64_t Wait() {
    failed_.get_future().wait();
    return acknowledged_;
  }
  // Waits until this number of commits is acknowledged.
  void Await(uint64_t number) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return acknowledged_ >= number; });
  }
  SessionLease& lease() { return *lease_; }

  static std::string Checkpoint(const std::string& name, uint64_t seq) { return absl::StrCat(name, " ", seq); }

 private:
  void Next() {
    const uint64_t seq = acknowledged_ + 1;
    lease_->Commit({.checkpoint = Checkpoint(name_, seq), .poses = {Segment(name_, seq, seq)}},
                   [this, seq](const absl::Status& status) {
                     if (!status.ok()) return failed_.set_value();
                     {
                       const std::lock_guard lock(mutex_);
                       acknowledged_ = seq;
                     }
                     changed_.notify_all();
                     Next();
                   });
  }

  const std::string name_;
  const std::unique_ptr<SessionLease> lease_;
  std::mutex mutex_;
  std::condition_variable changed_;
  uint64_t acknowledged_ = 0;
  std::promise<void> failed_;
};

TEST_F(PostgresStandbyTest, EveryAcknowledgedCommitSurvivesTheLossOfThePrimary) {
  PostgresServer standby(PostgresServer::StandbyOf{primary_});
  primary_.AwaitSynchronous("standby");
  const std::string both = absl::StrCat(primary_.url(), ",", standby.host());
  const std::unique_ptr<Store> store = OpenAt(both, absl::Seconds(60));
  std::vector<std::unique_ptr<Committer>> committers;
  for (int i = 0; i < 16; ++i) {
    committers.push_back(std::make_unique<Committer>(*store, absl::StrCat("sessions/", 10 + i)));
  }
  for (const auto& committer : committers) committer->Start();
  for (const auto& committer : committers) committer->Await(20);
  primary_.Kill();
  std::vector<uint64_t> acknowledged;
  for (const auto& committer : committers) acknowledged.push_back(committer->Wait());
  EXPECT_EQ(store->CheckHealth().code(), StatusCode::kUnavailable) << "the standby is read-only";
  ASSERT_EQ(standby.Run("SELECT pg_promote()"), "t");

  for (size_t i = 0; i < committers.size(); ++i) {
    const std::string name = absl::StrCat("sessions/", 10 + i);
    const uint64_t seq = acknowledged[i] + 1;
    const StoredSession session = store->ReadSession(name).value();
    // The commit whose acknowledgement was lost may have been written.
    ASSERT_GE(session.poses.size(), acknowledged[i]);
    ASSERT_LE(session.poses.size(), seq);
    EXPECT_EQ(session.checkpoint, Committer::Checkpoint(name, session.poses.size()));
    for (const PoseSegment& segment : session.poses) {
      EXPECT_EQ(segment.bytes, Segment(name, segment.first_pose_seq, segment.last_pose_seq).bytes);
    }
    EXPECT_EQ(CommitNow(committers[i]->lease(), {.checkpoint = "on", .poses = {Segment(name, seq, seq + 1)}}),
              absl::OkStatus());
    EXPECT_EQ(store->ReadSession(name)->poses.size(), seq);
  }
}

}  // namespace
}  // namespace evpose::server

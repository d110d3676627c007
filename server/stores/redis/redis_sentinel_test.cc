// SPDX-License-Identifier: Apache-2.0

// Tests of the Redis store with Sentinels. They start real servers and kill the master.
#include "server/stores/redis/redis_sentinel.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <condition_variable>
#include <csignal>
#include <cstdint>
#include <functional>
#include <future>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/match.h"
#include "absl/time/time.h"
#include "core/base/closed_port_testing.h"
#include "core/base/poll_testing.h"
#include "server/stores/open_store.h"
#include "server/stores/redis/redis_store.h"
#include "server/stores/redis/redis_testing.h"
#include "server/stores/store_suite_testing.h"

namespace evpose::server {
namespace {

using absl::StatusCode;
using testing::HasSubstr;
using testing::Not;

TEST(RedisSentinelAddressTest, ReadsAllParts) {
  const RedisAddress address =
      ParseRedisAddress("redis+sentinel://me:p%2Cs%2F@one:7000,two,[::1]:7001,[::2]/cameras/3").value();
  ASSERT_EQ(address.sentinels.size(), 4u);
  EXPECT_EQ(address.sentinels[0].Printable(), "one:7000");
  EXPECT_EQ(address.sentinels[1].Printable(), "two:26379");
  EXPECT_EQ(address.sentinels[2].Printable(), "[::1]:7001");
  EXPECT_EQ(address.sentinels[3].Printable(), "[::2]:26379");
  EXPECT_EQ(address.master_name, "cameras");
  EXPECT_EQ(address.database, 3);
  EXPECT_EQ(address.user, "me");
  EXPECT_EQ(address.password, "p,s/");
  EXPECT_EQ(address.Printable(), "redis+sentinel://one:7000,two:26379,[::1]:7001,[::2]:26379/cameras/3");
  EXPECT_EQ(ParseRedisAddress("redis+sentinel://one/cameras")->database, 0);
  EXPECT_EQ(ParseRedisAddress("redis+sentinel://one/cameras/")->database, 0);
}

TEST(RedisSentinelAddressTest, ErrorsDoNotContainThePassword) {
  for (const char* const url :
       {"redis+sentinel://me:secret@", "redis+sentinel://me:secret@one", "redis+sentinel://me:secret@one/",
        "redis+sentinel://me:secret@/cameras", "redis+sentinel://me:secret@one,/cameras",
        "redis+sentinel://me:secret@one:0,two/cameras", "redis+sentinel://me:secret@one,two:x/cameras",
        "redis+sentinel://me:secret@one/cameras/x", "redis+sentinel://me:secret%4@one/cameras"}) {
    const absl::Status status = ParseRedisAddress(url).status();
    EXPECT_EQ(status.code(), StatusCode::kInvalidArgument) << url;
    EXPECT_THAT(std::string(status.message()), AllOf(Not(HasSubstr("secret")), HasSubstr("redis+sentinel://[USER")));
    EXPECT_EQ(OpenStore({.store = url}).status(), status);
  }
  const absl::Status tls = ParseRedisAddress("rediss+sentinel://me:secret@one/cameras").status();
  EXPECT_EQ(tls.code(), StatusCode::kUnimplemented);
  EXPECT_THAT(std::string(tls.message()), AllOf(Not(HasSubstr("secret")), HasSubstr("use redis+sentinel://")));
}

TEST(RedisSentinelTest, WithoutASentinelEachIsNamedWithTheReason) {
  const ClosedPort one, two;
  const absl::Status status =
      OpenStore({.store = "redis+sentinel://me:secret@" + one.address() + "," + two.address() + "/cameras"}).status();
  EXPECT_EQ(status.code(), StatusCode::kUnavailable);
  EXPECT_EQ(status.message(),
            "no Sentinel names the master cameras: " + one.address() + " does not respond: Connection refused; " +
                two.address() +
                " does not respond: Connection refused: start the Sentinels, or correct their addresses in --store");
}

// A busy machine must not be taken for a lost master or replica. A call does not wait for a failover, so that a test
// sees each result.
RedisStoreOptions PatientOptions(const std::string& url) {
  RedisStoreOptions options;
  options.client.address = ParseRedisAddress(url).value();
  options.client.timeout = absl::Seconds(60);
  options.client.replica_timeout = absl::Seconds(50);
  options.client.first_backoff = absl::ZeroDuration();
  options.client.sentinel.timeout = absl::Seconds(60);
  options.client.sentinel.failover_wait = absl::ZeroDuration();
  return options;
}

TEST(RedisSentinelTest, PasswordsAreGivenToServersAndSentinels) {
  RedisGroup group({.password = "right-secret"});
  const std::unique_ptr<Store> store = OpenRedisStore(PatientOptions(group.url("right-secret@"))).value();
  EXPECT_TRUE(store->CreateSession(Record("sessions/a"), "life").ok());
  for (const char* const user : {"", "wrong-secret@", "me:right-secret@"}) {
    const absl::Status status = OpenRedisStore(PatientOptions(group.url(user))).status();
    EXPECT_EQ(status.code(), StatusCode::kUnavailable) << status;
    EXPECT_THAT(std::string(status.message()),
                AllOf(HasSubstr("check the user and password of --store"), Not(HasSubstr("secret"))));
  }
}

class RedisSentinelFixture : public testing::Test {
 protected:
  RedisStoreOptions Options(const std::string& name = RedisGroup::kName) const {
    return PatientOptions(group_.url("", name));
  }
  std::unique_ptr<Store> Open() const { return OpenRedisStore(Options()).value(); }
  // A call of this store waits longer for a failover than any failover takes.
  std::unique_ptr<Store> OpenWaiting() const {
    RedisStoreOptions options = Options();
    options.client.sentinel.failover_wait = absl::Minutes(20);
    return OpenRedisStore(options).value();
  }
  // A store that soon reports that no replica acknowledges a write; on a busy machine also while the replicas follow.
  std::unique_ptr<Store> OpenImpatient() const {
    RedisStoreOptions options = Options();
    options.client.replica_timeout = absl::Seconds(1);
    absl::StatusOr<std::unique_ptr<Store>> store;
    EXPECT_TRUE(Poll([&] {
      store = OpenRedisStore(options);
      return !absl::IsUnavailable(store.status());
    }));
    return std::move(store).value();
  }
  // Creates a session with a patient store and takes it with `store`.
  std::unique_ptr<SessionLease> Create(Store& store, const std::string& name) const {
    EXPECT_EQ(Open()->CreateSession(Record(name), "life").status(), absl::OkStatus());
    absl::StatusOr<Store::AcquiredSession> acquired;
    EXPECT_TRUE(Poll([&] {
      acquired = store.AcquireSession(name);
      return !absl::IsUnavailable(acquired.status());
    }));
    return std::move(acquired.value().lease);
  }
  // The Sentinels replace the master after this time where a test expects it, and only there.
  static constexpr absl::Duration kDownAfter = absl::Seconds(2);

  // SIGSTOP: both replicas acknowledge nothing until SIGCONT.
  void SignalReplicas(int signal) {
    for (size_t i = 1; i < group_.num_nodes(); ++i) group_.node(i).Signal(signal);
  }

  // Repeats a commit that ends with UNAVAILABLE, as a session does. Each has waited for a replica before.
  static absl::Status CommitUntilAcknowledged(SessionLease& lease, const SessionCommit& commit) {
    absl::Status status;
    EXPECT_TRUE(Poll([&] {
      status = CommitNow(lease, commit);
      return !absl::IsUnavailable(status);
    }));
    return status;
  }

  RedisGroup group_;
};

TEST_F(RedisSentinelFixture, ANameThatTheSentinelsDoNotKnowIsAnError) {
  const absl::Status status = OpenRedisStore(Options("cameras")).status();
  EXPECT_EQ(status.code(), StatusCode::kUnavailable);
  EXPECT_THAT(std::string(status.message()),
              AllOf(HasSubstr("do not know the master cameras"), HasSubstr("correct the name in --store")));
}

TEST_F(RedisSentinelFixture, ANodeThatIsNotTheMasterIsNotUsed) {
  group_.Monitor("replica", 1);
  const absl::Status status = OpenRedisStore(Options("replica")).status();
  EXPECT_EQ(status.code(), StatusCode::kUnavailable);
  EXPECT_THAT(std::string(status.message()), HasSubstr(" as the master replica, but its role is slave"));
  group_.node(1).Kill();
  EXPECT_THAT(std::string(OpenRedisStore(Options("replica")).status().message()),
              HasSubstr("does not respond: Connection refused"));
}

TEST_F(RedisSentinelFixture, ASentinelThatDoesNotRespondIsPassedOver) {
  const std::unique_ptr<Store> store = Open();
  group_.KillSentinels(2);
  EXPECT_TRUE(Open()->CheckHealth().ok());
  group_.KillSentinels(3);
  EXPECT_TRUE(store->CheckHealth().ok()) << "the connection to the master is not affected";
}

TEST_F(RedisSentinelFixture, WritesAreNotAcknowledgedBeforeAReplicaHasThem) {
  const std::unique_ptr<Store> store = OpenImpatient();
  const auto lease = Create(*store, "sessions/a");
  ASSERT_NE(Create(*store, "sessions/b"), nullptr);
  ASSERT_TRUE(CommitUntilAcknowledged(*lease, {.checkpoint = "1", .poses = {Segment("a", 1, 3)}}).ok());
  SignalReplicas(SIGSTOP);
  const absl::Status status = CommitNow(*lease, {.checkpoint = "2", .poses = {Segment("a", 4, 5)}});
  EXPECT_EQ(status.code(), StatusCode::kUnavailable);
  EXPECT_THAT(std::string(status.message()), HasSubstr("no replica of evpose has acknowledged"));
  EXPECT_GE(store->unreplicated_commits(), 1u);
  // All at once, because they wait together.
  const std::function<absl::Status()> calls[] = {
      [&] { return store->CreateSession(Record("sessions/c"), "life").status(); },
      [&] { return store->AcquireSession("sessions/b").status(); },
      [&] { return store->DeleteSession("sessions/b"); },
      [&] { return store->PutModel(Model("models/a", "tenant", "bytes")); },
      [&] { return store->DeleteModel("tenant", "models/b"); },
      [&] { return store->CheckHealth(); },
  };
  std::vector<std::future<absl::Status>> results;
  for (const auto& call : calls) results.push_back(std::async(std::launch::async, call));
  for (size_t i = 0; i < results.size(); ++i) EXPECT_EQ(results[i].get().code(), StatusCode::kUnavailable) << i;
  EXPECT_EQ(store->ReadSession("sessions/a")->checkpoint, "2") << "reading needs no replica";
  SignalReplicas(SIGCONT);
  // The session repeats the commit with later poses.
  EXPECT_TRUE(
      CommitUntilAcknowledged(*lease, {.checkpoint = "3", .poses = {Segment("a", 4, 5), Segment("a", 6, 6)}}).ok());
  EXPECT_EQ(Ranges(store->ReadSession("sessions/a")->poses), "1-3 4-5 6-6");
  absl::Status health;
  EXPECT_TRUE(Poll([&] {
    health = store->CheckHealth();
    return !absl::IsUnavailable(health);
  }));
  EXPECT_EQ(health, absl::OkStatus());
}

TEST_F(RedisSentinelFixture, AMissingScriptIsSentAgainAndAcknowledged) {
  const std::unique_ptr<Store> store = OpenImpatient();
  const auto lease = Create(*store, "sessions/a");
  group_.master().Run({"SCRIPT", "FLUSH"});
  EXPECT_TRUE(CommitUntilAcknowledged(*lease, {.checkpoint = "1"}).ok());
  group_.master().Run({"SCRIPT", "FLUSH"});
  SignalReplicas(SIGSTOP);
  EXPECT_EQ(CommitNow(*lease, {.checkpoint = "2"}).code(), StatusCode::kUnavailable);
  SignalReplicas(SIGCONT);
}

// A call waits while the master cannot write, and the Sentinels would replace it.
TEST_F(RedisSentinelFixture, ACallWaitsForAMasterThatRejectsWrites) {
  const std::unique_ptr<Store> store = OpenWaiting();
  auto lease = store->CreateSession(Record("sessions/a"), "life").value();
  group_.master().Run({"CONFIG", "SET", "min-replicas-to-write", "3"});
  RedisFeed commands(ParseRedisAddress(group_.master().url()).value(), {"MONITOR"});
  std::promise<absl::Status> committed;
  lease->Commit({.checkpoint = "1", .poses = {Segment("a", 1, 3)}},
                [&committed](absl::Status status) { committed.set_value(std::move(status)); });
  // The second commit is the repetition of the first one, which was rejected.
  for (int commits = 0; commits < 2;) commits += absl::StrContains(commands.Next(), "\"EVALSHA\"");
  EXPECT_THAT(group_.master().Text({"INFO", "errorstats"}), HasSubstr("errorstat_NOREPLICAS:count="));
  group_.master().Run({"CONFIG", "SET", "min-replicas-to-write", "1"});
  EXPECT_EQ(committed.get_future().get(), absl::OkStatus());
  EXPECT_EQ(Ranges(store->ReadSession("sessions/a")->poses), "1-3");
}

// The role of the master changes while the connection to it stays open.
TEST_F(RedisSentinelFixture, AMasterThatBecomesAReplicaIsLeft) {
  const std::unique_ptr<Store> store = Open();
  auto lease = store->CreateSession(Record("sessions/a"), "life").value();
  ASSERT_TRUE(CommitUntilAcknowledged(*lease, {.checkpoint = "1", .poses = {Segment("a", 1, 3)}}).ok());
  group_.AwaitSentinels();
  const size_t old_master = group_.Master();
  group_.node(old_master).Run({"REPLICAOF", "127.0.0.1", "1"});
  absl::Status status = CommitNow(*lease, {.checkpoint = "2", .poses = {Segment("a", 4, 5)}});
  EXPECT_EQ(status.code(), StatusCode::kUnavailable);
  EXPECT_THAT(std::string(status.message()), HasSubstr("READONLY"));
  group_.SetDownAfter(kDownAfter);
  EXPECT_NE(group_.AwaitFailover(old_master), old_master);
  status = CommitUntilAcknowledged(*lease, {.checkpoint = "2", .poses = {Segment("a", 4, 5)}});
  EXPECT_EQ(status, absl::OkStatus());
  EXPECT_EQ(Ranges(store->ReadSession("sessions/a")->poses), "1-3 4-5");
}

// Commits in a thread until it is told to stop, and repeats a commit that ends with UNAVAILABLE, as a session does.
class BackgroundCommitter {
 public:
  explicit BackgroundCommitter(SessionLease& lease) : lease_(lease), thread_([this] { Run(); }) {}
  ~BackgroundCommitter() { Stop(); }

  // Waits until this number of further commits has been acknowledged, or one has failed.
  void AwaitMore(uint64_t commits) {
    std::unique_lock lock(mutex_);
    const uint64_t wanted = acknowledged_ + commits;
    changed_.wait(lock, [&] { return acknowledged_ >= wanted || has_failed_; });
  }
  // Returns the number of acknowledged commits.
  uint64_t Stop() {
    {
      const std::lock_guard lock(mutex_);
      is_stopped_ = true;
    }
    if (thread_.joinable()) thread_.join();
    return acknowledged_;
  }
  // The pose segment of a commit: two poses.
  static PoseSegment SegmentOf(uint64_t commit) { return Segment("a", 2 * commit - 1, 2 * commit); }

 private:
  void Run() {
    std::unique_lock lock(mutex_);
    while (!is_stopped_ && !has_failed_) {
      const uint64_t commit = acknowledged_ + 1;
      lock.unlock();
      const absl::Status status =
          CommitNow(lease_, {.checkpoint = std::to_string(commit), .poses = {SegmentOf(commit)}});
      lock.lock();
      if (absl::IsUnavailable(status)) continue;
      EXPECT_EQ(status, absl::OkStatus()) << "commit " << commit;
      has_failed_ = !status.ok();
      if (status.ok()) acknowledged_ = commit;
      changed_.notify_all();
    }
  }

  SessionLease& lease_;
  std::mutex mutex_;
  std::condition_variable changed_;
  uint64_t acknowledged_ = 0;
  bool is_stopped_ = false;
  bool has_failed_ = false;
  std::thread thread_;  // the last member, because it uses the others
};

TEST_F(RedisSentinelFixture, AKilledMasterLosesNoAcknowledgedCommit) {
  constexpr int kKills = 2;
  constexpr uint64_t kCommits = 50;
  const std::unique_ptr<Store> store = OpenWaiting();
  auto lease = store->CreateSession(Record("sessions/a"), "life").value();
  ASSERT_TRUE(store->PutModel(Model("models/a", "tenant", "bytes")).ok());
  group_.AwaitSentinels();
  BackgroundCommitter committer(*lease);
  for (int kill = 0; kill < kKills; ++kill) {
    committer.AwaitMore(kCommits);
    const size_t old_master = group_.Master();
    group_.node(old_master).Kill();
    group_.SetDownAfter(kDownAfter);
    const size_t new_master = group_.AwaitFailover(old_master);
    EXPECT_NE(new_master, old_master);
    group_.SetDownAfter(RedisGroup::Options().down_after);
    committer.AwaitMore(kCommits);
    group_.Restart(old_master);
  }
  const uint64_t acknowledged = committer.Stop();
  EXPECT_GE(acknowledged, uint64_t{2} * kKills * kCommits);
  // The session is read with another store, which knows only the new master.
  const StoredSession session = Open()->ReadSession("sessions/a").value();
  ASSERT_GE(session.poses.size(), acknowledged);
  ASSERT_LE(session.poses.size(), acknowledged + 1) << "the last commit may be written without an acknowledgement";
  for (uint64_t commit = 1; commit <= session.poses.size(); ++commit) {
    const PoseSegment& stored = session.poses[commit - 1];
    ASSERT_EQ(stored.first_pose_seq, 2 * commit - 1);
    ASSERT_EQ(stored.bytes, BackgroundCommitter::SegmentOf(commit).bytes);
  }
  EXPECT_EQ(session.checkpoint, std::to_string(session.poses.size()));
  EXPECT_TRUE(store->ReadModel("tenant", "models/a").ok());
}

}  // namespace
}  // namespace evpose::server

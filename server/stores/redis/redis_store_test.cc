// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <csignal>
#include <cstdint>
#include <functional>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "server/stores/open_store.h"
#include "server/stores/redis/redis_keys.h"
#include "server/stores/redis/redis_testing.h"
#include "server/stores/store_suite_testing.h"

namespace evpose::server {
namespace {

using absl::StatusCode;
using testing::HasSubstr;
using testing::Not;

TEST(RedisAddressTest, ReadsAllParts) {
  const RedisAddress address = ParseRedisAddress("redis://me:p%40ss:word@host:6380/3").value();
  EXPECT_EQ(address.host, "host");
  EXPECT_EQ(address.port, 6380);
  EXPECT_EQ(address.database, 3);
  EXPECT_EQ(address.user, "me");
  EXPECT_EQ(address.password, "p@ss:word");
  EXPECT_EQ(address.Printable(), "redis://host:6380/3");
  EXPECT_EQ(ParseRedisAddress("redis://host")->port, 6379);
  EXPECT_EQ(ParseRedisAddress("redis://secret@host")->password, "secret");
  EXPECT_EQ(ParseRedisAddress("redis://[::1]:7000")->host, "::1");
  EXPECT_EQ(ParseRedisAddress("redis://[::1]:7000")->port, 7000);
  EXPECT_EQ(ParseRedisAddress("redis+unix://secret@/run/redis.sock")->socket_path, "/run/redis.sock");
}

TEST(RedisAddressTest, ErrorsDoNotContainThePassword) {
  for (const char* const url : {"redis://me:secret@", "redis://me:secret@host:0", "redis://me:secret@host:70000",
                                "redis://me:secret@host:x", "redis://me:secret@host/x", "redis://me:secret%4@host",
                                "redis+unix://me:secret@run", "http://me:secret@host", "redis://me:secret@host/-1"}) {
    const absl::Status status = ParseRedisAddress(url).status();
    EXPECT_EQ(status.code(), StatusCode::kInvalidArgument) << url;
    EXPECT_THAT(std::string(status.message()), AllOf(Not(HasSubstr("secret")), HasSubstr("redis://[USER")));
    EXPECT_EQ(OpenStore({.store = url}).status(), status);
  }
  const absl::Status tls = ParseRedisAddress("rediss://me:secret@host").status();
  EXPECT_EQ(tls.code(), StatusCode::kUnimplemented);
  EXPECT_THAT(std::string(tls.message()), AllOf(Not(HasSubstr("secret")), HasSubstr("TLS")));
}

TEST(RedisStoreTest, WrongPasswordsAndMissingServersAreErrors) {
  RedisServer redis({"--requirepass", "right-secret"});
  EXPECT_TRUE(OpenStore({.store = redis.url("right-secret@")}).ok());
  EXPECT_TRUE(OpenStore({.store = redis.url("default:right-secret@")}).ok());
  for (const char* const user : {"", "wrong-secret@", "default:wrong-secret@"}) {
    const absl::Status status = OpenStore({.store = redis.url(user)}).status();
    EXPECT_EQ(status.code(), StatusCode::kPermissionDenied) << status;
    EXPECT_THAT(std::string(status.message()), AllOf(Not(HasSubstr("secret")), HasSubstr("socket")));
  }
  redis.Kill();
  const absl::Status status = OpenStore({.store = redis.url("right-secret@")}).status();
  EXPECT_EQ(status.code(), StatusCode::kUnavailable) << status;
  EXPECT_THAT(std::string(status.message()), AllOf(Not(HasSubstr("secret")), HasSubstr("socket")));
}

TEST(RedisStoreTest, AServerThatEvictsKeysIsRefused) {
  RedisServer redis({"--maxmemory", "100mb", "--maxmemory-policy", "allkeys-lru"});
  const absl::Status status = OpenStore({.store = redis.url()}).status();
  EXPECT_EQ(status.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(status.message()), HasSubstr("noeviction"));
}

class RedisStoreFixture : public testing::Test {
 protected:
  std::unique_ptr<Store> Open(absl::Duration timeout = absl::Seconds(60)) {
    RedisStoreOptions options;
    options.client.address = ParseRedisAddress(redis_.url()).value();
    options.client.timeout = timeout;
    options.client.first_backoff = absl::ZeroDuration();
    options.max_segments = 4;
    return OpenRedisStore(options).value();
  }

  RedisServer redis_;
  std::unique_ptr<Store> store_ = Open();
};

TEST_F(RedisStoreFixture, ReconnectsAfterARestartOfTheServer) {
  auto lease = store_->CreateSession(Record("sessions/a"), "").value();
  ASSERT_TRUE(CommitNow(*lease, {.checkpoint = "1", .poses = {Segment("a", 1, 3)}}).ok());
  redis_.Kill();
  EXPECT_EQ(CommitNow(*lease, {.checkpoint = "2", .poses = {Segment("a", 4, 5)}}).code(), StatusCode::kUnavailable);
  EXPECT_EQ(CommitNow(*lease, {.checkpoint = "2", .poses = {Segment("a", 4, 5)}}).code(), StatusCode::kUnavailable);
  EXPECT_EQ(store_->ReadSession("sessions/a").status().code(), StatusCode::kUnavailable);
  EXPECT_EQ(store_->CheckHealth().code(), StatusCode::kUnavailable);
  redis_.Start();
  EXPECT_TRUE(CommitNow(*lease, {.checkpoint = "3", .poses = {Segment("a", 4, 5), Segment("a", 6, 6)}}).ok());
  EXPECT_EQ(Ranges(store_->ReadSession("sessions/a")->poses), "1-3 4-5 6-6");
}

// Redis is stopped while a commit is in progress, so that the client cannot see whether the commit was written.
TEST_F(RedisStoreFixture, ACommitWithAnUnknownResultIsNotAppliedTwice) {
  store_ = Open(absl::Seconds(2));
  auto lease = store_->CreateSession(Record("sessions/a"), "").value();
  ASSERT_TRUE(CommitNow(*lease, {.checkpoint = "1", .poses = {Segment("a", 1, 3)}}).ok());
  redis_.Signal(SIGSTOP);
  EXPECT_EQ(CommitNow(*lease, {.checkpoint = "2", .poses = {Segment("a", 4, 5), Segment("a", 6, 9)}}).code(),
            StatusCode::kUnavailable);
  redis_.Signal(SIGCONT);
  // Redis reads the bytes that wait in the first connection before those of the second one.
  EXPECT_EQ(Ranges(Open()->ReadSession("sessions/a")->poses), "1-3 4-5 6-9") << "it had arrived";
  EXPECT_EQ(store_->ReadSession("sessions/a")->checkpoint, "2");
  EXPECT_EQ(CommitNow(*lease, {.poses = {Segment("x", 10, 10)}}).code(), StatusCode::kFailedPrecondition)
      << "the poses of the commit that ended with UNAVAILABLE must be committed again";
  EXPECT_TRUE(CommitNow(*lease, {.checkpoint = "3", .poses = {Segment("a", 4, 7), Segment("a", 8, 12)}}).ok());
  const StoredSession session = store_->ReadSession("sessions/a").value();
  EXPECT_EQ(Ranges(session.poses), "1-3 4-7 8-12");
  EXPECT_EQ(session.poses[1].bytes, Segment("a", 4, 7).bytes);
  EXPECT_EQ(session.checkpoint, "3");
}

TEST_F(RedisStoreFixture, ACommitThatComesAfterALaterOneIsNotWritten) {
  auto lease = store_->CreateSession(Record("sessions/a"), "").value();
  ASSERT_TRUE(CommitNow(*lease, {.checkpoint = "1"}).ok());
  ASSERT_TRUE(CommitNow(*lease, {.checkpoint = "2"}).ok());
  // The first commit once more, as a slow connection would deliver it.
  RedisCommand command = {"EVAL", kRedisCommit.source, "8"};
  const std::vector<std::string> keys = RedisSessionKeys("sessions/a");
  command.insert(command.end(), keys.begin(), keys.end());
  const RedisCommand arguments = {"sessions/a",
                                  std::to_string(lease->token().number),
                                  "1",
                                  "1",
                                  "1",
                                  "",
                                  "1000000",
                                  "10",
                                  "stale",
                                  "",
                                  lease->token().holder,
                                  "0",
                                  "1",
                                  "1",
                                  "stale"};
  command.insert(command.end(), arguments.begin(), arguments.end());
  const std::string reply = redis_.Text(command);
  EXPECT_EQ(reply, "STALE");
  EXPECT_EQ(store_->ReadSession("sessions/a")->checkpoint, "2");
  EXPECT_TRUE(store_->ReadSession("sessions/a")->poses.empty());
}

TEST_F(RedisStoreFixture, ThePreviousHolderIsFenced) {
  const std::unique_ptr<Store> other = Open();
  auto lease = store_->CreateSession(Record("sessions/a"), "").value();
  ASSERT_TRUE(CommitNow(*lease, {.checkpoint = "1", .poses = {Segment("a", 1, 3)}}).ok());
  Store::AcquiredSession acquired = other->AcquireSession("sessions/a").value();
  EXPECT_EQ(CommitNow(*lease, {.checkpoint = "x", .poses = {Segment("x", 4, 4)}}).code(), StatusCode::kAborted);
  EXPECT_TRUE(CommitNow(*acquired.lease, {.checkpoint = "2", .poses = {Segment("a", 4, 4)}}).ok());
  Store::AcquiredSession back = store_->AcquireSession("sessions/a").value();
  EXPECT_EQ(back.session.checkpoint, "2");
  EXPECT_EQ(Ranges(back.session.poses), "1-3 4-4");
  EXPECT_EQ(CommitNow(*acquired.lease, {.checkpoint = "x"}).code(), StatusCode::kAborted);
}

TEST_F(RedisStoreFixture, SendsMissingScriptsAgain) {
  auto lease = store_->CreateSession(Record("sessions/a"), "").value();
  redis_.Run({"SCRIPT", "FLUSH"});
  EXPECT_TRUE(CommitNow(*lease, {.checkpoint = "1"}).ok());
  EXPECT_EQ(store_->ReadSession("sessions/a")->checkpoint, "1");
}

TEST_F(RedisStoreFixture, BoundsTheStreamAndTheLifetimeOfUnusedSessions) {
  auto lease = store_->CreateSession(Record("sessions/a"), "").value();
  for (uint64_t i = 0; i < 10; ++i) {
    ASSERT_TRUE(CommitNow(*lease, {.poses = {Segment("a", 10 * i + 1, 10 * i + 10)}}).ok());
  }
  EXPECT_EQ(Ranges(store_->ReadSession("sessions/a")->poses), "61-70 71-80 81-90 91-100");
  EXPECT_GT(redis_.Run({"PTTL", RedisSessionKey("sessions/a")})->integer, 0);
  EXPECT_GT(redis_.Run({"PTTL", RedisPosesKey("sessions/a")})->integer, 0);
}

TEST_F(RedisStoreFixture, LeavesNothingBehind) {
  auto lease = store_->CreateSession(Record("sessions/a"), "").value();
  ASSERT_TRUE(
      CommitNow(*lease,
                {.checkpoint = "1", .poses = {Segment("a", 1, 1)}, .ended_at = absl::FromUnixSeconds(1'700'000'000)})
          .ok());
  ASSERT_TRUE(store_->PutModel(Model("models/a", "tenant", "bytes")).ok());
  ASSERT_TRUE(store_->DeleteSession("sessions/a").ok());
  ASSERT_TRUE(store_->DeleteModel("tenant", "models/a").ok());
  const RedisReply keys = redis_.Run({"KEYS", "*"});
  EXPECT_EQ(keys->elements, kRedisBuckets + 2u);
  for (size_t i = 0; i < keys->elements; ++i) {
    EXPECT_THAT(RedisText(keys->element[i]),
                testing::AnyOf(testing::EndsWith("}:bucket"), kRedisStoreKey, kRedisOldSessionsKey));
  }
}

TEST_F(RedisStoreFixture, NamesDamagedRecords) {
  using Tamper = std::function<void()>;
  const std::string key = RedisSessionKey("sessions/a");
  const std::pair<Tamper, const char*> cases[] = {
      {[&] {
         redis_.Run({"HSET", key, "checkpoint", "other bytes"});
       },
       "checkpoint of sessions/a"},
      {[&] {
         redis_.Run({"HSET", key, "lifecycle", ""});
       },
       "lifecycle of sessions/a"},
      {[&] {
         redis_.Run({"HSET", key, "record", "other"});
       },
       "record of sessions/a"},
      {[&] {
         redis_.Run({"HSET", key, "next", "x"});
       },
       "state of sessions/a"},
      {[&] {
         redis_.Run({"XDEL", RedisPosesKey("sessions/a"), "4-5"});
       },
       "poses of sessions/a are missing"},
      {[&] {
         redis_.Run({"DEL", RedisPosesKey("sessions/a")});
       },
       "poses of sessions/a are missing"},
      {[&] {
         redis_.Run({"XADD", RedisPosesKey("sessions/a"), "9-9", "b", "x"});
       },
       "poses 9 to 9 of sessions/a"},
  };
  for (const auto& [tamper, words] : cases) {
    ASSERT_TRUE(store_->DeleteSession("sessions/a").ok());
    auto lease = store_->CreateSession(Record("sessions/a"), "").value();
    ASSERT_TRUE(CommitNow(*lease, {.checkpoint = "1", .poses = {Segment("a", 1, 3), Segment("a", 4, 5)}}).ok());
    tamper();
    const absl::Status status = store_->AcquireSession("sessions/a").status();
    EXPECT_EQ(status.code(), StatusCode::kDataLoss) << words;
    EXPECT_THAT(std::string(status.message()), HasSubstr(words));
    EXPECT_EQ(store_->ReadWithoutPoses({"sessions/a"})->size(), absl::StrContains(words, "poses") ? 1u : 0u) << words;
    EXPECT_THAT(Open()->damage(), testing::ElementsAre(AllOf(HasSubstr("session sessions/a: "), HasSubstr(words))));
  }
  ASSERT_TRUE(store_->DeleteSession("sessions/a").ok());
  ASSERT_TRUE(store_->CreateSession(Record("sessions/b"), "").ok());
  ASSERT_TRUE(store_->PutModel(Model("models/a", "", "bytes")).ok());
  ASSERT_TRUE(store_->CreateSession(Record("sessions/whole"), "").ok());
  redis_.Run({"HSET", RedisSessionKey("sessions/b"), "record", "other"});
  redis_.Run({"HSET", RedisModelKey(RedisModelMember("", "models/a")), "bytes", "other"});
  store_ = Open();
  EXPECT_THAT(store_->damage(), testing::ElementsAre(HasSubstr("session sessions/b"), HasSubstr("model models/a")));
  EXPECT_TRUE(store_->ListSessions("tenant of sessions/b", "", 10)->records.empty());
  EXPECT_EQ(store_->ReadTenant("sessions/b").value(), "tenant of sessions/b");
  EXPECT_THAT(NamesOf(*store_), testing::ElementsAre("sessions/b", "sessions/whole"));
  EXPECT_TRUE(store_->ListModels()->empty());
}

TEST_F(RedisStoreFixture, SessionsAreListedInFewRoundTrips) {
  constexpr size_t kListed = 200;
  for (size_t i = 0; i < kListed; ++i) {
    const std::string name = absl::StrCat("sessions/", i);
    ASSERT_TRUE(store_->CreateSession({.name = name, .tenant = "lab", .config = "config"}, "life").ok());
  }
  const auto reads = [this] {
    const std::string info = redis_.Text({"INFO", "stats"});
    const std::string key = "total_reads_processed:";
    return std::stoul(info.substr(info.find(key) + key.size()));
  };
  // One of several listings: on a busy machine Redis may read a request in pieces.
  size_t fewest = SIZE_MAX;
  for (int i = 0; i < 5; ++i) {
    const size_t before = reads();
    EXPECT_EQ(store_->ListSessions("lab", "", kListed)->records.size(), kListed);
    EXPECT_EQ(store_->ReadOldestLifecycles(kListed)->size(), kListed);
    fewest = std::min(fewest, reads() - before);
  }
  EXPECT_LT(fewest, kListed / 2);
}

TEST_F(RedisStoreFixture, TheLayoutOfAnEarlierVersionIsRefused) {
  EXPECT_EQ(redis_.Text({"TYPE", kRedisOldSessionsKey}), "string") << "an earlier version expects a set";
  for (const RedisCommand& command : std::vector<RedisCommand>{{"SADD", kRedisOldSessionsKey, "sessions/a"},
                                                               {"SADD", "evpose:models", "models/a\ntenant"}}) {
    redis_.Run({"FLUSHALL"});
    redis_.Run(command);
    const absl::Status status = OpenStore({.store = redis_.url()}).status();
    EXPECT_EQ(status.code(), StatusCode::kFailedPrecondition) << status;
    EXPECT_THAT(std::string(status.message()),
                AllOf(HasSubstr("socket has sessions or models of an earlier version"), HasSubstr("give --store")));
  }
}

// A Redis that keeps nothing is restarted.
TEST_F(RedisStoreFixture, AnEmptiedRedisIsUsedAgain) {
  auto lease = store_->CreateSession(Record("sessions/a"), "").value();
  redis_.Run({"FLUSHALL"});
  EXPECT_EQ(store_->ReadTenant("sessions/a").status().code(), StatusCode::kNotFound);
  EXPECT_EQ(CommitNow(*lease, {.checkpoint = "1"}).code(), StatusCode::kNotFound);
  EXPECT_TRUE(store_->CreateSession(Record("sessions/a"), "").ok());
}

// Redis deletes a session that no server has used for the safety time, but not its entries in the indexes.
TEST_F(RedisStoreFixture, EntriesOfSessionsThatRedisDeletedAreRemoved) {
  std::vector<SessionRecord> records;
  for (const char* const request_id : {"1", "2", "1"}) {
    records.push_back({.name = store_->NewSessionName("lab", request_id).value(),
                       .tenant = "lab",
                       .request_id = request_id,
                       .config = ""});
  }
  for (size_t i = 0; i < 2; ++i) {
    ASSERT_TRUE(store_->CreateSession(records[i], "life").ok());
    redis_.Run({"DEL", RedisSessionKey(records[i].name)});
  }
  EXPECT_EQ(store_->FindRequest("lab", "1").status().code(), StatusCode::kNotFound);
  EXPECT_TRUE(store_->CreateSession(records[2], "").ok());
  EXPECT_EQ(store_->ReadOldestLifecycles(10)->size(), 1u);
  EXPECT_THAT(NamesOf(*store_), testing::ElementsAre(records[2].name));
  EXPECT_EQ(store_->FindRequest("lab", "1")->name, records[2].name);
  const int bucket = RedisBucketOf(records[1].name);
  for (const std::string& key : {RedisTenantsKey(bucket), RedisLifecycleWritesKey(bucket)}) {
    EXPECT_EQ(redis_.Run({"EXISTS", key})->integer, 0) << key;
  }
}

TEST_F(RedisStoreFixture, ARequestDecidesTheBucketOfItsSession) {
  const std::string name = store_->NewSessionName("lab", "1").value();
  EXPECT_EQ(RedisBucketOf(name), RedisBucketOf("lab\n1"));
  SessionRecord record = {.name = name, .tenant = "lab", .request_id = "1", .config = ""};
  while (RedisBucketOf(record.name) == RedisBucketOf(name)) record.name += "x";
  EXPECT_EQ(store_->CreateSession(record, "").status().code(), StatusCode::kInvalidArgument);
}

TEST(RedisBucketTest, BucketsNeverChange) {
  EXPECT_EQ(RedisBucketOf(""), 0xC5 ^ 0x9D ^ 0x1C ^ 0x81);
  EXPECT_EQ(RedisBucketOf("a"), 0xE4 ^ 0x0C ^ 0x29 ^ 0x2C);
  EXPECT_EQ(RedisBucketOf("foobar"), 0xBF ^ 0x9C ^ 0xF9 ^ 0x68);
  std::vector<int> sizes(kRedisBuckets);
  for (int i = 0; i < 100 * kRedisBuckets; ++i)
    ++sizes[static_cast<size_t>(RedisBucketOf(absl::StrCat("sessions/", i)))];
  EXPECT_GT(*std::min_element(sizes.begin(), sizes.end()), 50);
  EXPECT_LT(*std::max_element(sizes.begin(), sizes.end()), 150);
}

}  // namespace
}  // namespace evpose::server

// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_groups.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <fstream>
#include <future>
#include <map>
#include <set>
#include <thread>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "core/base/poll_testing.h"
#include "server/stores/open_store.h"
#include "server/stores/redis/redis_groups_file.h"
#include "server/stores/redis/redis_store.h"
#include "server/stores/redis/redis_testing.h"
#include "server/stores/store_suite_testing.h"

namespace evpose::server {
namespace {

using absl::StatusCode;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

TEST(RedisGroupsFileTest, ReadsNamesAndAddresses) {
  const auto groups = ParseRedisGroups(
      "# two groups\n\n  a redis+sentinel://s1,s2,s3/first   # with Sentinels\r\nb-2\tredis://:own@host/1\n", "common");
  ASSERT_TRUE(groups.ok()) << groups.status();
  ASSERT_EQ(groups->size(), 2u);
  EXPECT_EQ(groups->at(0).name, "a");
  EXPECT_EQ(groups->at(0).address.Printable(), "redis+sentinel://s1:26379,s2:26379,s3:26379/first/0");
  EXPECT_EQ(groups->at(0).address.password, "common");
  EXPECT_EQ(groups->at(1).name, "b-2");
  EXPECT_EQ(groups->at(1).address.password, "own");
}

TEST(RedisGroupsFileTest, ErrorsNameTheLineAndNoPassword) {
  std::string many;
  for (int i = 0; i < 65; ++i) absl::StrAppend(&many, "g", i, " redis://host\n");
  const std::pair<std::string, std::string> cases[] = {
      {"", "there is no group: give each a line NAME ADDRESS"},
      {"\na\n", "line 2: is not NAME ADDRESS"},
      {"a redis://:secret@host more\n", "line 1: is not NAME ADDRESS"},
      {"a redis://:secret@host:x\n", "line 1: the store's address has a port"},
      {"a_b redis://:secret@host\n", "line 1: the name of a group has 1 to 32 letters, digits and hyphens"},
      {std::string(33, 'a') + " redis://:secret@host\n", "line 1: the name of a group has 1 to 32 letters"},
      {"a redis://h\na redis://i\n", "line 2: the group a has a line already"},
      {"a rediss://h\n", "line 1: rediss:// is not supported"},
      {many, "line 65: there are more than 64 groups"}};
  for (const auto& [text, words] : cases) {
    const absl::Status status = ParseRedisGroups(text, "secret").status();
    EXPECT_THAT(std::string(status.message()), AllOf(HasSubstr(words), Not(HasSubstr("secret")))) << text;
  }
  EXPECT_THAT(std::string(OpenStore({.store = "redis-groups:/no/such/file"}).status().message()),
              HasSubstr("/no/such/file"));
}

class RedisGroupsTest : public testing::Test {
 protected:
  static RedisStoreOptions Options(const std::vector<std::pair<std::string, const RedisServer*>>& groups) {
    RedisStoreOptions options;
    for (const auto& [name, redis] : groups) {
      RedisClientOptions client;
      client.address = ParseRedisAddress(redis->url()).value();
      client.timeout = absl::Seconds(60);
      client.first_backoff = absl::ZeroDuration();
      options.groups.push_back({.name = name, .client = client});
    }
    return options;
  }
  std::unique_ptr<Store> Open() const { return OpenRedisStore(Options({{"a", &a_}, {"b", &b_}})).value(); }
  // Returns a name whose bucket belongs to group number `group`.
  static std::string NameIn(int group, const std::string& prefix = "sessions/") {
    std::string name = prefix;
    while (RedisBucketOf(name) % 2 != group) name += "x";
    return name;
  }

  RedisServer a_;
  RedisServer b_;
};

TEST_F(RedisGroupsTest, SessionsAreDivided) {
  const std::unique_ptr<Store> store = Open();
  for (int i = 0; i < 100; ++i) {
    ASSERT_TRUE(store->CreateSession({.name = absl::StrCat("sessions/", i), .tenant = "lab"}, "life").ok());
  }
  const auto count = [](const RedisServer& redis) { return redis.Run({"KEYS", "*:session:*"})->elements; };
  EXPECT_EQ(count(a_) + count(b_), 100u);
  EXPECT_GT(count(a_), 30u);
  EXPECT_GT(count(b_), 30u);
  EXPECT_EQ(NamesOf(*Open()).size(), 100u);
  // Pages, in the order of the names, over both groups.
  std::vector<std::string> names;
  std::string after;
  do {
    const SessionPage page = store->ListSessions("lab", after, 7).value();
    for (const SessionRecord& record : page.records) names.push_back(record.name);
    after = page.last_name;
  } while (!after.empty());
  EXPECT_EQ(names, NamesOf(*store));
  EXPECT_EQ(store->ReadOldestLifecycles(30)->size(), 30u);
  EXPECT_EQ(store->ReadOldestLifecycles(30)->front().name, "sessions/0");
  const std::vector<StoreGroup> groups = store->Groups();
  ASSERT_EQ(groups.size(), 2u);
  EXPECT_EQ(groups[0].name + groups[1].name, "ab");
  EXPECT_EQ(groups[0].parts, 128u);
  EXPECT_GT(store->Usage()->bytes, 0u);
  const std::optional<StoreUsage> usage = store->Usage();
  const std::vector<StoreGroup> used = store->Groups();
  EXPECT_GT(used[0].usage->cpu_s, 0.0);
  EXPECT_GT(used[1].usage->cpu_s, 0.0);
  EXPECT_EQ(usage->cpu_s, *used[0].usage->cpu_s + *used[1].usage->cpu_s);
  EXPECT_TRUE(store->Groups()[1].usage.has_value());
}

TEST_F(RedisGroupsTest, TheLossOfAGroupStopsOnlyItsSessions) {
  std::unique_ptr<Store> store = Open();
  const std::string in_a = NameIn(0);
  const std::string in_b = NameIn(1);
  auto lease_a = store->CreateSession(Record(in_a), "life").value();
  auto lease_b = store->CreateSession(Record(in_b), "life").value();
  ASSERT_TRUE(store->PutModel(Model(NameIn(0, "models/"), "", "bytes")).ok());
  b_.Kill();
  EXPECT_TRUE(CommitNow(*lease_a, {.checkpoint = "1"}).ok());
  EXPECT_EQ(CommitNow(*lease_b, {.checkpoint = "1"}).code(), StatusCode::kUnavailable);
  EXPECT_TRUE(store->AcquireSession(in_a).ok());
  EXPECT_EQ(store->AcquireSession(in_b).status().code(), StatusCode::kUnavailable);
  EXPECT_TRUE(store->CheckHealth().ok()) << "the server stays ready";
  EXPECT_TRUE(store->Groups()[0].health.ok());
  EXPECT_EQ(store->Groups()[1].health.code(), StatusCode::kUnavailable);
  EXPECT_GE(store->Groups()[0].commits, 1u);
  EXPECT_EQ(store->ListSessions("lab", "", 10).status().code(), StatusCode::kUnavailable) << "a part is no list";
  EXPECT_EQ(store->ListOwners().status().code(), StatusCode::kUnavailable);
  EXPECT_EQ(store->ReadOldestLifecycles(10)->size(), 1u);
  EXPECT_TRUE(store->DeleteEnded(absl::InfiniteFuture()).ok());
  // A server that starts meanwhile.
  store.reset();
  store = Open();
  EXPECT_TRUE(store->ListModels().ok());
  Store::AcquiredSession acquired = store->AcquireSession(in_a).value();
  EXPECT_TRUE(CommitNow(*acquired.lease, {.checkpoint = "2"}).ok());
  const absl::Status away = store->AcquireSession(in_b).status();
  EXPECT_EQ(away.code(), StatusCode::kUnavailable);
  EXPECT_THAT(std::string(away.message()), HasSubstr("in none of the Redis groups that respond"));
  b_.Start();
  EXPECT_TRUE(store->AcquireSession(in_b).ok());
  EXPECT_EQ(NamesOf(*store).size(), 2u);
  a_.Kill();
  b_.Kill();
  EXPECT_EQ(store->CheckHealth().code(), StatusCode::kUnavailable);
  EXPECT_EQ(store->ReadOldestLifecycles(10).status().code(), StatusCode::kUnavailable);
  EXPECT_EQ(OpenRedisStore(Options({{"a", &a_}, {"b", &b_}})).status().code(), StatusCode::kUnavailable);
}

TEST_F(RedisGroupsTest, ANewStoreNeedsAllItsGroups) {
  b_.Kill();
  EXPECT_EQ(OpenRedisStore(Options({{"a", &a_}, {"b", &b_}})).status().code(), StatusCode::kUnavailable);
  b_.Start();
  EXPECT_TRUE(OpenRedisStore(Options({{"b", &b_}, {"a", &a_}})).ok()) << "the order of the lines does not matter";
}

TEST_F(RedisGroupsTest, WrongFilesAreRefused) {
  { Open(); }
  const auto expect = [](const RedisStoreOptions& options, const std::string& words) {
    const absl::Status status = OpenRedisStore(options).status();
    EXPECT_EQ(status.code(), StatusCode::kFailedPrecondition) << status;
    EXPECT_THAT(std::string(status.message()), HasSubstr(words));
  };
  expect(Options({{"a", &b_}, {"b", &a_}}), "is the group b of a store with several groups");
  expect(Options({{"a", &a_}}), "is in the Redis group b, which --store redis-groups:FILE does not name: add it");
  expect(Options({{"", &a_}}), "give --store redis-groups:FILE with this name");
  RedisServer other;
  { OpenRedisStore(Options({{"c", &other}})).value(); }
  expect(Options({{"a", &a_}, {"b", &b_}, {"c", &other}}), "belong to different stores: correct the addresses");
}

TEST_F(RedisGroupsTest, TheOnlyGroupOfAStoreGetsAnother) {
  std::unique_ptr<Store> single = OpenRedisStore(Options({{"", &a_}})).value();
  auto lease = single->CreateSession(Record("sessions/x"), "life").value();
  EXPECT_TRUE(single->Groups().empty());
  const std::unique_ptr<Store> both = Open();
  EXPECT_TRUE(both->ReadSession("sessions/x").ok());
  EXPECT_EQ(both->Groups()[0].parts, 256u) << "the new group has no bucket yet";
  EXPECT_TRUE(CommitNow(*lease, {.checkpoint = "1"}).ok()) << "a server that knows one group goes on";
  EXPECT_EQ(both->ReadSession("sessions/x")->checkpoint, "1");
}

TEST_F(RedisGroupsTest, AStoreIsOpenedByTheNameOfItsFile) {
  const TemporaryDirectory directory;
  const std::string file = directory.path() + "/groups";
  std::ofstream(file) << "a " << a_.url() << "\nb " << b_.url() << "\n";
  const std::unique_ptr<Store> store = OpenStore({.store = "redis-groups:" + file}).value();
  EXPECT_EQ(store->Groups().size(), 2u);
  std::ofstream(file) << "a\n";
  EXPECT_THAT(std::string(OpenStore({.store = "redis-groups:" + file}).status().message()),
              HasSubstr("/groups: line 1: is not NAME ADDRESS"));
}

// Commits in a chain from a thread of the store until it is told to stop, and repeats a commit that ends with
// UNAVAILABLE, as a session does.
class MovingSession {
 public:
  MovingSession(Store& store, std::string name)
      : name_(std::move(name)),
        lease_(store.CreateSession(Record(name_), "life").value()),
        thread_([this] { Run(); }) {}
  ~MovingSession() { thread_.join(); }

  // Returns the number of acknowledged commits.
  uint64_t Stop() {
    is_stopped_ = true;
    return stopped_.get_future().get();
  }
  const std::string& name() const { return name_; }

 private:
  void Run() {
    uint64_t acknowledged = 0;
    while (!is_stopped_) {
      const uint64_t next = acknowledged + 1;
      const absl::Status status =
          CommitNow(*lease_, {.checkpoint = std::to_string(next), .poses = {Segment(name_, next, next)}});
      if (absl::IsUnavailable(status)) continue;
      EXPECT_EQ(status, absl::OkStatus()) << name_;
      if (!status.ok()) break;
      acknowledged = next;
    }
    stopped_.set_value(acknowledged);
  }

  const std::string name_;
  const std::unique_ptr<SessionLease> lease_;
  std::atomic<bool> is_stopped_ = false;
  std::promise<uint64_t> stopped_;
  std::thread thread_;  // the last member, because it uses the others
};

TEST_F(RedisGroupsTest, AGroupIsAddedWhileSessionsCommit) {
  RedisServer c;
  { Open(); }
  // This server knows the new group before it has buckets.
  const RedisStoreOptions options = Options({{"a", &a_}, {"b", &b_}, {"c", &c}});
  const std::unique_ptr<Store> store = OpenRedisStore(options).value();
  EXPECT_EQ(store->Groups()[2].parts, 0u);
  const SessionRecord idle = {.name = store->NewSessionName("lab", "1").value(), .tenant = "lab", .request_id = "1"};
  ASSERT_TRUE(store->CreateSession(idle, "idle").ok());
  for (int i = 0; i < 20; ++i) ASSERT_TRUE(store->PutModel(Model(absl::StrCat("models/", i), "lab", "bytes")).ok());
  std::vector<std::unique_ptr<MovingSession>> sessions;
  for (int i = 0; i < 6; ++i) {
    sessions.push_back(std::make_unique<MovingSession>(*store, absl::StrCat("sessions/", i)));
  }
  RedisGroups groups(options.groups);
  ASSERT_EQ(groups.Open(), absl::OkStatus());
  int num_moves = 0;
  ASSERT_EQ(groups.Divide([&](const RedisGroups::Move& move) {
    EXPECT_EQ(move.to, "c");
    if (++num_moves % 8 == 0) {
      EXPECT_EQ(NamesOf(*store).size(), 7u) << "bucket " << move.bucket;
    }
  }),
            absl::OkStatus());
  EXPECT_EQ(num_moves, 85);
  EXPECT_EQ(groups.Divide([](const RedisGroups::Move&) { ADD_FAILURE() << "it is divided"; }), absl::OkStatus());
  groups.Close();
  for (const auto& session : sessions) {
    const uint64_t acknowledged = session->Stop();
    EXPECT_GT(acknowledged, 1u);
    const StoredSession stored = store->ReadSession(session->name()).value();
    EXPECT_EQ(stored.checkpoint, std::to_string(acknowledged));
    ASSERT_EQ(stored.poses.size(), acknowledged);
    for (uint64_t seq = 1; seq <= acknowledged; ++seq) {
      ASSERT_EQ(stored.poses[seq - 1].bytes, Segment(session->name(), seq, seq).bytes);
    }
  }
  EXPECT_EQ(store->FindRequest("lab", "1")->name, idle.name);
  EXPECT_EQ(store->ListModels()->size(), 20u);
  EXPECT_EQ(store->ListSessions("lab", "", 10)->records.size(), 1u);
  EXPECT_GT(c.Run({"KEYS", "*:session:*"})->elements, 0u);
  for (const RedisServer* const redis : {&a_, &b_}) {
    const RedisReply keys = redis->Run({"KEYS", "*}:owners"});
    for (size_t i = 0; i < keys->elements; ++i) {
      const std::string key = RedisText(keys->element[i]);
      EXPECT_EQ(redis->Text({"HGET", key.substr(0, key.size() - 6) + "bucket", "state"}), "here") << "left behind";
    }
  }
  // A server that does not know the new group says so.
  const absl::Status unknown = OpenRedisStore(Options({{"a", &a_}, {"b", &b_}})).status();
  EXPECT_THAT(std::string(unknown.message()), HasSubstr("is in the Redis group c, which"));
}

// A server that has not called a bucket since it was moved has the old table when the old group is lost.
TEST_F(RedisGroupsTest, ABucketThatWasMovedFromALostGroupIsFound) {
  RedisServer c;
  { Open(); }
  const RedisStoreOptions options = Options({{"a", &a_}, {"b", &b_}, {"c", &c}});
  const std::unique_ptr<Store> store = OpenRedisStore(options).value();
  std::map<int, std::unique_ptr<SessionLease>> leases;  // by bucket
  for (int i = 0; i < 40; ++i) {
    const std::string name = absl::StrCat("sessions/", i);
    leases[RedisBucketOf(name)] = store->CreateSession(Record(name), "life").value();
  }
  RedisGroups groups(options.groups);
  ASSERT_EQ(groups.Open(), absl::OkStatus());
  std::set<int> moved;
  ASSERT_EQ(groups.Divide([&moved](const RedisGroups::Move& move) {
    if (move.from == "a") moved.insert(move.bucket);
  }),
            absl::OkStatus());
  groups.Close();
  std::erase_if(leases, [&moved](const auto& lease) { return !moved.contains(lease.first); });
  ASSERT_GT(leases.size(), 1u);
  a_.Kill();
  EXPECT_EQ(CommitNow(*leases.begin()->second, {.checkpoint = "1"}).code(), StatusCode::kUnavailable);
  EXPECT_EQ(store->CheckHealth(), absl::OkStatus());
  for (const auto& [bucket, lease] : leases) {
    EXPECT_EQ(CommitNow(*lease, {.checkpoint = "2"}), absl::OkStatus()) << "bucket " << bucket;
  }
}

TEST_F(RedisGroupsTest, AMoveThatWasInterruptedIsCompleted) {
  RedisServer c;
  { Open(); }
  const RedisStoreOptions options = Options({{"a", &a_}, {"b", &b_}, {"c", &c}});
  const std::unique_ptr<Store> store = OpenRedisStore(options).value();
  std::vector<std::string> names;
  std::vector<std::unique_ptr<SessionLease>> leases;
  for (const char* const prefix : {"sessions/moving", "sessions/leaving", "sessions/moved"}) {
    names.push_back(NameIn(0, prefix));
    leases.push_back(store->CreateSession(Record(names.back()), "life").value());
    ASSERT_TRUE(CommitNow(*leases.back(), {.checkpoint = "1"}).ok());
  }
  const auto run = [](const RedisServer& redis, const RedisScript& script, const std::string& name,
                      std::vector<std::string> arguments) {
    RedisCommand command = {"EVAL", script.source, "1", RedisBucketKey(RedisBucketOf(name))};
    command.insert(command.end(), arguments.begin(), arguments.end());
    return redis.Run(command);
  };
  for (const std::string& name : names) run(a_, kRedisBeginMove, name, {"c", "a program that was killed"});
  EXPECT_EQ(CommitNow(*leases[0], {.checkpoint = "2"}).code(), StatusCode::kUnavailable);
  EXPECT_EQ(store->ReadTenant(names[0]).status().code(), StatusCode::kUnavailable) << "it waits for some seconds";
  run(a_, kRedisLeave, names[1], {"a program that was killed"});
  run(a_, kRedisRevertMove, names[1], {"a program that was killed"});
  EXPECT_EQ(a_.Text({"HGET", RedisBucketKey(RedisBucketOf(names[1])), "state"}), "leaving") << "it is not reverted";
  run(a_, kRedisRevertMove, names[2], {"another program"});
  EXPECT_EQ(CommitNow(*leases[2], {.checkpoint = "2"}).code(), StatusCode::kUnavailable);
  run(a_, kRedisRevertMove, names[2], {"a program that was killed"});
  EXPECT_TRUE(CommitNow(*leases[2], {.checkpoint = "2"}).ok());
  RedisGroups groups(options.groups);
  ASSERT_EQ(groups.Open(), absl::OkStatus());
  ASSERT_EQ(groups.Divide([](const RedisGroups::Move&) {}), absl::OkStatus());
  groups.Close();
  for (size_t i = 0; i < names.size(); ++i) {
    absl::Status status;
    EXPECT_TRUE(Poll([&] {
      status = CommitNow(*leases[i], {.checkpoint = "3"});
      return !absl::IsUnavailable(status);
    }));
    EXPECT_EQ(status, absl::OkStatus()) << names[i];
    EXPECT_EQ(store->ReadSession(names[i])->checkpoint, "3");
  }
  EXPECT_EQ(c.Run({"EXISTS", RedisSessionKey(names[0])})->integer, 1);
  EXPECT_EQ(c.Run({"EXISTS", RedisSessionKey(names[1])})->integer, 1);
}

// The words of a line of MONITOR, without the time and the client: "EVALSHA" "..." in quotes.
std::vector<std::string> WordsOf(const std::string& line) {
  std::vector<std::string> words;
  for (const absl::string_view word : absl::StrSplit(line, "\" \"")) words.emplace_back(word);
  if (!words.empty()) words.front() = words.front().substr(words.front().find('"') + 1);
  if (!words.empty() && absl::EndsWith(words.back(), "\"")) words.back().pop_back();
  return words;
}

// In cluster mode Redis rejects keys of several hash slots, but not a key of the same slot that is not declared.
TEST(RedisClusterTest, ScriptsUseOnlyTheKeysThatTheyDeclare) {
  const RedisServer redis({"--cluster-enabled", "yes"}, "", RedisServer::Listens::kOnPortToo);
  EXPECT_EQ(redis.Text({"CLUSTER", "ADDSLOTSRANGE", "0", "16383"}), "OK");
  ASSERT_TRUE(Poll([&] { return absl::StrContains(redis.Text({"CLUSTER", "INFO"}), "cluster_state:ok"); }));
  const std::unique_ptr<Store> store = OpenStore({.store = redis.url()}).value();
  RedisFeed commands(ParseRedisAddress(redis.url()).value(), {"MONITOR"});
  SessionRecord record = {.name = store->NewSessionName("lab", "1").value(), .tenant = "lab", .request_id = "1"};
  for (int i = 0; i < 2; ++i) {
    auto lease = store->CreateSession(record, "life").value();
    EXPECT_EQ(store->CreateSession(record, "life").status().code(), StatusCode::kAlreadyExists);
    for (uint64_t seq = 1; seq < 4; ++seq) {
      ASSERT_TRUE(CommitNow(*lease, {.checkpoint = "1", .lifecycle = "2", .poses = {Segment("a", seq, seq)}}).ok());
    }
    lease = store->AcquireSession(record.name).value().lease;
    ASSERT_TRUE(CommitNow(*lease, {.poses = {Segment("a", 4, 4)},
                                   .first_pose_seq_kept = 3,
                                   .ended_at = absl::FromUnixSeconds(1'700'000'000)})
                    .ok());
    EXPECT_TRUE(store->ReadSession(record.name, 2).ok());
    if (i == 0) {
      EXPECT_EQ(store->DeleteEnded(absl::InfiniteFuture())->size(), 1u);
    } else {
      EXPECT_TRUE(store->DeleteSession(record.name).ok());
    }
  }
  ASSERT_TRUE(store->PutModel(Model("models/a", "tenant", "bytes")).ok());
  ASSERT_TRUE(store->DeleteModel("tenant", "models/a").ok());
  EXPECT_EQ(store->ListSessions("lab", "", 10)->records.size(), 0u);
  redis.Run({"ECHO", "the end"});
  std::set<std::string> declared;
  std::set<std::string> scripts;
  size_t num_keys = 0;
  for (std::string line = commands.Next(); !absl::StrContains(line, "\"ECHO\""); line = commands.Next()) {
    const std::vector<std::string> words = WordsOf(line);
    if (words[0] == "EVALSHA") {
      const auto num_declared = std::stoul(words[2]);
      declared = std::set<std::string>(words.begin() + 3, words.begin() + 3 + static_cast<ptrdiff_t>(num_declared));
      scripts.insert(words[1]);
    }
    if (!absl::StrContains(line, " lua] ")) continue;
    for (const std::string& word : words) {
      if (!absl::StartsWith(word, "evpose:")) continue;
      EXPECT_TRUE(declared.contains(word)) << line;
      ++num_keys;
    }
  }
  EXPECT_EQ(scripts.size(), 7u) << "all scripts on sessions and models";
  EXPECT_GT(num_keys, 100u);
}

}  // namespace
}  // namespace evpose::server

// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/durability/orphan_collector.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "server/sessions/durability/session_codec.h"
#include "server/sessions/session_testing.h"
#include "server/sessions/store_testing.h"
#include "server/stores/memory/memory_store.h"
#include "server/stores/open_store.h"
#include "server/stores/redis/redis_testing.h"
#include "server/stores/sqlite/sqlite_store.h"
#include "server/stores/store_suite_testing.h"
#include "server/telemetry/log_testing.h"

namespace evpose::server {
namespace {

constexpr absl::Duration kExpiry = absl::Minutes(1);

// Runs `hook`, once, when the lifecycles have been read.
class HookedStore : public FaultInjectingStore {
 public:
  using FaultInjectingStore::FaultInjectingStore;
  absl::StatusOr<std::vector<StoredLifecycle>> ReadOldestLifecycles(size_t max_sessions) const override {
    auto lifecycles = FaultInjectingStore::ReadOldestLifecycles(max_sessions);
    if (const auto once = std::exchange(hook, nullptr)) once();
    return lifecycles;
  }

  mutable std::function<void()> hook;
};

class OrphanCollectorTest : public testing::TestWithParam<std::string> {
 protected:
  std::shared_ptr<Store> OpenStore() {
    if (GetParam() == "Memory") return MakeMemoryStore();
    if (GetParam() == "Sqlite") return OpenSqliteStore({.data_dir = directory_.path() + "/data"}).value();
    redis_ = std::make_unique<RedisServer>();
    return server::OpenStore({.store = redis_->url()}).value();
  }
  void Collect(absl::Duration later = kExpiry / 2) { Collect(collector_, later); }
  void Collect(OrphanCollector& collector, absl::Duration later) {
    now_ += later;
    collector.Collect(
        now_, 1, [](const std::string& name) { return name == "sessions/here"; },
        [this](const std::string& name) { deleted_.push_back(name); });
  }
  std::vector<std::string> Names() { return NamesOf(*store_); }

  const TemporaryDirectory directory_;
  std::unique_ptr<RedisServer> redis_;
  absl::Time now_ = absl::FromUnixSeconds(1'000'000);
  const std::shared_ptr<InjectedFault> fault_ = std::make_shared<InjectedFault>();
  const std::shared_ptr<Store> store_ = OpenStore();
  HookedStore hooked_{store_, fault_};
  OrphanCollector collector_{hooked_, kExpiry, /*shares_store=*/true};
  std::vector<std::string> deleted_;
};

INSTANTIATE_TEST_SUITE_P(Stores, OrphanCollectorTest, testing::Values("Memory", "Sqlite", "Redis"),
                         [](const auto& tested) { return tested.param; });

TEST_P(OrphanCollectorTest, DeletesWhatNoServerRenews) {
  ASSERT_TRUE(store_->CreateSession(Record("sessions/dead"), "attached").ok());
  ASSERT_TRUE(store_->CreateSession(Record("sessions/here"), "attached").ok());
  const auto alive = store_->CreateSession(Record("sessions/alive"), "attached").value();
  for (int i = 0; i < 4; ++i) {
    Collect();
    ASSERT_TRUE(CommitNow(*alive, {.lifecycle = std::to_string(i)}).ok());
    EXPECT_EQ(Names().size(), 3u) << "the grace period has not passed";
  }
  for (int i = 4; i < 10; ++i) {
    Collect();
    ASSERT_TRUE(CommitNow(*alive, {.lifecycle = std::to_string(i)}).ok()) << "the lease is still valid";
    EXPECT_THAT(Names(), testing::ElementsAre("sessions/alive", "sessions/here"));
  }
  EXPECT_THAT(deleted_, testing::ElementsAre("sessions/dead"));
}

TEST_P(OrphanCollectorTest, TheLogHasTheSumsOfWhatIsDeleted) {
  SessionRecord record = Record("sessions/dead");
  record.config = EncodeConfig(SomeConfig());
  record.create_time = now_;
  const SessionLifecycle lifecycle = {.token_digest = TokenDigest("x"), .num_attaches = 3};
  SessionCheckpoint checkpoint;
  checkpoint.health.poses = 9;
  checkpoint.health.processed_bytes = 456;
  checkpoint.health.objects.resize(1);
  checkpoint.pipeline.emplace().position.reported_states = {TrackState::kTracking};
  for (const bool has_ended : {false, true}) {
    checkpoint.has_ended = has_ended;
    const auto lease = store_->CreateSession(record, EncodeLifecycle(lifecycle)).value();
    ASSERT_TRUE(CommitNow(*lease, {.checkpoint = EncodeCheckpoint(checkpoint), .poses = {{1, 9, "poses"}}}).ok());
    captured_log.Take();
    const absl::Time begin = now_;
    for (int i = 0; i < 5; ++i) Collect();
    EXPECT_TRUE(Names().empty());
    const std::string log = captured_log.Take();
    EXPECT_THAT(log, testing::StartsWith("info session_deleted session=sessions/dead "));
    if (has_ended) {
      EXPECT_THAT(log, testing::Not(testing::HasSubstr("poses="))) << "session_ended had the sums";
      continue;
    }
    EXPECT_EQ(begin, record.create_time);
    EXPECT_THAT(log, testing::HasSubstr(" cause=expired lifetime_us=150000000 objects=1 poses=9 "));
    EXPECT_THAT(log, testing::EndsWith(" reattaches=2\n"));
  }
}

TEST_P(OrphanCollectorTest, WithoutOtherServersTheExpiryTimeIsWaitedOnce) {
  ASSERT_TRUE(store_->CreateSession(Record("sessions/dead"), "attached").ok());
  OrphanCollector collector(hooked_, kExpiry, /*shares_store=*/false);
  for (int i = 0; i < 2; ++i) Collect(collector, kExpiry / 2);
  EXPECT_EQ(Names().size(), 1u);
  Collect(collector, kExpiry / 2);
  EXPECT_TRUE(Names().empty());
}

TEST_P(OrphanCollectorTest, ARenewalDuringTheCollectionKeepsTheSession) {
  const auto lease = store_->CreateSession(Record("sessions/late"), "attached").value();
  for (int i = 0; i < 4; ++i) Collect();
  hooked_.hook = [&lease] { ASSERT_TRUE(CommitNow(*lease, {.lifecycle = "attached again"}).ok()); };
  Collect();
  EXPECT_EQ(store_->ReadSession("sessions/late")->lifecycle, "attached again");

  for (int i = 0; i < 4; ++i) Collect();
  hooked_.hook = [this] { ASSERT_TRUE(store_->AcquireSession("sessions/late").ok()); };
  Collect();
  EXPECT_TRUE(Names().empty()) << "taking a session does not renew its lifecycle record";
}

TEST_P(OrphanCollectorTest, TimeWithoutAccessToTheStoreDoesNotCount) {
  ASSERT_TRUE(store_->CreateSession(Record("sessions/a"), "attached").ok());
  Collect();
  Collect(10 * kExpiry);
  EXPECT_EQ(Names().size(), 1u) << "this server was suspended";
  fault_->Set(absl::UnavailableError("unreachable"));
  for (int i = 0; i < 10; ++i) Collect();
  fault_->Set(absl::OkStatus());
  for (int i = 0; i < 4; ++i) Collect();
  EXPECT_EQ(Names().size(), 1u) << "the store was unreachable";
  Collect();
  EXPECT_TRUE(Names().empty());
}

}  // namespace
}  // namespace evpose::server

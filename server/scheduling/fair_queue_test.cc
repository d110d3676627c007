// SPDX-License-Identifier: Apache-2.0
#include "server/scheduling/fair_queue.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <memory>
#include <string>
#include <vector>

namespace evpose::server {
namespace {

using std::chrono::milliseconds;
using ::testing::ElementsAre;

// Sessions on one place, with turns of one millisecond of processor time, which is also the time on the clock.
class FairQueueTest : public testing::Test {
 protected:
  SessionShare& AddSession(const std::string& tenant, bool is_replay) {
    SessionShare& session = *sessions_.emplace_back(std::make_unique<SessionShare>());
    session.tenant = queue_->FindTenant(tenant);
    if (is_replay) session.since_drained = milliseconds(1000);
    return session;
  }
  // Runs turns and returns their sessions. Sessions in `endless` go on, the others become idle.
  std::vector<SessionShare*> Run(int num_turns, const std::vector<SessionShare*>& endless) {
    std::vector<SessionShare*> turns;
    for (int i = 0; i < num_turns; ++i) {
      SessionShare* const session = queue_->Pop(now_);
      if (session == nullptr) break;
      turns.push_back(session);
      now_ += milliseconds(1);
      queue_->Charge(*session, milliseconds(1), now_);
      if (std::find(endless.begin(), endless.end(), session) != endless.end()) {
        queue_->Push(*session);
      } else {
        queue_->Remove(*session);
      }
    }
    return turns;
  }
  static auto Count(const std::vector<SessionShare*>& turns, const SessionShare& session) {
    return std::count(turns.begin(), turns.end(), &session);
  }

  FairQueue::Time now_ = FairQueue::Time(std::chrono::hours(1));
  std::unique_ptr<FairQueue> queue_ = std::make_unique<FairQueue>(CpuLimits());
  std::vector<std::unique_ptr<SessionShare>> sessions_;
};

TEST_F(FairQueueTest, CamerasComeBeforeReplaysAndTheOldestReceiptFirst) {
  SessionShare& replay = AddSession("", true);
  SessionShare& late = AddSession("", false);
  SessionShare& early = AddSession("", false);
  replay.received_at = now_ - milliseconds(100);
  late.received_at = now_ - milliseconds(1);
  early.received_at = now_ - milliseconds(2);
  for (SessionShare* session : {&replay, &late, &early}) queue_->Add(*session);
  EXPECT_THAT(Run(4, {&replay}), ElementsAre(&early, &late, &replay, &replay));
}

TEST_F(FairQueueTest, ASessionWhoseDataWaitLosesItsPriority) {
  const auto expect_turns_with_priority = [this](Arrival arrival, int num_turns) {
    SessionShare& session = AddSession("", false);
    FairQueue::SetArrival(session, arrival);
    queue_->Add(session);
    Run(num_turns - 1, {&session});
    EXPECT_TRUE(session.KeepsPace());
    Run(1, {&session});
    EXPECT_FALSE(session.KeepsPace());
    queue_->Pop(now_);
  };
  expect_turns_with_priority(Arrival::kBulk, 10);
  expect_turns_with_priority(Arrival::kLive, 100);
}

TEST_F(FairQueueTest, ACameraThatHasKeptItsPaceMayCatchUp) {
  SessionShare& camera = AddSession("", false);
  camera.RecordDrained(now_);
  now_ += std::chrono::seconds(1);
  camera.RecordDrained(now_);
  queue_->Add(camera);
  Run(299, {&camera});
  EXPECT_TRUE(camera.KeepsPace()) << "100 ms and a fifth of a second";
  Run(1, {&camera});
  EXPECT_FALSE(camera.KeepsPace());
  camera.RecordDrained(now_);
  Run(100, {&camera});
  EXPECT_FALSE(camera.KeepsPace()) << "it has to earn it again";
}

// Its data cost 0.4 of the time, and it has lost its priority with 300 ms of work behind.
TEST_F(FairQueueTest, ACameraThatHasLostItsPriorityCatchesUpBesideReplays) {
  std::vector<SessionShare*> all = {&AddSession("", true)};
  SessionShare& camera = *all[0];
  for (int i = 0; i < 8; ++i) all.push_back(&AddSession("", true));
  for (size_t i = 1; i < all.size(); ++i) FairQueue::SetArrival(*all[i], Arrival::kBulk);
  for (SessionShare* session : all) queue_->Add(*session);
  double behind_ms = 300.0;
  int turns = 0, of_replays = 0;
  for (; behind_ms > 0.0 && turns < 5000; ++turns) {
    const bool is_camera = Run(1, all)[0] == &camera;
    behind_ms += 0.4 - (is_camera ? 1.0 : 0.0);
    of_replays += !is_camera;
  }
  EXPECT_LT(turns, 700) << "300 ms / (7/8 - 0.4) = 632 turns";
  EXPECT_NEAR(of_replays, 0.125 * turns, 2.0) << "replays continue beside a live session, however much it needs";
}

TEST_F(FairQueueTest, AReplayGetsNoMoreThanALiveSession) {
  std::vector<SessionShare*> all;
  for (int i = 0; i < 15; ++i) all.push_back(&AddSession("", true));
  for (SessionShare* session : all) queue_->Add(*session);
  SessionShare& replay = *all[0];
  FairQueue::SetArrival(replay, Arrival::kBulk);
  EXPECT_NEAR(Count(Run(1500, all), replay), 100, 2);
  FairQueue::SetArrival(replay, Arrival::kLive);
  EXPECT_NEAR(Count(Run(1500, all), replay), 100, 2);
}

TEST_F(FairQueueTest, ACameraThatIsLateContinuesBesideOthersThatTakeAllTheTime) {
  SessionShare& late = AddSession("", true);
  SessionShare& punctual = AddSession("", false);
  for (SessionShare* session : {&late, &punctual}) queue_->Add(*session);
  int of_late = 0;
  for (int i = 0; i < 1600; ++i) {
    punctual.RecordDrained(now_);
    of_late += Run(1, {&late, &punctual})[0] == &late;
  }
  EXPECT_EQ(of_late, 100);
}

// The time that a session used by its priority does not reduce its share afterwards.
TEST_F(FairQueueTest, ACameraThatHasJustLostItsPriorityDoesNotWait) {
  SessionShare& late = AddSession("", true);
  SessionShare& camera = AddSession("", false);
  for (SessionShare* session : {&late, &camera}) queue_->Add(*session);
  for (int i = 0; i < 3000; ++i) {
    camera.RecordDrained(now_);
    Run(1, {&late, &camera});
  }
  Run(1000, {&late, &camera});
  ASSERT_FALSE(camera.KeepsPace());
  EXPECT_NEAR(Count(Run(100, {&late, &camera}), camera), 50, 2);
}

TEST_F(FairQueueTest, ReplaysShareByTenantThenBySession) {
  SessionShare& alone = AddSession("alice", true);
  std::vector<SessionShare*> all = {&alone};
  for (int i = 0; i < 4; ++i) all.push_back(&AddSession("bob", true));
  for (SessionShare* session : all) queue_->Add(*session);
  const std::vector<SessionShare*> turns = Run(800, all);
  EXPECT_NEAR(Count(turns, alone), 400, 2);
  for (int i = 1; i <= 4; ++i) EXPECT_NEAR(Count(turns, *all[i]), 100, 2);
}

TEST_F(FairQueueTest, IdleTimeIsNotSavedUp) {
  SessionShare& busy = AddSession("alice", true);
  SessionShare& idle = AddSession("bob", true);
  queue_->Add(busy);
  Run(5000, {&busy});
  queue_->Add(idle);
  const std::vector<SessionShare*> turns = Run(1000, {&busy, &idle});
  EXPECT_GE(Count(turns, idle), 500);
  EXPECT_LE(Count(turns, idle), 560) << "its share and the credit of 100 ms";
}

// Its chunks arrive one by one, so that none waits for long, but they take all the time.
TEST_F(FairQueueTest, ATenantThatExceedsItsShareHasNoPriority) {
  SessionShare& greedy = AddSession("mallory", false);
  SessionShare& camera = AddSession("alice", false);
  queue_->Add(greedy);
  int late = 0;
  for (int i = 0; i < 1000; ++i) {
    if (i % 10 == 0) {
      camera.since_drained = {};
      camera.received_at = now_;
      queue_->Add(camera);
    }
    greedy.since_drained = {};
    greedy.received_at = now_ - milliseconds(1);  // always the oldest
    const std::vector<SessionShare*> turn = Run(1, {&greedy});
    if (i >= 300 && i % 10 == 0) late += turn[0] != &camera;
  }
  EXPECT_EQ(late, 0);
}

TEST_F(FairQueueTest, ALimitedSessionWaits) {
  queue_ = std::make_unique<FairQueue>(CpuLimits{.session = 0.25});
  SessionShare& session = AddSession("", true);
  queue_->Add(session);
  int turns = 0;
  for (int i = 0; i < 10'000; ++i) {
    const bool has_turn = !Run(1, {&session}).empty();
    turns += has_turn;
    if (!has_turn) {
      EXPECT_GT(queue_->NextTurnAt().value(), now_);
      now_ += milliseconds(1);
    }
  }
  EXPECT_NEAR(turns, 2500, 50);
  EXPECT_NEAR(session.meter.Rate(now_), 0.25, 0.05);
  now_ = queue_->NextTurnAt().value();
  EXPECT_EQ(queue_->Pop(now_), &session);
  queue_->Push(session);
  queue_->Charge(session, std::chrono::seconds(10), now_);
  EXPECT_EQ(queue_->Pop(now_), nullptr);
  queue_->RemoveLimits();
  EXPECT_EQ(queue_->Pop(now_), &session);
}

TEST_F(FairQueueTest, TheLimitOfATenantHoldsForAllItsSessionsTogether) {
  queue_ = std::make_unique<FairQueue>(CpuLimits{.tenant = 0.25});
  std::vector<SessionShare*> all;
  for (int i = 0; i < 4; ++i) all.push_back(&AddSession("mallory", true));
  for (SessionShare* session : all) queue_->Add(*session);
  int turns = 0;
  for (int i = 0; i < 10'000; ++i) {
    const bool has_turn = !Run(1, all).empty();
    turns += has_turn;
    if (!has_turn) now_ += milliseconds(1);
  }
  EXPECT_NEAR(turns, 2500, 50);
  SessionShare& other = AddSession("alice", true);
  queue_->Add(other);
  EXPECT_EQ(queue_->Pop(now_), &other) << "the limit of one tenant does not delay another";
}

TEST_F(FairQueueTest, TenantsAreForgottenWithTheirSessions) {
  std::shared_ptr<TenantShare> tenant = queue_->FindTenant("alice");
  EXPECT_EQ(queue_->FindTenant("alice"), tenant);
  tenant->used_s = 5.0;
  tenant.reset();
  EXPECT_EQ(queue_->FindTenant("alice")->used_s, 0.0);
}

}  // namespace
}  // namespace evpose::server

// SPDX-License-Identifier: Apache-2.0

// The tests that every kind of store passes.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <memory>
#include <string>
#include <thread>

#include "absl/strings/str_cat.h"
#include "server/stores/common/store.h"
#include "server/stores/store_fixtures_testing.h"

namespace evpose::server {
namespace {

using absl::StatusCode;
using testing::ElementsAre;

INSTANTIATE_TEST_SUITE_P(Stores, StoreSuite, kTestedStores, NameOfTestedStore);

std::vector<std::string> Names(const SessionPage& page) {
  std::vector<std::string> names;
  for (const SessionRecord& record : page.records) names.push_back(record.name);
  return names;
}

TEST_P(StoreSuite, ReturnsCommittedData) {
  SessionRecord record = Record(store_->NewSessionName("lab", "request").value());
  record.tenant = "lab";
  record.request_id = "request";
  auto lease = store_->CreateSession(record, "life 0").value();
  const std::string checkpoint("check\0point", 11);
  ASSERT_TRUE(
      CommitNow(*lease,
                {.checkpoint = checkpoint, .lifecycle = "life 1", .poses = {Segment("a", 1, 3), Segment("a", 4, 4)}})
          .ok());
  ASSERT_TRUE(CommitNow(*lease, {.poses = {Segment("a", 5, 9)}}).ok()) << "nothing else changes";
  if (fixture_->keeps()) Reopen();
  const StoredSession session = store_->ReadSession(record.name).value();
  EXPECT_EQ(session.record.name, record.name);
  EXPECT_EQ(session.record.tenant, "lab");
  EXPECT_EQ(session.record.request_id, "request");
  EXPECT_EQ(session.record.create_time, record.create_time);
  EXPECT_EQ(session.record.config, record.config);
  EXPECT_EQ(session.checkpoint, checkpoint);
  EXPECT_EQ(session.lifecycle, "life 1");
  ASSERT_EQ(Ranges(session.poses), "1-3 4-4 5-9");
  EXPECT_EQ(session.poses[2].bytes, "a poses 5 to 9");
  EXPECT_TRUE(store_->CheckHealth().ok());
  EXPECT_THAT(store_->damage(), testing::IsEmpty());
}

TEST_P(StoreSuite, ASessionStartsEmpty) {
  auto lease = store_->CreateSession(Record("sessions/a"), "life 0").value();
  ASSERT_TRUE(CommitNow(*lease, {}).ok());
  const StoredSession session = store_->ReadSession("sessions/a").value();
  EXPECT_EQ(session.lifecycle, "life 0");
  EXPECT_EQ(session.checkpoint, "");
  EXPECT_TRUE(session.poses.empty());
  EXPECT_TRUE(CommitNow(*lease, {.checkpoint = "", .lifecycle = ""}).ok());
  EXPECT_EQ(store_->ReadSession("sessions/a")->lifecycle, "");
}

TEST_P(StoreSuite, TakingASessionFencesThePreviousHolder) {
  auto first = store_->CreateSession(Record("sessions/a"), "life 0").value();
  ASSERT_TRUE(CommitNow(*first, {.checkpoint = "1", .poses = {Segment("a", 1, 3)}}).ok());
  Store::AcquiredSession second = store_->AcquireSession("sessions/a").value();
  EXPECT_GT(second.lease->token().number, first->token().number);
  EXPECT_NE(second.lease->token().holder, first->token().holder);
  EXPECT_EQ(second.session.checkpoint, "1");
  EXPECT_EQ(CommitNow(*first, {.checkpoint = "x", .lifecycle = "x", .poses = {Segment("x", 4, 5)}}).code(),
            StatusCode::kAborted);
  EXPECT_EQ(store_->ReadSession("sessions/a")->checkpoint, "1");
  EXPECT_EQ(store_->ReadSession("sessions/a")->lifecycle, "life 0");
  EXPECT_EQ(Ranges(store_->ReadSession("sessions/a")->poses), "1-3");
  EXPECT_TRUE(CommitNow(*second.lease, {.checkpoint = "2", .poses = {Segment("a", 4, 5)}}).ok());
  EXPECT_EQ(Ranges(store_->ReadSession("sessions/a")->poses), "1-3 4-5");
}

TEST_P(StoreSuite, ADeletedSessionIsNotFound) {
  auto lease = store_->CreateSession(Record("sessions/a"), "").value();
  EXPECT_EQ(store_->CreateSession(Record("sessions/a"), "").status().code(), StatusCode::kAlreadyExists);
  ASSERT_TRUE(CommitNow(*lease, {.checkpoint = "1", .poses = {Segment("a", 1, 3)}}).ok());
  EXPECT_TRUE(store_->DeleteSession("sessions/a").ok());
  EXPECT_TRUE(store_->DeleteSession("sessions/a").ok()) << "deleting a session that does not exist is OK";
  EXPECT_EQ(CommitNow(*lease, {.checkpoint = "x"}).code(), StatusCode::kNotFound);
  EXPECT_EQ(store_->ReadSession("sessions/a").status().code(), StatusCode::kNotFound);
  EXPECT_EQ(store_->AcquireSession("sessions/a").status().code(), StatusCode::kNotFound);
  EXPECT_THAT(NamesOf(*store_), ElementsAre());

  auto again = store_->CreateSession(Record("sessions/a"), "life").value();
  EXPECT_GT(again->token().number, lease->token().number);
  EXPECT_EQ(CommitNow(*lease, {.checkpoint = "x"}).code(), StatusCode::kAborted) << "the name belongs to a new session";
  const StoredSession session = store_->ReadSession("sessions/a").value();
  EXPECT_EQ(session.checkpoint, "");
  EXPECT_TRUE(session.poses.empty());
}

TEST_P(StoreSuite, APreviousHolderCannotDeleteASession) {
  auto first = store_->CreateSession(Record("sessions/a"), "life").value();
  const auto second = store_->AcquireSession("sessions/a").value().lease;
  EXPECT_EQ(store_->DeleteHeldSession("sessions/a", first->token()).code(), StatusCode::kAborted);
  EXPECT_TRUE(CommitNow(*second, {.checkpoint = "1"}).ok());
  EXPECT_TRUE(store_->DeleteHeldSession("sessions/a", second->token()).ok());
  EXPECT_EQ(store_->ReadSession("sessions/a").status().code(), StatusCode::kNotFound);
  EXPECT_TRUE(store_->DeleteHeldSession("sessions/a", second->token()).ok()) << "the session does not exist";
  EXPECT_THAT(NamesOf(*store_), ElementsAre());
}

TEST_P(StoreSuite, ListsTheSessionsOfATenantByPages) {
  EXPECT_THAT(NamesOf(*store_), ElementsAre());
  EXPECT_TRUE(store_->ListSessions("lab", "", 10)->records.empty());
  for (const auto& [name, tenant] :
       {std::pair("sessions/c", "lab"), {"sessions/a", "lab"}, {"sessions/d", "lab"}, {"sessions/b", "lab-2"}}) {
    ASSERT_TRUE(store_->CreateSession({.name = name, .tenant = tenant, .config = name}, "").ok());
  }
  if (fixture_->keeps()) Reopen();
  EXPECT_THAT(NamesOf(*store_), ElementsAre("sessions/a", "sessions/b", "sessions/c", "sessions/d"));
  EXPECT_EQ(store_->ListOwners()->at(1).tenant, "lab-2");
  const SessionPage first = store_->ListSessions("lab", "", 2).value();
  EXPECT_THAT(Names(first), ElementsAre("sessions/a", "sessions/c"));
  EXPECT_EQ(first.last_name, "sessions/c");
  EXPECT_EQ(first.records[1].config, "sessions/c");
  const SessionPage second = store_->ListSessions("lab", first.last_name, 2).value();
  EXPECT_THAT(Names(second), ElementsAre("sessions/d"));
  EXPECT_EQ(second.last_name, "");
  EXPECT_THAT(Names(store_->ListSessions("lab-2", "", 1).value()), ElementsAre("sessions/b"));
  EXPECT_THAT(Names(store_->ListSessions("lab", "sessions/bb", 1).value()), ElementsAre("sessions/c"));
  EXPECT_TRUE(store_->ListSessions("la", "", 10)->records.empty());

  ASSERT_TRUE(store_->DeleteSession("sessions/c").ok());
  EXPECT_THAT(Names(store_->ListSessions("lab", "", 10).value()), ElementsAre("sessions/a", "sessions/d"));
  EXPECT_THAT(NamesOf(*store_), ElementsAre("sessions/a", "sessions/b", "sessions/d"));
}

TEST_P(StoreSuite, ATenantHasOneSessionForARequest) {
  const auto record = [this](const std::string& tenant, const std::string& request_id) {
    return SessionRecord{.name = store_->NewSessionName(tenant, request_id).value(),
                         .tenant = tenant,
                         .request_id = request_id,
                         .config = "config"};
  };
  const SessionRecord first = record("lab", "1");
  const SessionRecord of_other = record("other", "1");
  ASSERT_TRUE(store_->CreateSession(first, "").ok());
  EXPECT_EQ(store_->CreateSession(record("lab", "1"), "").status().code(), StatusCode::kAlreadyExists);
  EXPECT_TRUE(store_->CreateSession(record("lab", "2"), "").ok());
  EXPECT_TRUE(store_->CreateSession(of_other, "").ok());
  for (int i = 0; i < 2; ++i) {
    EXPECT_TRUE(store_->CreateSession(record("lab", ""), "").ok()) << "an empty request_id is none";
  }
  if (fixture_->keeps()) Reopen();
  EXPECT_EQ(store_->FindRequest("lab", "1")->name, first.name);
  EXPECT_EQ(store_->FindRequest("lab", "1")->config, "config");
  EXPECT_EQ(store_->FindRequest("other", "1")->name, of_other.name);
  EXPECT_EQ(store_->FindRequest("other", "2").status().code(), StatusCode::kNotFound);
  EXPECT_EQ(store_->FindRequest("lab", "").status().code(), StatusCode::kNotFound);
  ASSERT_TRUE(store_->DeleteSession(first.name).ok());
  EXPECT_EQ(store_->FindRequest("lab", "1").status().code(), StatusCode::kNotFound);
  EXPECT_EQ(store_->ReadTenant(first.name).status().code(), StatusCode::kNotFound);
  const SessionRecord again = record("lab", "1");
  ASSERT_TRUE(store_->CreateSession(again, "").ok());
  EXPECT_EQ(store_->FindRequest("lab", "1")->name, again.name);
  EXPECT_EQ(store_->ReadTenant(again.name).value(), "lab");
}

TEST_P(StoreSuite, ReturnsTheLifecyclesThatWereWrittenLeastRecently) {
  EXPECT_TRUE(store_->ReadOldestLifecycles(10)->empty());
  ASSERT_TRUE(store_->CreateSession(Record("sessions/c"), "c").ok());
  auto b = store_->CreateSession(Record("sessions/b"), "b").value();
  auto a = store_->CreateSession(Record("sessions/a"), "a").value();
  ASSERT_TRUE(CommitNow(*b, {.lifecycle = "b again"}).ok());
  ASSERT_TRUE(CommitNow(*a, {.checkpoint = "1"}).ok());
  if (fixture_->keeps()) Reopen();
  const auto texts = [this](size_t max_sessions) {
    const std::vector<StoredLifecycle> lifecycles = store_->ReadOldestLifecycles(max_sessions).value();
    std::vector<std::string> found;
    for (const StoredLifecycle& stored : lifecycles) found.push_back(stored.name + ": " + stored.lifecycle);
    return found;
  };
  EXPECT_THAT(texts(10), ElementsAre("sessions/c: c", "sessions/a: a", "sessions/b: b again"));
  EXPECT_THAT(texts(2), ElementsAre("sessions/c: c", "sessions/a: a"));
  ASSERT_TRUE(store_->DeleteSession("sessions/c").ok());
  EXPECT_THAT(texts(10), ElementsAre("sessions/a: a", "sessions/b: b again"));
}

TEST_P(StoreSuite, ReadsTheSegmentsAfterAPose) {
  auto lease = store_->CreateSession(Record("sessions/a"), "").value();
  ASSERT_TRUE(CommitNow(*lease, {.checkpoint = "state",
                                 .poses = {Segment("a", 1, 10), Segment("a", 11, 20), Segment("a", 21, 30)},
                                 .first_pose_seq_kept = 11})
                  .ok());
  const auto ranges_after = [&](uint64_t seq) { return Ranges(store_->ReadSession("sessions/a", seq)->poses); };
  EXPECT_EQ(ranges_after(0), "11-20 21-30");
  EXPECT_EQ(ranges_after(11), "11-20 21-30");
  EXPECT_EQ(ranges_after(19), "11-20 21-30");
  EXPECT_EQ(ranges_after(20), "21-30");
  EXPECT_EQ(ranges_after(29), "21-30");
  EXPECT_EQ(ranges_after(30), "");
  EXPECT_EQ(ranges_after(1'000'000), "");
  EXPECT_EQ(store_->ReadSession("sessions/a", 30)->checkpoint, "state");
  EXPECT_EQ(store_->ReadSession("sessions/b", 30).status().code(), StatusCode::kNotFound);
}

TEST_P(StoreSuite, ReadsSeveralSessionsWithoutTheirPoses) {
  for (const char* const name : {"sessions/a", "sessions/b", "sessions/c"}) {
    auto lease = store_->CreateSession(Record(name), absl::StrCat("life of ", name)).value();
    if (name == absl::string_view("sessions/c")) continue;  // without a checkpoint
    ASSERT_TRUE(CommitNow(*lease, {.checkpoint = absl::StrCat("state of ", name), .poses = {Segment("x", 1, 3)}}).ok());
  }
  if (fixture_->keeps()) Reopen();
  const std::vector<StoredSession> read =
      store_->ReadWithoutPoses({"sessions/c", "sessions/none", "sessions/a", "sessions/b"}).value();
  std::vector<std::string> found;
  for (const StoredSession& session : read) {
    found.push_back(absl::StrCat(session.record.name, ": ", session.lifecycle, ", ", session.checkpoint));
    EXPECT_EQ(session.record.config, Record(session.record.name).config);
    EXPECT_EQ(Ranges(session.poses), "");
  }
  EXPECT_THAT(found,
              ElementsAre("sessions/c: life of sessions/c, ", "sessions/a: life of sessions/a, state of sessions/a",
                          "sessions/b: life of sessions/b, state of sessions/b"));
  EXPECT_TRUE(store_->ReadWithoutPoses({})->empty());
}

TEST_P(StoreSuite, DeletesPosesBySegments) {
  auto lease = store_->CreateSession(Record("sessions/a"), "").value();
  ASSERT_TRUE(CommitNow(*lease, {.poses = {Segment("a", 1, 10), Segment("a", 11, 20), Segment("a", 21, 30)}}).ok());
  ASSERT_TRUE(CommitNow(*lease, {.first_pose_seq_kept = 11}).ok());
  EXPECT_EQ(Ranges(store_->ReadSession("sessions/a")->poses), "11-20 21-30");
  ASSERT_TRUE(CommitNow(*lease, {.first_pose_seq_kept = 20}).ok());
  EXPECT_EQ(Ranges(store_->ReadSession("sessions/a")->poses), "11-20 21-30") << "20 is in the first one";
  ASSERT_TRUE(CommitNow(*lease, {.first_pose_seq_kept = 5}).ok());
  EXPECT_EQ(Ranges(store_->ReadSession("sessions/a")->poses), "11-20 21-30");
  ASSERT_TRUE(CommitNow(*lease, {.poses = {Segment("a", 31, 40)}, .first_pose_seq_kept = 50}).ok());
  EXPECT_EQ(Ranges(store_->ReadSession("sessions/a")->poses), "") << "all are below 50";
  ASSERT_TRUE(CommitNow(*lease, {.poses = {Segment("a", 41, 45), Segment("a", 46, 60)}}).ok());
  if (fixture_->keeps()) Reopen();
  EXPECT_EQ(Ranges(store_->ReadSession("sessions/a")->poses), "46-60");
  Store::AcquiredSession acquired = store_->AcquireSession("sessions/a").value();
  EXPECT_TRUE(CommitNow(*acquired.lease, {.poses = {Segment("a", 61, 61)}}).ok());
}

TEST_P(StoreSuite, RefusesPosesThatDoNotContinueTheLog) {
  auto lease = store_->CreateSession(Record("sessions/a"), "").value();
  ASSERT_TRUE(CommitNow(*lease, {.poses = {Segment("a", 1, 3)}}).ok());
  for (const auto& [first, last] : {std::pair(5, 6), std::pair(3, 4), std::pair(1, 3), std::pair(4, 3)}) {
    EXPECT_EQ(CommitNow(*lease, {.checkpoint = "x", .poses = {Segment("x", first, last)}}).code(),
              StatusCode::kFailedPrecondition)
        << first;
  }
  EXPECT_EQ(CommitNow(*lease, {.poses = {Segment("a", 4, 5), Segment("a", 7, 8)}}).code(),
            StatusCode::kFailedPrecondition);
  EXPECT_EQ(store_->ReadSession("sessions/a")->checkpoint, "");
  EXPECT_EQ(Ranges(store_->ReadSession("sessions/a")->poses), "1-3");
  EXPECT_TRUE(CommitNow(*lease, {.poses = {Segment("a", 4, 5)}}).ok());
  Store::AcquiredSession acquired = store_->AcquireSession("sessions/a").value();
  EXPECT_EQ(CommitNow(*acquired.lease, {.poses = {Segment("x", 1, 1)}}).code(), StatusCode::kFailedPrecondition);
  EXPECT_TRUE(CommitNow(*acquired.lease, {.poses = {Segment("a", 6, 6)}}).ok());
}

TEST_P(StoreSuite, CommitsOfOneSessionComeOneByOne) {
  auto lease = store_->CreateSession(Record("sessions/a"), "").value();
  std::promise<absl::Status> inner;
  std::promise<absl::Status> second;
  // Within `done` the commit is complete: one further commit is accepted, a second one at the same time is not.
  lease->Commit({.checkpoint = "1"}, [&](const absl::Status&) {
    lease->Commit({.checkpoint = "2"}, [&](absl::Status status) { inner.set_value(std::move(status)); });
    lease->Commit({.checkpoint = "3"}, [&](absl::Status status) { second.set_value(std::move(status)); });
  });
  EXPECT_TRUE(inner.get_future().get().ok());
  EXPECT_EQ(second.get_future().get().code(), StatusCode::kFailedPrecondition);
  EXPECT_EQ(store_->ReadSession("sessions/a")->checkpoint, "2");
}

// Each session commits in a chain: `done` of a commit starts the next one.
class Chain {
 public:
  Chain(std::unique_ptr<SessionLease> lease, std::string session, uint64_t length)
      : lease_(std::move(lease)), session_(std::move(session)), length_(length) {}
  void Start() { Next(absl::OkStatus()); }
  uint64_t Wait() {
    finished_.get_future().wait();
    return committed_;
  }
  int calls_of_done() const { return calls_of_done_; }

 private:
  void Next(const absl::Status& status) {
    if (!status.ok() || committed_ == length_) return finished_.set_value();
    const uint64_t seq = committed_ + 1;
    lease_->Commit({.checkpoint = session_ + " " + std::to_string(seq), .poses = {Segment(session_, seq, seq)}},
                   [this](const absl::Status& done) {
                     ++calls_of_done_;
                     if (done.ok()) ++committed_;
                     Next(done);
                   });
  }

  const std::unique_ptr<SessionLease> lease_;
  const std::string session_;
  const uint64_t length_;
  uint64_t committed_ = 0;
  std::atomic<int> calls_of_done_ = 0;
  std::promise<void> finished_;
};

TEST_P(StoreSuite, ManySessionsCommitFromManyThreads) {
  constexpr int kThreads = 8;
  constexpr int kSessionsEach = 8;
  constexpr uint64_t kCommits = 20;
  std::vector<std::thread> threads;
  std::atomic<int> whole = 0;
  for (int thread = 0; thread < kThreads; ++thread) {
    threads.emplace_back([&, thread] {
      std::vector<std::unique_ptr<Chain>> chains;
      for (int i = 0; i < kSessionsEach; ++i) {
        const std::string name = "sessions/" + std::to_string(thread) + "-" + std::to_string(i);
        chains.push_back(std::make_unique<Chain>(store_->CreateSession(Record(name), "").value(), name, kCommits));
        chains.back()->Start();
      }
      for (const auto& chain : chains) {
        whole += chain->Wait() == kCommits && chain->calls_of_done() == static_cast<int>(kCommits) ? 1 : 0;
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(whole, kThreads * kSessionsEach);
  for (const std::string& name : NamesOf(*store_)) {
    const StoredSession session = store_->ReadSession(name).value();
    EXPECT_EQ(session.checkpoint, name + " " + std::to_string(kCommits));
    ASSERT_EQ(session.poses.size(), kCommits);
    EXPECT_EQ(session.poses[7].bytes, Segment(name, 8, 8).bytes);
  }
}

TEST_P(StoreSuite, OneOfManyCreatesASessionAndTheLastTakerHoldsIt) {
  std::vector<std::thread> threads;
  std::atomic<int> created = 0;
  for (int i = 0; i < 8; ++i) {
    threads.emplace_back([&] { created += store_->CreateSession(Record("sessions/a"), "").ok() ? 1 : 0; });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(created, 1);
  threads.clear();
  std::vector<std::unique_ptr<SessionLease>> leases(8);
  for (auto& lease : leases) {
    threads.emplace_back([&] { lease = std::move(store_->AcquireSession("sessions/a")->lease); });
  }
  for (std::thread& thread : threads) thread.join();
  std::sort(leases.begin(), leases.end(),
            [](const auto& a, const auto& b) { return a->token().number < b->token().number; });
  for (size_t i = 0; i < leases.size(); ++i) {
    const StatusCode expected = i + 1 == leases.size() ? StatusCode::kOk : StatusCode::kAborted;
    EXPECT_EQ(CommitNow(*leases[i], {.checkpoint = std::to_string(i)}).code(), expected) << i;
  }
  EXPECT_EQ(store_->ReadSession("sessions/a")->checkpoint, "7");
}

TEST_P(StoreSuite, EveryCommitIsCompleteWhenTheStoreIsDestroyed) {
  constexpr int kSessions = 32;
  std::vector<std::unique_ptr<SessionLease>> leases;
  std::vector<std::string> names;
  for (int i = 0; i < kSessions; ++i) {
    names.push_back("sessions/" + std::to_string(i));
    leases.push_back(store_->CreateSession(Record(names.back()), "").value());
  }
  std::vector<std::vector<absl::Status>> outcomes(kSessions);
  for (int i = 0; i < kSessions; ++i) {
    leases[i]->Commit({.checkpoint = Noise(100'000, static_cast<uint64_t>(i))},
                      [&outcomes, i](absl::Status status) { outcomes[i].push_back(std::move(status)); });
    if (i % 2 == 0) leases[i].reset();  // a lease may be destroyed before its commit is complete
  }
  store_.reset();
  for (int i = 0; i < kSessions; ++i) {
    ASSERT_EQ(outcomes[i].size(), 1u) << i;
    EXPECT_TRUE(outcomes[i][0].ok() || outcomes[i][0].code() == StatusCode::kCancelled) << outcomes[i][0];
  }
  EXPECT_EQ(CommitNow(*leases[1], {.checkpoint = "x"}).code(), StatusCode::kCancelled);
  if (!fixture_->keeps()) return;
  store_ = fixture_->Open().value();
  EXPECT_EQ(CommitNow(*leases[1], {.checkpoint = "x"}).code(), StatusCode::kCancelled);
  for (int i = 0; i < kSessions; ++i) {
    if (!outcomes[i][0].ok()) continue;
    EXPECT_TRUE(store_->ReadSession(names[i])->checkpoint == Noise(100'000, static_cast<uint64_t>(i)));
  }
}

TEST_P(StoreSuite, FencingNumbersRiseAcrossOpenings) {
  const uint64_t first = store_->CreateSession(Record("sessions/a"), "").value()->token().number;
  if (fixture_->keeps()) Reopen();
  const uint64_t second = store_->AcquireSession("sessions/a").value().lease->token().number;
  EXPECT_GT(second, first);
  ASSERT_TRUE(store_->DeleteSession("sessions/a").ok());
  EXPECT_GT(store_->CreateSession(Record("sessions/a"), "").value()->token().number, second);
}

TEST_P(StoreSuite, DeletesSessionsThatEndedBefore) {
  const absl::Time start = absl::FromUnixSeconds(1'700'000'000);
  for (const int i : {3, 1, 2, 4}) {
    auto lease = store_->CreateSession(Record("sessions/" + std::to_string(i)), "").value();
    ASSERT_TRUE(CommitNow(*lease, {.checkpoint = "x", .poses = {Segment("a", 1, 1)}}).ok());
    const SessionCommit end = {.ended_at = start + absl::Seconds(i)};
    ASSERT_TRUE(CommitNow(*lease, i == 4 ? SessionCommit() : end).ok());
    ASSERT_TRUE(CommitNow(*lease, {.lifecycle = "a later commit does not take the end away"}).ok());
  }
  EXPECT_THAT(store_->DeleteEnded(start).value(), ElementsAre());
  EXPECT_THAT(store_->DeleteEnded(start + absl::Seconds(3)).value(), ElementsAre("sessions/1", "sessions/2"));
  EXPECT_THAT(store_->DeleteEnded(start + absl::Seconds(3)).value(), ElementsAre());
  EXPECT_THAT(NamesOf(*store_), ElementsAre("sessions/3", "sessions/4"));
  EXPECT_THAT(store_->DeleteEnded(absl::InfiniteFuture()).value(), ElementsAre("sessions/3"));
  EXPECT_EQ(store_->ReadSession("sessions/4")->checkpoint, "x") << "it has not ended";
}

TEST_P(StoreSuite, AFullStoreRejectsCommitsUntilSpaceIsAvailable) {
  store_.reset();
  store_ = fixture_->OpenSmall(8u << 20).value();
  auto living = store_->CreateSession(Record("sessions/living"), "life").value();
  ASSERT_TRUE(CommitNow(*living, {.checkpoint = "whole", .poses = {Segment("a", 1, 1)}}).ok());
  auto large = store_->CreateSession(Record("sessions/large"), "").value();
  absl::Status status;
  uint64_t committed = 0;
  while (status.ok() && committed < 100) {
    status = CommitNow(*large, {.poses = {{.first_pose_seq = committed + 1,
                                           .last_pose_seq = committed + 1,
                                           .bytes = Noise(512u << 10, committed)}}});
    if (status.ok()) ++committed;
  }
  EXPECT_EQ(status.code(), StatusCode::kResourceExhausted) << status;
  EXPECT_GT(committed, 4u);
  EXPECT_GT(store_->Usage()->bytes, store_->Usage()->max_bytes / 2);
  EXPECT_EQ(store_->ReadSession("sessions/large")->poses.size(), committed);
  EXPECT_EQ(CommitNow(*living, {.checkpoint = Noise(4u << 20, 1), .poses = {Segment("a", 2, 2)}}).code(),
            StatusCode::kResourceExhausted);
  EXPECT_EQ(store_->ReadSession("sessions/living")->checkpoint, "whole");
  EXPECT_EQ(Ranges(store_->ReadSession("sessions/living")->poses), "1-1");

  ASSERT_TRUE(store_->DeleteSession("sessions/large").ok());
  EXPECT_TRUE(CommitNow(*living, {.checkpoint = Noise(4u << 20, 1), .poses = {Segment("a", 2, 2)}}).ok());
  EXPECT_EQ(Ranges(store_->ReadSession("sessions/living")->poses), "1-1 2-2");
  if (!fixture_->keeps()) return;
  store_.reset();
  store_ = fixture_->OpenSmall(8u << 20).value();
  EXPECT_THAT(store_->damage(), testing::IsEmpty());
  EXPECT_TRUE(store_->ReadSession("sessions/living")->checkpoint == Noise(4u << 20, 1));
}

// A group of a store can delete only its own sessions.
TEST_P(StoreSuite, EndedSessionsAreDeletedForActiveOnes) {
  store_.reset();
  store_ = fixture_->OpenSmall(8u << 20).value();
  const auto beside_first = [this](std::string name) {
    while (!fixture_->AreTogether(name, "sessions/1")) name += "x";
    return name;
  };
  const std::string second = beside_first("sessions/2");
  const std::string active = beside_first("sessions/living");
  const absl::Time start = absl::FromUnixSeconds(1'700'000'000);
  for (const auto& [name, end_s] : {std::pair(second, 2), std::pair(std::string("sessions/1"), 1)}) {
    auto lease = store_->CreateSession(Record(name), "").value();
    ASSERT_TRUE(CommitNow(*lease, {.checkpoint = Noise(2u << 20, 1), .ended_at = start + absl::Seconds(end_s)}).ok());
  }
  auto living = store_->CreateSession(Record(active), "").value();
  for (uint64_t seq = 1; seq < 64 && store_->ReadSession("sessions/1").ok(); ++seq) {
    const PoseSegment poses = {.first_pose_seq = seq, .last_pose_seq = seq, .bytes = Noise(512u << 10, seq)};
    ASSERT_TRUE(CommitNow(*living, {.poses = {poses}}).ok()) << seq;
  }
  EXPECT_THAT(NamesOf(*store_), ElementsAre(second, active)) << "the session that ended first is deleted";
  EXPECT_THAT(store_->DeleteEnded(start).value(), ElementsAre("sessions/1"));
  EXPECT_THAT(store_->DeleteEnded(start).value(), ElementsAre());
}

}  // namespace
}  // namespace evpose::server

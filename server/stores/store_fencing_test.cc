// SPDX-License-Identifier: Apache-2.0

// The tests, for every kind of store, of a store that has lost its last writes: a replica without them was made the
// master.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>

#include "server/stores/common/store.h"
#include "server/stores/store_fixtures_testing.h"

namespace evpose::server {
namespace {

using absl::StatusCode;

class StoreFencingSuite : public StoreSuite {};

INSTANTIATE_TEST_SUITE_P(Stores, StoreFencingSuite, kTestedStores, NameOfTestedStore);

TEST_P(StoreFencingSuite, TwoLeasesWithOneNumberAreDifferentHolders) {
  auto created = store_->CreateSession(Record("sessions/a"), "life").value();
  const auto first = store_->AcquireSession("sessions/a").value().lease;
  fixture_->RepeatLastNumber();
  const auto second = store_->AcquireSession("sessions/a").value().lease;
  ASSERT_EQ(first->token().number, second->token().number);
  EXPECT_EQ(CommitNow(*first, {.checkpoint = "x", .poses = {Segment("x", 1, 2)}}).code(), StatusCode::kAborted);
  EXPECT_EQ(store_->DeleteHeldSession("sessions/a", first->token()).code(), StatusCode::kAborted);
  EXPECT_TRUE(CommitNow(*second, {.checkpoint = "2", .poses = {Segment("a", 1, 1)}}).ok());
  EXPECT_EQ(store_->ReadSession("sessions/a")->checkpoint, "2");
  EXPECT_EQ(Ranges(store_->ReadSession("sessions/a")->poses), "1-1");
}

TEST_P(StoreFencingSuite, ALostCommitIsReportedAndLeavesNoGap) {
  auto lease = store_->CreateSession(Record("sessions/a"), "life").value();
  ASSERT_TRUE(CommitNow(*lease, {.checkpoint = "1", .poses = {Segment("a", 1, 3)}}).ok());
  const std::function<void()> roll_back = fixture_->Snapshot();
  if (roll_back == nullptr) GTEST_SKIP() << "the file of a store in use cannot be exchanged";
  ASSERT_TRUE(CommitNow(*lease, {.lifecycle = "new life", .poses = {Segment("a", 4, 6)}}).ok());
  roll_back();
  EXPECT_EQ(CommitNow(*lease, {.checkpoint = "3", .poses = {Segment("a", 7, 9)}}).code(), StatusCode::kOutOfRange);
  EXPECT_EQ(CommitNow(*lease, {.checkpoint = "3"}).code(), StatusCode::kOutOfRange) << "the lifecycle would be lost";
  Store::AcquiredSession acquired = store_->AcquireSession("sessions/a").value();
  EXPECT_EQ(acquired.session.checkpoint, "1");
  EXPECT_EQ(acquired.session.lifecycle, "life");
  EXPECT_EQ(Ranges(acquired.session.poses), "1-3");
  EXPECT_TRUE(CommitNow(*acquired.lease, {.checkpoint = "2", .poses = {Segment("a", 4, 6)}}).ok());
  EXPECT_EQ(CommitNow(*lease, {.checkpoint = "x"}).code(), StatusCode::kAborted);
}

TEST_P(StoreFencingSuite, ALostLeaseIsReported) {
  auto first = store_->CreateSession(Record("sessions/a"), "life").value();
  const std::function<void()> roll_back = fixture_->Snapshot();
  if (roll_back == nullptr) GTEST_SKIP() << "the file of a store in use cannot be exchanged";
  const auto second = store_->AcquireSession("sessions/a").value().lease;
  ASSERT_TRUE(CommitNow(*second, {.checkpoint = "2"}).ok());
  roll_back();
  EXPECT_EQ(CommitNow(*second, {.checkpoint = "3"}).code(), StatusCode::kOutOfRange);
  EXPECT_EQ(store_->DeleteHeldSession("sessions/a", second->token()).code(), StatusCode::kOutOfRange);
  EXPECT_TRUE(CommitNow(*first, {.checkpoint = "1"}).ok()) << "the store knows this lease as the last one";
}

}  // namespace
}  // namespace evpose::server

// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/watching/watchers.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <semaphore>
#include <vector>

#include "core/base/poll_testing.h"

namespace evpose::server {
namespace {

class CountingWatcher : public SessionListener {
 public:
  explicit CountingWatcher(std::vector<const CountingWatcher*>* order = nullptr) : order_(order) {}
  void OnSessionChanged() override {
    ++calls_;
    if (order_ != nullptr) order_->push_back(this);
  }
  int calls() const { return calls_; }

 private:
  std::vector<const CountingWatcher*>* const order_;  // written by one thread only
  std::atomic<int> calls_ = 0;
};

class WatchersTest : public testing::Test {
 protected:
  // The low-priority thread is blocked until it is released.
  void Hold() {
    pool_.PostLowPriority([this] {
      held_.release();
      go_.acquire();
    });
    held_.acquire();
  }
  void LetGo() {
    go_.release();
    pool_.Join();
  }

  WorkerPool pool_{1};
  std::binary_semaphore held_{0}, go_{0};
};

TEST_F(WatchersTest, ManyChangesCauseOneNotification) {
  const auto watchers = std::make_shared<Watchers>(pool_);
  std::vector<std::shared_ptr<CountingWatcher>> all;
  for (int i = 0; i < 1000; ++i) watchers->Add(all.emplace_back(std::make_shared<CountingWatcher>()));
  Hold();
  for (int i = 0; i < 500; ++i) watchers->Notify();  // none of them waits for a watcher
  for (const auto& watcher : all) EXPECT_EQ(watcher->calls(), 0);
  LetGo();
  for (const auto& watcher : all) EXPECT_EQ(watcher->calls(), 2) << "one round, and one more for the changes during it";
}

TEST_F(WatchersTest, AFewWatchersDoNotWaitForManyOfAnotherSession) {
  std::vector<const CountingWatcher*> order;
  const auto many = std::make_shared<Watchers>(pool_);
  const auto few = std::make_shared<Watchers>(pool_);
  std::vector<std::shared_ptr<CountingWatcher>> all;
  for (int i = 0; i < 1000; ++i) many->Add(all.emplace_back(std::make_shared<CountingWatcher>(&order)));
  const auto lone = std::make_shared<CountingWatcher>(&order);
  few->Add(lone);
  Hold();
  many->Notify();
  few->Notify();
  LetGo();
  ASSERT_EQ(order.size(), 1001u);
  EXPECT_LE(std::find(order.begin(), order.end(), lone.get()) - order.begin(), 32);
}

TEST_F(WatchersTest, PosesDoNotWaitForImages) {
  const auto images = std::make_shared<Watchers>(pool_, "mallory");
  const auto poses = std::make_shared<Watchers>(pool_);
  const auto of_images = std::make_shared<CountingWatcher>(), of_poses = std::make_shared<CountingWatcher>();
  images->Add(of_images);
  poses->Add(of_poses);
  pool_.images().Post("mallory", [this](const absl::Status&) {  // compresses a large image
    held_.release();
    go_.acquire();
  });
  held_.acquire();
  images->Notify();
  poses->Notify();
  EXPECT_TRUE(Poll([&] { return of_poses->calls() > 0; }));
  EXPECT_EQ(of_images->calls(), 0);
  LetGo();
  EXPECT_EQ(of_images->calls(), 1);
}

TEST_F(WatchersTest, ImagesOfATenantDoNotWaitForManyOfAnother) {
  std::vector<const CountingWatcher*> order;
  std::vector<std::shared_ptr<Watchers>> sessions;
  std::vector<std::shared_ptr<CountingWatcher>> all;
  for (int i = 0; i < 20; ++i) {
    sessions.push_back(std::make_shared<Watchers>(pool_, "mallory"));
    for (int j = 0; j < 10; ++j) sessions.back()->Add(all.emplace_back(std::make_shared<CountingWatcher>(&order)));
  }
  sessions.push_back(std::make_shared<Watchers>(pool_, "alice"));
  const auto lone = std::make_shared<CountingWatcher>(&order);
  sessions.back()->Add(lone);
  pool_.images().Post("bob", [this](const absl::Status&) {
    held_.release();
    go_.acquire();
  });
  held_.acquire();
  for (const auto& session : sessions) session->Notify();
  LetGo();
  ASSERT_EQ(order.size(), 201u);
  EXPECT_LE(std::find(order.begin(), order.end(), lone.get()) - order.begin(), 1);
}

TEST_F(WatchersTest, RemovesDestroyedWatchers) {
  const auto watchers = std::make_shared<Watchers>(pool_);
  const auto stays = std::make_shared<CountingWatcher>();
  watchers->Add(stays);
  for (int i = 0; i < 2; ++i) watchers->Add(std::make_shared<CountingWatcher>());
  EXPECT_EQ(watchers->size(), 3u);
  watchers->Notify();
  pool_.Join();
  EXPECT_EQ(watchers->size(), 1u);
  EXPECT_EQ(stays->calls(), 1);
}

TEST_F(WatchersTest, RemovesDestroyedWatchersWithoutAChange) {
  const auto watchers = std::make_shared<Watchers>(pool_);
  std::vector<std::shared_ptr<CountingWatcher>> stay;
  for (int i = 0; i < 10; ++i) watchers->Add(stay.emplace_back(std::make_shared<CountingWatcher>()));
  for (int i = 0; i < 1000; ++i) watchers->Add(std::make_shared<CountingWatcher>());
  EXPECT_GE(watchers->size(), 10u);
  EXPECT_LE(watchers->size(), 40u);
  watchers->Notify();
  pool_.Join();
  for (const auto& watcher : stay) EXPECT_EQ(watcher->calls(), 1);
}

}  // namespace
}  // namespace evpose::server

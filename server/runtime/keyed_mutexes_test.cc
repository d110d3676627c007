// SPDX-License-Identifier: Apache-2.0
#include "server/runtime/keyed_mutexes.h"

#include <gtest/gtest.h>

#include <boost/asio/thread_pool.hpp>
#include <latch>
#include <optional>
#include <string>
#include <thread>
#include <vector>

namespace evpose::server {
namespace {

TEST(KeyedMutexesTest, OneLockOfAKeyExistsAtATime) {
  KeyedMutexes<std::string> mutexes;
  int count = 0;  // not atomic: the mutex protects it
  std::vector<std::thread> threads;
  for (int i = 0; i < 4; ++i) {
    threads.emplace_back([&] {
      for (int turn = 0; turn < 50; ++turn) {
        const auto lock = mutexes.LockKey("a");
        const int before = count;
        std::this_thread::yield();
        count = before + 1;
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(count, 200);
}

TEST(KeyedMutexesTest, OtherKeysAreNotLocked) {
  KeyedMutexes<std::string> mutexes;
  const auto first = mutexes.LockKey("a");
  const auto second = mutexes.LockKey("b");  // a lock for all keys would wait for ever
}

TEST(KeyedMutexesTest, ALockThatIsReplacedIsReleased) {
  KeyedMutexes<int> mutexes;
  auto lock = mutexes.LockKey(1);
  lock = mutexes.LockKey(2);
  const auto again = mutexes.LockKey(1);  // would wait for ever
}

TEST(KeyedMutexesTest, AnItemOfSlowWorkThatWaitsDelaysNoOtherTenant) {
  KeyedMutexes<int> mutexes;
  boost::asio::thread_pool threads(2);
  SlowExecutor slow(threads.get_executor(), {.running = 1, .long_items = 1});
  std::vector<std::string> order;  // not atomic: the mutex protects it
  auto lock = mutexes.LockKey(1);
  slow.Post("mallory", [&](const absl::Status&) {
    const auto again = mutexes.LockKey(1);
    order.emplace_back("mallory");
  });
  std::latch has_alice_run(1);
  slow.Post("alice", [&](const absl::Status&) {
    order.emplace_back("alice");
    has_alice_run.count_down();
  });
  has_alice_run.wait();  // would wait for ever if mallory kept its place
  lock.reset();
  threads.join();
  EXPECT_EQ(order, std::vector<std::string>({"alice", "mallory"}));
}

TEST(KeyedMutexesTest, ALockMayOutliveItsMutexes) {
  std::optional<KeyedMutexes<int>> mutexes(std::in_place);
  const auto lock = mutexes->LockKey(1);
  mutexes.reset();
}

}  // namespace
}  // namespace evpose::server

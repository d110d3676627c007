// SPDX-License-Identifier: Apache-2.0
#include "server/runtime/weak_cache.h"

#include <gtest/gtest.h>

#include <atomic>
#include <barrier>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/status.h"

namespace evpose::server {
namespace {

class WeakCacheTest : public ::testing::Test {
 protected:
  std::shared_ptr<const std::string> Get(int key) {
    return shared_.Get(key, [&] { return Made(std::make_shared<const std::string>(std::to_string(key))); }).value();
  }
  using Made = absl::StatusOr<std::shared_ptr<const std::string>>;

  WeakCache<int, std::string> shared_;
};

TEST_F(WeakCacheTest, OneKeyHasOneValue) {
  const auto first = Get(1);
  EXPECT_EQ(Get(1), first);
  EXPECT_EQ(*first, "1");
}

TEST_F(WeakCacheTest, AnotherKeyHasAnother) {
  const auto first = Get(1);
  EXPECT_EQ(*Get(2), "2");
  EXPECT_EQ(Get(1), first);
}

TEST_F(WeakCacheTest, AValueIsDestroyedWithItsLastUser) {
  std::weak_ptr<const std::string> watched;
  {
    const auto first = Get(1);
    const auto second = Get(1);
    watched = first;
    EXPECT_EQ(first.use_count(), 2);
  }
  EXPECT_TRUE(watched.expired());
  EXPECT_EQ(*Get(1), "1");  // created again
}

TEST_F(WeakCacheTest, ErrorsAreNotCached) {
  const absl::Status wrong = absl::InvalidArgumentError("wrong");
  EXPECT_EQ(shared_.Get(1, [&] { return Made(wrong); }).status(), wrong);
  EXPECT_EQ(*Get(1), "1");
}

TEST_F(WeakCacheTest, ManyThreadsGetTheSame) {
  std::vector<std::shared_ptr<const std::string>> got(8);
  std::vector<std::thread> threads;
  for (auto& value : got) threads.emplace_back([&] { value = Get(1); });
  for (std::thread& thread : threads) thread.join();
  for (const auto& value : got) EXPECT_EQ(value, got.front());
}

TEST_F(WeakCacheTest, ManyThreadsCreateTheValueOnce) {
  constexpr int kThreads = 8;
  std::atomic<int> num_begun = 0, num_made = 0;
  std::barrier all_have_it(kThreads);
  std::vector<std::thread> threads;
  for (int i = 0; i < kThreads; ++i) {
    threads.emplace_back([&] {
      ++num_begun;
      const auto value = shared_.Get(1, [&] {
        ++num_made;
        while (num_begun < kThreads) std::this_thread::yield();
        for (int turn = 0; turn < 20; ++turn) std::this_thread::yield();  // the others call Get() meanwhile
        return Made(std::make_shared<const std::string>("1"));
      });
      all_have_it.arrive_and_wait();  // each thread keeps its reference until all threads have one
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(num_made, 1);
}

TEST_F(WeakCacheTest, WhileAValueIsCreatedOthersAreAvailable) {
  const auto first = shared_.Get(1, [&] {
    EXPECT_EQ(*Get(2), "2");
    return Made(std::make_shared<const std::string>("1"));
  });
  EXPECT_EQ(**first, "1");
}

}  // namespace
}  // namespace evpose::server

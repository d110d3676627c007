// SPDX-License-Identifier: Apache-2.0
#include "server/runtime/weak_cache.h"

#include <gtest/gtest.h>

#include <string>
#include <thread>

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

}  // namespace
}  // namespace evpose::server

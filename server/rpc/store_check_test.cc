// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/store_check.h"

#include <gtest/gtest.h>

#include <boost/asio/io_context.hpp>
#include <memory>
#include <new>
#include <vector>

#include "server/sessions/store_testing.h"
#include "server/stores/memory/memory_store.h"

namespace evpose::server {
namespace {

// A store without memory for the first checks.
class StoreWithoutMemory : public FaultInjectingStore {
 public:
  explicit StoreWithoutMemory(std::shared_ptr<InjectedFault> fault)
      : FaultInjectingStore(MakeMemoryStore(), std::move(fault)) {}
  absl::Status CheckHealth() override {
    if (++num_checks == 1) throw std::bad_alloc();
    return FaultInjectingStore::CheckHealth();
  }
  std::vector<StoreGroup> Groups() const override {
    if (num_checks == 2) throw std::bad_alloc();
    return {};
  }

  int num_checks = 0;
};

// Runs on the thread of the test.
TEST(StoreCheckTest, ChecksGoOnAfterFailedAllocations) {
  boost::asio::io_context threads;
  const auto executor = threads.get_executor();
  WorkerPool pool(WorkerPool::Executors{executor, executor, executor, executor});
  const auto fault = std::make_shared<InjectedFault>();
  StoreWithoutMemory store(fault);
  std::vector<bool> changes;
  StoreCheck check(store, pool, absl::Milliseconds(1), [&](bool is_healthy) {
    changes.push_back(is_healthy);
    if (!is_healthy) throw std::bad_alloc();
  });
  check.Start();
  const auto run_checks = [&](int until) {
    while (store.num_checks < until && threads.run_one() > 0) continue;
  };
  run_checks(3);
  EXPECT_TRUE(check.health().ok()) << "a failed allocation is no evidence about the store";
  EXPECT_EQ(changes, std::vector<bool>());
  fault->Set(absl::UnavailableError("unreachable"));
  run_checks(5);
  EXPECT_EQ(store.num_checks, 5);
  EXPECT_TRUE(absl::IsUnavailable(check.health()));
  fault->Set(absl::OkStatus());
  run_checks(7);
  EXPECT_TRUE(check.health().ok());
  EXPECT_EQ(changes, std::vector<bool>({false, true}));
  check.Stop();
  threads.run();
  EXPECT_EQ(store.num_checks, 7);
}

}  // namespace
}  // namespace evpose::server

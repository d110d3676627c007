// SPDX-License-Identifier: Apache-2.0
#include "server/program/session_memory.h"

#include <gtest/gtest.h>

#include <limits>

namespace evpose::server {
namespace {

constexpr uint64_t kGb = 1'000'000'000;

ServerOptions SomeOptions() {
  ServerOptions options;
  options.slow_threads = 2;
  options.model_budget.memory_bytes = kGb;
  options.max_model_store_bytes = options.max_transport_bytes = kGb / 2;
  return options;  // 3.325 GB in all, with 0.125 GB of responses and 0.2 GB of the process
}

TEST(SessionMemoryTest, ALargeMachineKeepsAQuarterForTheRest) {
  EXPECT_EQ(DefaultSessionMemory(SomeOptions(), 16 * kGb), 12 * kGb);
  EXPECT_EQ(DefaultSessionMemory(SomeOptions(), 64 * kGb), 48 * kGb);
}

TEST(SessionMemoryTest, TheOtherLimitsFitBesideTheSessions) {
  EXPECT_EQ(DefaultSessionMemory(SomeOptions(), 8 * kGb), 4'675'000'000);
  ServerOptions options = SomeOptions();
  options.slow_threads = 4;
  EXPECT_EQ(DefaultSessionMemory(options, 8 * kGb), 2'675'000'000);
  options.max_model_store_bytes = 0;
  EXPECT_EQ(DefaultSessionMemory(options, 8 * kGb), 3'175'000'000);
}

TEST(SessionMemoryTest, ASmallMachineHasSessions) {
  EXPECT_EQ(DefaultSessionMemory(SomeOptions(), 2 * kGb), kGb / 2);
  ServerOptions options = SomeOptions();
  options.max_transport_bytes = std::numeric_limits<uint64_t>::max();
  EXPECT_EQ(DefaultSessionMemory(options, 8 * kGb), 2 * kGb);
}

}  // namespace
}  // namespace evpose::server

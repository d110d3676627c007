// SPDX-License-Identifier: Apache-2.0
#include "server/connections/memory_trimmer.h"

#include <gtest/gtest.h>

namespace evpose::server {
namespace {

TEST(MemoryTrimmerTest, TrimsAfterConnectionsWereClosedAndMemoryHasGrown) {
  size_t resident_bytes = 2 * MemoryTrimmer::kMinGrowthBytes;
  int num_trims = 0;
  MemoryTrimmer trimmer([&] { return resident_bytes; },
                        [&] {
                          ++num_trims;
                          resident_bytes = MemoryTrimmer::kMinGrowthBytes;
                        });
  const auto step = [&trimmer](size_t num_closed) {
    trimmer.Step(num_closed);
    for (int i = 1; i < MemoryTrimmer::kSteps; ++i) trimmer.Step(0);
  };
  step(0);
  EXPECT_EQ(num_trims, 0) << "no connection was closed";
  step(1);
  EXPECT_EQ(num_trims, 1);
  step(0);
  step(9);
  EXPECT_EQ(num_trims, 1) << "no growth since the last time";
  resident_bytes = 2 * MemoryTrimmer::kMinGrowthBytes;
  for (int i = 0; i < MemoryTrimmer::kSteps; ++i) trimmer.Step(1);
  EXPECT_EQ(num_trims, 2) << "connections that are closed all the time do not postpone it";
}

}  // namespace
}  // namespace evpose::server

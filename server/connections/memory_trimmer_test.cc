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
  for (int i = 0; i < 3 * MemoryTrimmer::kMaxSteps; ++i) trimmer.Step(0);
  const int of_one_flood = num_trims;
  EXPECT_EQ(of_one_flood, 6) << "after 5, 10, 20, 40, 80 and 160 further steps";
  step(9);
  EXPECT_EQ(num_trims, of_one_flood) << "no growth since the last time";
  resident_bytes = 2 * MemoryTrimmer::kMinGrowthBytes;
  for (int i = 0; i < MemoryTrimmer::kSteps; ++i) trimmer.Step(1);
  EXPECT_EQ(num_trims, of_one_flood + 1) << "connections that are closed all the time do not postpone it";
}

TEST(MemoryTrimmerTest, ReturnsMemoryThatIsReleasedAfterTheFirstTrim) {
  const size_t flood_bytes = 10 * MemoryTrimmer::kMinGrowthBytes;
  size_t resident_bytes = flood_bytes;
  bool is_released = false;
  MemoryTrimmer trimmer([&] { return resident_bytes; }, [&] { resident_bytes = is_released ? 0 : flood_bytes; });
  trimmer.Step(1);
  for (int i = 1; i < MemoryTrimmer::kSteps; ++i) trimmer.Step(0);
  EXPECT_EQ(resident_bytes, flood_bytes) << "nothing was released yet";
  is_released = true;
  for (int i = 0; i < 2 * MemoryTrimmer::kSteps; ++i) trimmer.Step(0);
  EXPECT_EQ(resident_bytes, 0);
}

}  // namespace
}  // namespace evpose::server

// SPDX-License-Identifier: Apache-2.0
#include "server/runtime/server_clock.h"

#include <gtest/gtest.h>

namespace evpose::server {
namespace {

TEST(ServerClockTest, AStepOfTheWallClockChangesNothing) {
  absl::Time wall = absl::UnixEpoch();
  std::chrono::steady_clock::time_point steady;
  const auto now = MakeServerClock([&wall] { return wall; }, [&steady] { return steady; });
  EXPECT_EQ(now(), absl::UnixEpoch());
  wall += absl::Hours(24 * 365 * 50);
  EXPECT_EQ(now(), absl::UnixEpoch());
  steady += std::chrono::milliseconds(1500);
  EXPECT_EQ(now(), absl::UnixEpoch() + absl::Milliseconds(1500));
}

}  // namespace
}  // namespace evpose::server

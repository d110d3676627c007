// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/clock_log.h"

#include <gtest/gtest.h>

#include <filesystem>

namespace evpose::client {
namespace {

TEST(ClockLogTest, WritesSensorAndHostTimes) {
  const std::string path = ::testing::TempDir() + "/clock_log_test.csv";
  int64_t now_us = 1'700'000'000'000'000;
  auto log = ClockLog::Open(path, std::nullopt, [&now_us] { return absl::FromUnixMicros(now_us); });
  ASSERT_TRUE(log.ok()) << log.status();
  EXPECT_FALSE((*log)->SmallestDifference().has_value());
  (*log)->AddChunk(-1);  // without a time
  (*log)->AddChunk(1000);
  now_us += 1500;
  (*log)->AddPose(900);
  (*log)->AddTriggers({.triggers = {{950, 2, true}, {960, 2, false}}});
  (*log)->AddChunk(3000);  // 500 us sooner than the first one
  EXPECT_EQ((*log)->SmallestDifference(), absl::Microseconds(1'699'999'999'998'500));
  ASSERT_TRUE((*log)->Commit().ok());
  EXPECT_EQ(*ReadFile(path, 10'000),
            "kind,t_us,host_unix_us,input,rising\n"
            "chunk,1000,1700000000000000,,\n"
            "pose,900,1700000000001500,,\n"
            "trigger,950,1700000000001500,2,1\n"
            "trigger,960,1700000000001500,2,0\n"
            "chunk,3000,1700000000001500,,\n");
  std::filesystem::remove(path);
}

TEST(ClockLogTest, ContinuesAFile) {
  const std::string path = ::testing::TempDir() + "/clock_log_continued.csv";
  const auto open = [&path](uint64_t kept) {
    return *ClockLog::Open(path, kept, [] { return absl::FromUnixMicros(7); });
  };
  uint64_t kept = 0;
  {
    const auto log = open(0);
    log->AddPose(1);
    kept = *log->Sync();
    log->AddPose(2);  // not recorded: written again by the next process
  }
  const auto log = open(kept);
  log->AddPose(2);
  ASSERT_TRUE(log->Commit().ok());
  EXPECT_EQ(*ReadFile(path, 10'000), "kind,t_us,host_unix_us,input,rising\npose,1,7,,\npose,2,7,,\n");
  std::filesystem::remove(path);
}

TEST(ClockLogTest, NamesAPathThatCannotBeWritten) {
  const auto log = ClockLog::Open("/no/such/directory/clock.csv", std::nullopt);
  EXPECT_EQ(log.status().code(), absl::StatusCode::kNotFound);
}

}  // namespace
}  // namespace evpose::client

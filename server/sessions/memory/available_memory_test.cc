// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/memory/available_memory.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "core/base/temporary_directory_testing.h"

namespace evpose::server {
namespace {

class AvailableMemoryTest : public ::testing::Test {
 protected:
  void Write(const std::string& path, const std::string& text) {
    const std::filesystem::path file = root_.path() + path;
    std::filesystem::create_directories(file.parent_path());
    std::ofstream(file) << text << "\n";
  }

  const TemporaryDirectory root_;
  const uint64_t machine_ = AvailableMemoryBytes(root_.path());  // without any control group
};

TEST_F(AvailableMemoryTest, WithoutLimitsItIsTheMemoryOfTheMachine) {
  EXPECT_GT(machine_, 100'000'000u);
  Write("/proc/self/cgroup", "0::/a/b");
  Write("/sys/fs/cgroup/a/b/memory.max", "max");
  EXPECT_EQ(AvailableMemoryBytes(root_.path()), machine_);
}

TEST_F(AvailableMemoryTest, TheSmallestLimitOfTheGroupsCounts) {
  Write("/proc/self/cgroup", "0::/a/b");
  Write("/sys/fs/cgroup/a/b/memory.max", "9000000");
  EXPECT_EQ(AvailableMemoryBytes(root_.path()), 9'000'000u);
  Write("/sys/fs/cgroup/a/memory.max", "8000000");
  EXPECT_EQ(AvailableMemoryBytes(root_.path()), 8'000'000u);
  Write("/sys/fs/cgroup/memory.max", "7000000");
  EXPECT_EQ(AvailableMemoryBytes(root_.path()), 7'000'000u) << "of a container";
}

TEST_F(AvailableMemoryTest, ReadsVersion1) {
  Write("/proc/self/cgroup", "5:cpu,cpuacct:/x\n4:memory:/docker/1\n1:name=systemd:/x");
  Write("/sys/fs/cgroup/memory/docker/1/memory.limit_in_bytes", "6000000");
  EXPECT_EQ(AvailableMemoryBytes(root_.path()), 6'000'000u);
}

}  // namespace
}  // namespace evpose::server

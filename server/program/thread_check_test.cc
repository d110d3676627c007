// SPDX-License-Identifier: Apache-2.0
#include "server/program/thread_check.h"

#include <gtest/gtest.h>

namespace evpose::server {
namespace {

TEST(ThreadCheckTest, AFewThreadsCanBeMade) {
  EXPECT_TRUE(CheckThreadsCanBeMade(0).ok());
  EXPECT_TRUE(CheckThreadsCanBeMade(8).ok());
}

}  // namespace
}  // namespace evpose::server

// SPDX-License-Identifier: Apache-2.0
#include "server/stores/common/commit_guard.h"

#include <gtest/gtest.h>

#include <new>

namespace evpose::server {
namespace {

TEST(CommitGuard, ACommitWithoutMemoryIsTriedAgain) {
  EXPECT_EQ(OrUnavailable([]() -> absl::Status { throw std::bad_alloc(); }).code(), absl::StatusCode::kUnavailable);
  EXPECT_EQ(OrUnavailable([] { return absl::ResourceExhaustedError("full"); }).code(),
            absl::StatusCode::kResourceExhausted);
  EXPECT_TRUE(OrUnavailable([] { return absl::OkStatus(); }).ok());
}

}  // namespace
}  // namespace evpose::server

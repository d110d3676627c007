// SPDX-License-Identifier: Apache-2.0
#include "server/runtime/out_of_memory.h"

#include <gtest/gtest.h>

#include <new>
#include <string>

#include "absl/status/statusor.h"
#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

TEST(OutOfMemory, AFailedAllocationBecomesAStatus) {
  const uint64_t before = OutOfMemoryCount();
  const absl::StatusOr<std::string> result = OrOutOfMemory([]() -> absl::StatusOr<std::string> {
    throw std::bad_alloc();  // sanitizers end the process for an allocation that is too large
  });
  EXPECT_EQ(result.status().code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(GetErrorDetails(result.status()).reason, "OUT_OF_MEMORY");
  EXPECT_GT(GetErrorDetails(result.status()).retry_after, absl::ZeroDuration());
  EXPECT_TRUE(IsOutOfMemory(result.status()));
  EXPECT_EQ(OutOfMemoryCount(), before + 1);
}

TEST(OutOfMemory, OtherResultsAreReturnedUnchanged) {
  const uint64_t before = OutOfMemoryCount();
  EXPECT_EQ(*OrOutOfMemory([]() -> absl::StatusOr<int> { return 3; }), 3);
  const absl::Status other = OrOutOfMemory([] { return absl::ResourceExhaustedError("another limit"); });
  EXPECT_FALSE(IsOutOfMemory(other));
  EXPECT_FALSE(IsOutOfMemory(absl::OkStatus()));
  EXPECT_EQ(OutOfMemoryCount(), before);
}

TEST(OutOfMemory, GuardsAreCountedPerThread) {
  const auto depth_inside = [] { return absl::StatusOr<int>(memory_guard_depth); };
  EXPECT_EQ(memory_guard_depth, 0);
  EXPECT_EQ(*OrOutOfMemory([&] { return OrOutOfMemory(depth_inside); }), 2);
  EXPECT_FALSE(OrOutOfMemory([]() -> absl::Status { throw std::bad_alloc(); }).ok());
  EXPECT_EQ(memory_guard_depth, 0) << "also after a failure";
}

}  // namespace
}  // namespace evpose::server

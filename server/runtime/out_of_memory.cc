// SPDX-License-Identifier: Apache-2.0
#include "server/runtime/out_of_memory.h"

#include <atomic>

#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

std::atomic<uint64_t> failures = 0;

const absl::Status& ExhaustedStatus() {
  // Never destroyed: threads may use it until the process ends.
  static const absl::Status& status = *new absl::Status(
      LimitReached(v1::OUT_OF_MEMORY, "memory",
                   "the server's memory is exhausted, and this call or session was ended: try again later; the "
                   "operator can give the server more memory or a smaller --max-session-memory",
                   kRetryDelay));
  return status;
}

}  // namespace

absl::Status OutOfMemory() {
  failures.fetch_add(1, std::memory_order_relaxed);
  return ExhaustedStatus();
}

uint64_t OutOfMemoryCount() { return failures.load(std::memory_order_relaxed); }

bool IsOutOfMemory(const absl::Status& status) { return status == ExhaustedStatus(); }

void PrepareForOutOfMemory() { ExhaustedStatus(); }

}  // namespace evpose::server

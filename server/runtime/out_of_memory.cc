// SPDX-License-Identifier: Apache-2.0
#include "server/runtime/out_of_memory.h"

#include <atomic>
#include <cstdlib>

#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

// Enough for the statuses and messages of all calls that end at the same time.
constexpr size_t kReserveBytes = 16u << 20;

std::atomic<uint64_t> failures = 0;
std::atomic<bool> keeps_reserve = false;
std::atomic<void*> reserve = nullptr;

// The handler of operator new for a failed allocation. Without the exception, operator new would try again: the large
// allocation that has failed would then take the reserve.
void ReleaseReserve() {
  std::free(reserve.exchange(nullptr));
  throw std::bad_alloc();
}

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

void KeepMemoryReserve() {
  ExhaustedStatus();
  if (keeps_reserve.exchange(true)) return;
  std::set_new_handler(ReleaseReserve);
  RefillMemoryReserve();
}

void RefillMemoryReserve() {
  if (!keeps_reserve.load(std::memory_order_relaxed) || reserve.load(std::memory_order_relaxed) != nullptr) return;
  void* const block = std::malloc(kReserveBytes);
  void* none = nullptr;
  if (!reserve.compare_exchange_strong(none, block)) std::free(block);
}

}  // namespace evpose::server

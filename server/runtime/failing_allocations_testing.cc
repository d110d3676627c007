// SPDX-License-Identifier: Apache-2.0
#include "server/runtime/failing_allocations_testing.h"

#include <algorithm>
#include <cstdlib>
#include <new>

namespace evpose::server {

FailingAllocation& ThisThreadsFailingAllocation() {
  static thread_local FailingAllocation failing;
  return failing;
}

}  // namespace evpose::server

// All three, because sanitizers compare the functions that allocate and free.
void* operator new(size_t size) {
  evpose::server::FailingAllocation& failing = evpose::server::ThisThreadsFailingAllocation();
  const bool counts = failing.successes_before >= 0 && size >= failing.min_bytes;
  if (counts && failing.successes_before-- == 0) throw std::bad_alloc();
  void* const block = std::malloc(std::max<size_t>(size, 1));
  if (block == nullptr) throw std::bad_alloc();
  return block;
}
void operator delete(void* block) noexcept { std::free(block); }
void operator delete(void* block, size_t) noexcept { std::free(block); }

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

// All functions for single objects, because sanitizers compare the function that allocates with the one that frees.
void* operator new(size_t size) {
  evpose::server::FailingAllocation& failing = evpose::server::ThisThreadsFailingAllocation();
  const bool counts = failing.successes_before >= 0 && size >= failing.min_bytes;
  if (counts && failing.successes_before-- == 0) throw std::bad_alloc();
  void* const block = std::malloc(std::max<size_t>(size, 1));
  if (block == nullptr) throw std::bad_alloc();
  return block;
}
void* operator new(size_t size, const std::nothrow_t&) noexcept {
  try {
    return operator new(size);
  } catch (const std::bad_alloc&) {
    return nullptr;
  }
}
void operator delete(void* block) noexcept { std::free(block); }
void operator delete(void* block, size_t) noexcept { std::free(block); }
void operator delete(void* block, const std::nothrow_t&) noexcept { std::free(block); }

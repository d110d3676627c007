// SPDX-License-Identifier: Apache-2.0

// The allocation function of evpose-server. A large allocation whose failure is reported
// (server/runtime/out_of_memory.h) fails while some memory is left: for small allocations, and for libraries such as
// gRPC, which ends the process when it has no memory.
#include <sys/mman.h>

#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <new>

#include "server/runtime/out_of_memory.h"

namespace {

// Smaller blocks need no check: the question to the kernel would cost more than the allocation, and the headroom
// contains many of them.
constexpr size_t kLargeBytes = size_t{64} << 10;
// Enough for messages that are received and sent, and for the errors of all calls.
constexpr size_t kHeadroomBytes = size_t{32} << 20;

// Asks the kernel, without the use of a page: a limit of the address space, or of the memory that may be committed,
// refuses the mapping.
bool HasHeadroom() {
  void* const probe =
      mmap(nullptr, kHeadroomBytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, /*fd=*/-1, /*offset=*/0);
  if (probe == MAP_FAILED) return false;
  munmap(probe, kHeadroomBytes);
  return true;
}

}  // namespace

// The other forms without an alignment call this one, and the usual operator delete calls std::free().
void* operator new(size_t size) {
  void* const block = std::malloc(std::max<size_t>(size, 1));
  const bool must_leave_headroom = size >= kLargeBytes && evpose::server::memory_guard_depth > 0;
  if (block != nullptr && (!must_leave_headroom || HasHeadroom())) return block;
  std::free(block);
  throw std::bad_alloc();
}

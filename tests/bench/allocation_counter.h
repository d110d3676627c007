// SPDX-License-Identifier: Apache-2.0

// Counts the allocations of a program in all threads: malloc and everything that calls it (operator new, Eigen, the
// standard library). For programs without sanitizers, because those replace the allocator.
#pragma once

#include <cstddef>
#include <string>

namespace evpose::bench {

// Counts from its construction on. At most one may exist at a time.
class AllocationCounter {
 public:
  AllocationCounter();
  ~AllocationCounter();

  size_t count() const;
  // The stack of the first allocation, for addr2line; empty if there was none.
  std::string FirstOrigin() const;
};

}  // namespace evpose::bench

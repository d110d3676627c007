// SPDX-License-Identifier: Apache-2.0

// Counts what a program allocates: malloc and all that ends there (operator new, Eigen, the standard library), of every
// thread. For programs without sanitizers, which have an allocator of their own.
#pragma once

#include <cstddef>
#include <string>

namespace evpose::bench {

// Counts from its beginning on. One at a time.
class AllocationCounter {
 public:
  AllocationCounter();
  ~AllocationCounter();

  size_t count() const;
  // The calls that led to the first of them, for addr2line; empty without any.
  std::string FirstOrigin() const;
};

}  // namespace evpose::bench

// SPDX-License-Identifier: Apache-2.0

// Allocations that fail when a test wants it: a program that links this replaces operator new.
#pragma once

#include <cstddef>

namespace evpose::server {

// Number of allocations of a thread with at least `min_bytes` that succeed before one fails. Negative: none fails, as
// after the one that failed.
struct FailingAllocation {
  int successes_before = -1;
  size_t min_bytes = 1;
};
FailingAllocation& ThisThreadsFailingAllocation();

// Calls `function()` while the allocation of this thread after `successes` further ones fails. Returns whether there
// were so many that it failed.
template <typename Function>
bool FailsAllocation(int successes, const Function& function) {
  FailingAllocation& failing = ThisThreadsFailingAllocation();
  failing.successes_before = successes;
  function();
  const bool has_failed = failing.successes_before < 0;
  failing.successes_before = -1;
  return has_failed;
}

}  // namespace evpose::server

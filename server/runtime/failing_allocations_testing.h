// SPDX-License-Identifier: Apache-2.0

// Allocations that fail when a test wants it: a program that links this replaces operator new.
#pragma once

#include <cstddef>
#include <new>

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

// Calls `function()` once for each of its allocations, which then fails, and at the end while none fails; calls
// `check(number)` after each call. Returns the number of calls that std::bad_alloc ended.
template <typename Function, typename Check>
int FailEachAllocation(const Function& function, const Check& check) {
  int num_ended = 0;
  bool has_failed = true;
  for (int number = 0; has_failed; ++number) {
    has_failed = FailsAllocation(number, [&] {
      try {
        function();
      } catch (const std::bad_alloc&) {
        ++num_ended;
      }
    });
    check(number);
  }
  return num_ended;
}

}  // namespace evpose::server

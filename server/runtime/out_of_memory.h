// SPDX-License-Identifier: Apache-2.0

// Handling of failed allocations: the call or the session for which it was made ends, and the process goes on.
// The standard library reports it by an exception, which these guards turn into a status.
#pragma once

#include <cstdint>
#include <new>
#include <utility>

#include "absl/status/status.h"

namespace evpose::server {

// Counts a failure and returns RESOURCE_EXHAUSTED (OUT_OF_MEMORY). Allocates nothing after the first call of one of the
// two functions.
absl::Status OutOfMemory();
void PrepareForOutOfMemory();
// Number of calls of OutOfMemory() so far.
uint64_t OutOfMemoryCount();
bool IsOutOfMemory(const absl::Status& status);

// Depth of the guards below on this thread. Inside them a failed allocation is reported to a caller; elsewhere, and in
// libraries, it may end the process. evpose-server therefore lets large allocations inside guards fail while memory is
// left for the others (server/program/memory_headroom.cc).
inline thread_local int memory_guard_depth = 0;

// Returns what `work` returns, a status or absl::StatusOr; OutOfMemory() if memory is exhausted. Everything that `work`
// changes must be released by destructors, or must not be used afterwards.
template <typename Work>
auto OrOutOfMemory(Work&& work) -> decltype(work()) {
  struct Scope {
    Scope() { ++memory_guard_depth; }
    ~Scope() { --memory_guard_depth; }
  };
  try {
    const Scope scope;
    return std::forward<Work>(work)();
  } catch (const std::bad_alloc&) {
    return OutOfMemory();
  }
}

// Runs `work`, whose result is ignored. If memory is exhausted, the work ends early, which is counted.
template <typename Work>
void RunUnlessOutOfMemory(Work&& work) {
  (void)OrOutOfMemory([&work] {
    std::forward<Work>(work)();
    return absl::OkStatus();
  });
}

}  // namespace evpose::server

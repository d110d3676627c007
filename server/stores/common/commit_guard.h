// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <utility>

#include "absl/status/status.h"
#include "server/runtime/out_of_memory.h"

namespace evpose::server {

// Returns the status of `work`, a step on the thread of a store; UNAVAILABLE if memory is exhausted, so that the
// session's commit is tried again later.
template <typename Work>
absl::Status OrUnavailable(Work&& work) {
  absl::Status status = OrOutOfMemory(std::forward<Work>(work));
  if (IsOutOfMemory(status)) return absl::UnavailableError("the server's memory is exhausted");
  return status;
}

}  // namespace evpose::server

// SPDX-License-Identifier: Apache-2.0

// What a process of this machine has used: from the kernel, so that it may be any program.
#pragma once

#include <sys/types.h>

#include "absl/status/statusor.h"

namespace evpose::client {

// Seconds that processors have spent on it since it began, all of its threads, those that have ended included. Errors:
// NOT_FOUND when there is no such process.
absl::StatusOr<double> ProcessorSeconds(pid_t pid);

struct ProcessMemory {
  double resident_mb = 0.0;  // now; MB of 2^20 bytes
  double peak_mb = 0.0;      // the most there ever was
};
// Errors: NOT_FOUND.
absl::StatusOr<ProcessMemory> MemoryOf(pid_t pid);

}  // namespace evpose::client

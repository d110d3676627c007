// SPDX-License-Identifier: Apache-2.0

// Processor time and memory of a process on this machine, as the kernel counts them.
#pragma once

#include <sys/types.h>

#include "absl/status/statusor.h"

namespace evpose::client {

// Processor time in seconds since the start of the process, of all its threads including those that have ended. Errors:
// NOT_FOUND if there is no such process.
absl::StatusOr<double> ProcessorSeconds(pid_t pid);

struct ProcessMemory {
  double resident_mb = 0.0;  // now; 1 MB is 2^20 bytes
  double peak_mb = 0.0;      // largest resident memory since the start
};
// Errors: NOT_FOUND if there is no such process.
absl::StatusOr<ProcessMemory> MemoryOf(pid_t pid);

}  // namespace evpose::client

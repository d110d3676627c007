// SPDX-License-Identifier: Apache-2.0

// Processor time and memory of this process, as the kernel counts them.
#pragma once

#include <cstdint>

namespace evpose::server {

// Processor time of all threads since the start, those that have ended included, seconds.
double ProcessCpuSeconds();
// Resident memory, bytes; 0 without /proc.
uint64_t ProcessResidentBytes();

}  // namespace evpose::server

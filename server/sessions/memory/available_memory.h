// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>

namespace evpose::server {

// Returns the bytes of memory that the process may take: the smallest of the machine's memory and the limits of the
// process's control group and of the groups above it (memory.max of version 2, memory.limit_in_bytes of version 1).
// `root` is prepended to /proc and /sys, for tests.
uint64_t AvailableMemoryBytes(const std::string& root = "");

}  // namespace evpose::server

// SPDX-License-Identifier: Apache-2.0

// The jobs of a writing thread, in groups that become one transaction each.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"

namespace evpose::server {

// Bounds the size of a transaction, so that the first commits of a group do not wait for many megabytes of others, and
// the bytes that a client library copies.
inline constexpr uint64_t kMaxGroupBytes = 64u << 20;

// Calls `process(group)` for consecutive groups of `jobs`, of at most kMaxGroupBytes unless one job alone has more.
// `size_bytes(job)` returns the size of a job.
template <typename Job, typename SizeBytes, typename Process>
void ForEachGroup(std::vector<Job>& jobs, const SizeBytes& size_bytes, const Process& process) {
  size_t begin = 0;
  while (begin < jobs.size()) {
    size_t end = begin;
    uint64_t group_bytes = 0;
    while (end < jobs.size() && (end == begin || group_bytes + size_bytes(jobs[end]) <= kMaxGroupBytes)) {
      group_bytes += size_bytes(jobs[end++]);
    }
    process(absl::MakeSpan(jobs).subspan(begin, end - begin));
    begin = end;
  }
}

}  // namespace evpose::server

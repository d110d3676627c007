// SPDX-License-Identifier: Apache-2.0

// Limits of one session: those that the operator sets, and the constants by which its memory stays bounded.
#pragma once

#include <cstddef>
#include <cstdint>

#include "absl/time/time.h"
#include "server/sessions/durability/session_committer.h"

namespace evpose::server {

struct SessionLimits {
  // ServerOptions (server/rpc/server.h) has the reasons of these defaults.
  uint64_t credit_bytes = 4ull << 20;  // undecoded bytes that may wait; at least max_chunk_bytes
  uint32_t max_chunk_bytes = 1u << 20;
  uint32_t pose_log_capacity = 16'384;        // poses in memory, for readers
  absl::Duration expiry = absl::Minutes(10);  // time without a stream after which the session is deleted
  // False: processed data count as persisted, and nothing is written. For stores that end with the process.
  bool writes_checkpoints = true;
  SessionCommitter::Backoff backoff;
};

// Number of poses by which a stream's reader may lag before the session waits for it (kBlock) or drops events
// (kLatest).
inline constexpr uint64_t kMaxUnsentPoses = 1024;
// Number of poses by which a live watcher may lag; beyond it, it continues with the newest pose.
inline constexpr uint64_t kMaxLivePosesBehind = 1024;
// Empty chunks and resets cost no credit: this limits their number.
inline constexpr size_t kMaxQueuedItems = 4096;
// Notices that a stream has not taken before the session waits for it.
inline constexpr size_t kMaxUntakenNotices = 1024;
// Triggers of a chunk in its notice: both edges of a signal of 32 kHz at the usual 1 ms per chunk. Triggers take at
// most half of the untaken notices, in which they have 0.5 MiB.
inline constexpr size_t kMaxTriggersOfChunk = 64;

}  // namespace evpose::server

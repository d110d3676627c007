// SPDX-License-Identifier: Apache-2.0

// Limits of one session: those that the operator sets, and the constants by which its memory stays bounded.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

#include "absl/time/time.h"
#include "server/sessions/durability/session_committer.h"
#include "server/telemetry/log_limiter.h"

namespace evpose::server {

struct SessionLimits {
  // ServerOptions (server/rpc/server.h) has the reasons of these defaults.
  uint64_t credit_bytes = 4ull << 20;  // undecoded bytes that may wait; at least max_chunk_bytes
  uint32_t max_chunk_bytes = 1u << 20;
  uint32_t pose_log_capacity = 16'384;        // poses in memory, for readers
  uint64_t pose_log_bytes = 4ull << 20;       // of the poses in the store; the last 4096 poses stay in any case
  absl::Duration expiry = absl::Minutes(10);  // time without a stream after which the session is deleted
  // False for stores that end with the process: processed data then count as persisted, and nothing is written.
  bool writes_checkpoints = true;
  SessionCommitter::Backoff backoff;
  std::shared_ptr<LogLimiter> log_limiter;  // SessionLog::MakeLimiter(); null: all lines of the log are written
};

// Number of poses by which a stream's reader may lag before the session waits for it (kBlock) or drops events
// (kLatest): a second of poses at 1 kHz. A larger number would hide a slow client for longer and take more memory.
inline constexpr uint64_t kMaxUnsentPoses = 1024;
// Number of poses by which a live watcher may lag. A watcher that lags by more continues with the newest pose.
inline constexpr uint64_t kMaxLivePosesBehind = 1024;
// Maximum number of items that wait. Empty chunks and resets cost no credit, so that their number needs a limit of its
// own.
inline constexpr size_t kMaxQueuedItems = 4096;
// Maximum number of notices that the stream has not taken. At this number the session waits for the stream.
inline constexpr size_t kMaxUntakenNotices = 1024;
// Maximum number of triggers of a chunk in its notice: both edges of a signal of 32 kHz at the usual 1 ms per chunk.
// Triggers take at most half of the untaken notices, where they occupy 0.5 MiB.
inline constexpr size_t kMaxTriggersOfChunk = 64;

}  // namespace evpose::server

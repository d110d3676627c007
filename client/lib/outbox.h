// SPDX-License-Identifier: Apache-2.0

// The chunks that the server may still ask for: in memory up to a bound, then in a spool.
#pragma once

#include <condition_variable>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/lib/outgoing_chunk.h"
#include "client/lib/spool.h"

namespace evpose::client {

struct OutboxOptions {
  uint64_t memory_bytes = 64ull << 20;  // of chunks kept
  // What does not fit into memory goes here; without it, and when it is full, the source waits. One that outlives the
  // process takes every chunk at once, so that a process that is killed loses none.
  std::optional<SpoolOptions> spool;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

struct OutboxState {
  uint64_t first_seq = 1;    // of the chunks that are kept
  FeedPoint last;            // after the last chunk that came
  uint64_t durable_seq = 0;  // that the server will never ask for again
  uint64_t kept_bytes = 0;   // of payload above it
  bool is_waiting = false;   // full: the source waits
};

// One thread appends, one reads, any may forget.
class Outbox {
 public:
  // Begins after `begin`; a spool that holds chunks of an earlier process goes on after those. Errors: those of
  // OutboxOptions and of the spool.
  static absl::StatusOr<std::unique_ptr<Outbox>> Open(const OutboxOptions& options, const FeedPoint& begin = {});

  // Waits until less than `bytes` have not been asked for by Get(), or Get() waits; false when `stop` came first.
  bool WaitForDemand(uint64_t bytes, std::stop_token stop);
  // Waits while it is full. One whose number is durable already is dropped. CANCELLED when `stop` came first; the
  // errors of the spool.
  absl::Status Append(OutgoingChunk chunk, std::stop_token stop);
  // Nothing follows; not OK: why.
  void Finish(const absl::Status& status);

  // Waits for the chunk of this number; nullptr when the feed ended before it. Errors: what the feed ended with;
  // CANCELLED when `stop` came first; DATA_LOSS for a chunk that was forgotten, FAILED_PRECONDITION for one beyond the
  // end.
  absl::StatusOr<std::shared_ptr<const OutgoingChunk>> Get(uint64_t seq, std::stop_token stop);
  void Forget(uint64_t durable_seq);
  // The session is over: deletes what the spool has.
  void Clear();
  // The place after the last durable chunk that came.
  FeedPoint durable() const;
  OutboxState state() const;

 private:
  Outbox(const OutboxOptions& options, const FeedPoint& begin);
  bool HasRoomFor(const OutgoingChunk& chunk) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool GoesToSpool(const OutgoingChunk& chunk) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void DropDurable() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::StatusOr<std::shared_ptr<const OutgoingChunk>> Find(uint64_t seq) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const OutboxOptions options_;
  mutable std::mutex mutex_;
  std::condition_variable_any changed_;
  // First what is in memory, then what is in the spool.
  std::deque<std::shared_ptr<const OutgoingChunk>> memory_ ABSL_GUARDED_BY(mutex_);
  std::unique_ptr<Spool> spool_ ABSL_GUARDED_BY(mutex_);
  uint64_t memory_bytes_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t first_seq_ ABSL_GUARDED_BY(mutex_) = 1;  // of those that are kept
  FeedPoint last_ ABSL_GUARDED_BY(mutex_);
  FeedPoint durable_ ABSL_GUARDED_BY(mutex_);
  uint64_t durable_seq_ ABSL_GUARDED_BY(mutex_) = 0;  // may be ahead of what came
  uint64_t asked_bytes_ ABSL_GUARDED_BY(mutex_) = 0;  // of the feed, up to the last chunk that Get() gave
  uint64_t wanted_seq_ ABSL_GUARDED_BY(mutex_) = 0;   // that Get() waits for
  bool is_waiting_ ABSL_GUARDED_BY(mutex_) = false;   // Append() waits
  std::optional<absl::Status> finished_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::client

// SPDX-License-Identifier: Apache-2.0

// Chunks that the server may still request: in memory up to a bound, then in a spool.
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
#include "client/lib/stream/outgoing_chunk.h"
#include "client/lib/stream/spool.h"

namespace evpose::client {

struct OutboxOptions {
  uint64_t memory_bytes = 64ull << 20;  // limit of the chunks in memory
  // Receives the chunks that exceed the memory; without it, and when it is full, the source waits. A persistent spool
  // receives every chunk at once, so that a killed process loses none.
  std::optional<SpoolOptions> spool;

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

struct OutboxState {
  uint64_t first_seq = 1;   // first stored chunk
  FeedPoint last;           // after the last appended chunk
  uint64_t kept_bytes = 0;  // payload that the server may request again
  bool is_waiting = false;  // the outbox is full, and the source waits
};

// One thread may append, one may read, and any may forget.
class Outbox {
 public:
  // Begins after `begin`; a spool with chunks of an earlier process continues after those. Errors: those of
  // OutboxOptions and of the spool.
  static absl::StatusOr<std::unique_ptr<Outbox>> Open(const OutboxOptions& options, const FeedPoint& begin = {});

  // Waits until Get() has fewer than `bytes` left to return or until Get() waits; returns false if `stop` was requested
  // first.
  bool WaitForDemand(uint64_t bytes, std::stop_token stop);
  // Waits while the outbox is full. Drops a chunk whose number is durable already. Errors: CANCELLED if `stop` was
  // requested first; those of the spool.
  absl::Status Append(OutgoingChunk chunk, std::stop_token stop);
  // Marks the end of the feed, after an error with its status.
  void Finish(const absl::Status& status);

  // Waits for the chunk with this number; nullptr if the feed ended before it. Errors: the cause of the feed's end;
  // CANCELLED if `stop` was requested first; DATA_LOSS for a forgotten chunk; FAILED_PRECONDITION for a number beyond
  // the end.
  absl::StatusOr<std::shared_ptr<const OutgoingChunk>> Get(uint64_t seq, std::stop_token stop);
  void Forget(uint64_t durable_seq);
  // Deletes the content of the spool at the end of the session.
  void Clear();
  // The position after the last durable chunk.
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
  // Looks in memory first, then in the spool.
  std::deque<std::shared_ptr<const OutgoingChunk>> memory_ ABSL_GUARDED_BY(mutex_);
  std::unique_ptr<Spool> spool_ ABSL_GUARDED_BY(mutex_);
  uint64_t memory_bytes_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t first_seq_ ABSL_GUARDED_BY(mutex_) = 1;  // first stored chunk
  FeedPoint last_ ABSL_GUARDED_BY(mutex_);
  FeedPoint durable_ ABSL_GUARDED_BY(mutex_);
  uint64_t durable_seq_ ABSL_GUARDED_BY(mutex_) = 0;  // may exceed the number of the last appended chunk
  uint64_t asked_bytes_ ABSL_GUARDED_BY(mutex_) = 0;  // payload up to the last chunk that Get() returned
  uint64_t wanted_seq_ ABSL_GUARDED_BY(mutex_) = 0;   // number for which Get() waits
  bool is_waiting_ ABSL_GUARDED_BY(mutex_) = false;   // Append() waits
  std::optional<absl::Status> finished_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::client

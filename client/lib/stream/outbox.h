// SPDX-License-Identifier: Apache-2.0

// Chunks that the server may still request: in memory up to a bound, then in a spool. Durable chunks are retained for a
// while (RetainOptions).
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
#include "evpose/clock.h"
#include "evpose/track.h"

namespace evpose::client {

struct OutboxOptions {
  // 16 s of a stream of 4 MB/s, as of a busy EVK4.
  uint64_t memory_bytes = 64ull << 20;  // limit of the chunks in memory
  // Receives the chunks that exceed the memory; without it, and when it is full, the source waits. A persistent spool
  // receives every chunk at once, so that a killed process loses none.
  std::optional<SpoolOptions> spool;
  RetainOptions retain;    // beside memory_bytes; a spool without room drops retained chunks first
  Clock* clock = nullptr;  // for the retention; nullptr: the machine's clock

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

struct OutboxState {
  uint64_t first_seq = 1;   // first stored chunk
  FeedPoint last;           // after the last appended chunk
  uint64_t kept_bytes = 0;  // payload that is not durable
  bool is_waiting = false;  // the outbox is full, and the source waits
};

// One thread may append, one may read, and any may call Release().
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
  // Adds a chunk up to `begin`, which is durable, in the order of the numbers. It is retained if it is close to
  // `begin`.
  void AddDurable(OutgoingChunk chunk);
  // Marks the end of the feed, after an error with its status.
  void Finish(const absl::Status& status);

  // Waits for the chunk with this number; nullptr if the feed ended before it. Errors: the cause of the feed's end;
  // CANCELLED if `stop` was requested first; DATA_LOSS (ROLLED_BACK) for a released chunk; FAILED_PRECONDITION for a
  // number beyond the end.
  absl::StatusOr<std::shared_ptr<const OutgoingChunk>> Get(uint64_t seq, std::stop_token stop);
  // The server has made the chunks up to this one durable.
  void Release(uint64_t durable_seq);
  // Deletes the content of the spool at the end of the session.
  void Clear();
  // The position after the last durable chunk.
  FeedPoint durable() const;
  OutboxState state() const;
  // The first chunk that Get() can return; nullopt while chunks up to `begin` are still being added.
  std::optional<uint64_t> FirstSeq() const;

 private:
  // A position up to which the chunks became durable at one time.
  struct Mark {
    uint64_t seq = 0;
    uint64_t bytes = 0;
    absl::Time durable_at;
  };

  Outbox(const OutboxOptions& options, const FeedPoint& begin);
  bool HasRoomFor(const OutgoingChunk& chunk) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool GoesToSpool(const OutgoingChunk& chunk) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool HasUndurableInMemory() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    return num_durable_in_memory_ < memory_.size();
  }
  // Whether the present chunks up to `begin` have been added, or `seq` is a later one.
  bool IsAdded(uint64_t seq) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    return has_reached_begin_ || seq > begin_.seq;
  }
  absl::Time Now() const { return options_.clock == nullptr ? SystemClock().Now() : options_.clock->Now(); }
  // Applies durable_seq_ to the chunks, and drops those that are not retained any longer.
  void DropDurable() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void AdvanceDurable() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void DropRetained(bool all) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::Status AppendToSpool(const OutgoingChunk& chunk) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::StatusOr<std::shared_ptr<const OutgoingChunk>> Find(uint64_t seq) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const OutboxOptions options_;
  const FeedPoint begin_;
  mutable std::mutex mutex_;
  std::condition_variable_any changed_;
  // The numbers of all chunks together are consecutive: in memory, then in the spool, then in memory again if all of
  // the spool is durable.
  std::deque<std::shared_ptr<const OutgoingChunk>> memory_ ABSL_GUARDED_BY(mutex_);
  size_t num_durable_in_memory_ ABSL_GUARDED_BY(mutex_) = 0;  // the first ones
  std::deque<Mark> marks_ ABSL_GUARDED_BY(mutex_);            // of the retained chunks
  Mark released_ ABSL_GUARDED_BY(mutex_);                     // chunks up to this one are not retained
  bool has_reached_begin_ ABSL_GUARDED_BY(mutex_) = false;
  std::unique_ptr<Spool> spool_ ABSL_GUARDED_BY(mutex_);
  uint64_t memory_bytes_ ABSL_GUARDED_BY(mutex_) = 0;  // without durable chunks
  uint64_t first_seq_ ABSL_GUARDED_BY(mutex_) = 1;     // first stored chunk
  FeedPoint last_ ABSL_GUARDED_BY(mutex_);
  FeedPoint durable_ ABSL_GUARDED_BY(mutex_);
  uint64_t durable_seq_ ABSL_GUARDED_BY(mutex_) = 0;  // may exceed the number of the last appended chunk
  uint64_t asked_bytes_ ABSL_GUARDED_BY(mutex_) = 0;  // payload up to the last chunk that Get() returned
  uint64_t wanted_seq_ ABSL_GUARDED_BY(mutex_) = 0;   // number for which Get() waits
  bool is_waiting_ ABSL_GUARDED_BY(mutex_) = false;   // Append() waits
  std::optional<absl::Status> finished_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::client

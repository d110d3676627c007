// SPDX-License-Identifier: Apache-2.0

// What a session is fed with: a source's chunks, numbered, paced, and kept until the server needs them no more.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/lib/stream/outbox.h"
#include "client/lib/stream/pacer.h"
#include "evpose/clock.h"
#include "evpose/track.h"

namespace evpose::client {

struct FeedOptions {
  // Bytes read before they can be sent. A live source is to be read whatever the network does: UINT64_MAX.
  uint64_t read_ahead_bytes = 1 << 20;
  OutboxOptions outbox;
  double rate = 0.0;       // sensor seconds per second; 0: as fast as they are asked for
  Clock* clock = nullptr;  // what paces; nullptr: the machine's
  // The source begins at the beginning, but the session has these chunks for good: they are read and not kept.
  FeedPoint skip;
  // The source goes on after a gap: bytes were lost before its first chunk.
  bool begins_after_gap = false;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// A number stands for the same bytes in every feed of the same source with the same `max_piece_bytes`.
class EventFeed {
 public:
  // Errors: those of FeedOptions and of Outbox::Open().
  static absl::StatusOr<std::unique_ptr<EventFeed>> Open(ChunkSource source, const FeedOptions& options);
  ~EventFeed();  // Stop()

  // Begins to read. A chunk of the source is cut into pieces of at most so many bytes, whole words of every encoding.
  // Only the first call counts.
  void Start(uint64_t max_piece_bytes);
  // Inserts a reset after the chunks that were read so far, as soon as the source returns. Thread-safe. Errors:
  // INVALID_ARGUMENT; FAILED_PRECONDITION if the events have ended.
  absl::Status ResetPose(const PoseReset& reset);
  // Wakes the thread where it waits and joins it; a source that blocks must have been told before. Idempotent.
  void Stop();

  uint64_t max_piece_bytes() const { return max_piece_bytes_; }  // 0 before Start()
  Outbox& outbox() { return *outbox_; }

 private:
  EventFeed(ChunkSource source, const FeedOptions& options, std::unique_ptr<Outbox> outbox);
  void Run();
  absl::Status Add(const EventChunk& chunk);
  absl::Status AddReset(const PoseReset& reset);
  absl::Status AddPiece(OutgoingChunk piece);
  // Adds the resets of ResetPose(); with `is_end`, later ones are refused.
  absl::Status AddPendingResets(bool is_end);
  absl::Status CheckSkipped() const;

  const ChunkSource source_;
  const FeedOptions options_;
  const std::unique_ptr<Outbox> outbox_;
  Pacer pacer_;
  FeedPoint point_;  // after the last piece made
  bool is_after_gap_;
  std::atomic<uint64_t> max_piece_bytes_ = 0;
  std::mutex mutex_;
  std::vector<PoseReset> pending_resets_ ABSL_GUARDED_BY(mutex_);
  bool has_ended_ ABSL_GUARDED_BY(mutex_) = false;
  std::stop_source stop_;
  std::jthread thread_;
};

}  // namespace evpose::client

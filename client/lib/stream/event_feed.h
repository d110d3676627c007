// SPDX-License-Identifier: Apache-2.0

// Reads the chunks of a source, numbers and paces them, and keeps them until the server has made them durable.
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
#include "client/lib/stream/due_times.h"
#include "client/lib/stream/outbox.h"
#include "client/lib/stream/pacer.h"
#include "evpose/clock.h"
#include "evpose/track.h"

namespace evpose::client {

struct FeedOptions {
  // Bytes that are read ahead of the network. UINT64_MAX for a live source, which must be read during an outage, too.
  uint64_t read_ahead_bytes = 1 << 20;
  OutboxOptions outbox;
  double rate = 0.0;  // sensor seconds per second; 0: as fast as the network requests them
  // The source returns events while the sensor generates them, so that they have a lag without a rate, too.
  bool is_live = false;
  Clock* clock = nullptr;  // for the rate and the retention; nullptr: the machine's clock
  // Position up to which the chunks of the source are durable: they are read from the start, and only the
  // last ones are retained.
  FeedPoint skip;
  // Whether bytes were lost before the first chunk of the source.
  bool begins_after_gap = false;
};

// Feeds of the same source with the same `max_piece_bytes` assign the same numbers to the same bytes.
class EventFeed {
 public:
  // Errors: those of Outbox::Open().
  static absl::StatusOr<std::unique_ptr<EventFeed>> Open(ChunkSource source, const FeedOptions& options);
  ~EventFeed();  // calls Stop()

  // Starts to read. Chunks of the source are divided into pieces of at most `max_piece_bytes`, of whole words of every
  // encoding. Calls after the first have no effect.
  void Start(uint64_t max_piece_bytes);
  // Inserts a reset after the chunks that were read so far, as soon as the source returns. Thread-safe. Errors:
  // INVALID_ARGUMENT; FAILED_PRECONDITION if the events have ended, or 1000 resets wait for the source.
  absl::Status ResetPose(const PoseReset& reset);
  // Wakes the thread and joins it; a source that blocks must have been stopped before. Idempotent.
  void Stop();

  uint64_t max_piece_bytes() const { return max_piece_bytes_; }  // 0 before Start()
  // The latest sensor time of the chunks read so far, microseconds; kMaxStateTimeUs if the source does not state it,
  // if chunks were not read by this process, or if fewer than `seq` pieces have been read.
  int64_t LatestTime(uint64_t seq) const;
  // Returns for how long the oldest piece after `processed_seq` should have been processed: according to the rate, or
  // for a live source since it was read. A source that is faster than the sensor, such as a file in a pipe, has no lag
  // before the sensor's pace requires the piece. Zero without a rate and a live source. Thread-safe.
  absl::Duration Lag(uint64_t processed_seq) { return due_times_.Lag(processed_seq, clock_.Now()); }
  Outbox& outbox() { return *outbox_; }

 private:
  EventFeed(ChunkSource source, const FeedOptions& options, std::unique_ptr<Outbox> outbox);
  void Run();
  absl::Status Add(const EventChunk& chunk);
  absl::Status AddReset(const PoseReset& reset);
  absl::Status AddPiece(OutgoingChunk piece);
  // Returns when events up to the time `t_us`, which have just been read, should be processed; nullopt if never.
  std::optional<absl::Time> DueTime(int64_t t_us);
  // Adds the resets of ResetPose(); with `is_end`, later ones are refused.
  absl::Status AddPendingResets(bool is_end);
  absl::Status CheckSkipped() const;

  const ChunkSource source_;
  const FeedOptions options_;
  const std::unique_ptr<Outbox> outbox_;
  Clock& clock_;
  Pacer pacer_;
  Pacer sensor_pace_;  // of a live source, which is not delayed
  absl::Time last_due_ = absl::InfinitePast();
  DueTimes due_times_;
  FeedPoint point_;  // after the last piece made
  bool is_after_gap_;
  std::atomic<uint64_t> max_piece_bytes_ = 0;
  std::atomic<int64_t> latest_us_ = 0;
  std::atomic<uint64_t> read_seq_ = 0;  // updated after latest_us_
  std::mutex mutex_;
  std::vector<PoseReset> pending_resets_ ABSL_GUARDED_BY(mutex_);
  bool has_ended_ ABSL_GUARDED_BY(mutex_) = false;
  std::stop_source stop_;
  std::jthread thread_;
};

}  // namespace evpose::client

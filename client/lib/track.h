// The data plane: events up, poses down, over one stream.
#pragma once

#include <cstdint>
#include <functional>
#include <stop_token>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "client/lib/clock.h"
#include "client/lib/types.h"
#include "core/events/recording_reader.h"

namespace evpose::client {

// The next chunk; empty bytes at the end. Called in a thread of its own, and may block; a source that waits for a live
// stream must give up when TrackOptions::stop is requested.
using ChunkSource = std::function<absl::StatusOr<EventChunkBytes>()>;

struct TrackProgress {
  uint64_t sent_bytes = 0;
  uint64_t processed_chunks = 0;
  uint64_t poses = 0;
};

// Called in the thread that called Track(), in the order in which the server sent. A callback that takes its time
// slows the stream down and loses nothing.
struct TrackCallbacks {
  std::function<void(const Pose&)> on_pose;
  std::function<void(const Notice&)> on_notice;
  std::function<void(const TrackProgress&)> on_progress;  // whenever the server has processed more
};

struct TrackOptions {
  double rate = 0.0;         // sensor seconds per second; 0: as fast as the server gives credit
  Clock* clock = nullptr;    // what paces; nullptr: the machine's
  bool has_checksum = true;  // CRC-32C over each chunk: costs a fraction of a percent and finds a bad link
  absl::Duration attach_timeout = absl::Seconds(10);  // a server that took the call answers at once or never
  // Requested by the caller: cancels the stream. Requested by Track() when the stream has ended, so that the source
  // gives up.
  std::stop_source stop;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

struct TrackSummary {
  SessionHealth health;
  uint64_t sent_bytes = 0;
  uint64_t sent_chunks = 0;
  uint64_t poses = 0;
};

}  // namespace evpose::client

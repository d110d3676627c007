// SPDX-License-Identifier: Apache-2.0

// What there is to know of a session from outside, and what of it survives its process.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/time/time.h"
#include "core/events/decoder.h"
#include "core/tracking/tracker.h"
#include "server/runtime/latency_histogram.h"

namespace evpose::server {

struct ObjectHealth {
  TrackState state = TrackState::kInitializing;
  uint32_t losses = 0;
  float explained_ratio = 0.0f;  // of the latest pose
  InitializationReport initialization;
};
struct SessionHealth {
  int64_t t_us = 0;
  uint64_t received_bytes = 0;
  uint64_t processed_bytes = 0;
  DecodeCounts counts;
  uint64_t poses = 0;
  uint32_t reattaches = 0;
  int64_t sensor_time_us = 0;  // from the first time seen to t_us
  int64_t processing_us = 0;
  int64_t queue_age_us = 0;
  uint64_t skipped_events = 0;  // the sum of EventsDropped::num_events, that of a stretch under way included
  int64_t skipped_us = 0;       // sensor time of those stretches
  int64_t latency_p50_us = 0;
  int64_t latency_p99_us = 0;
  std::vector<ObjectHealth> objects;
};

// Of all sessions of a server, at a moment.
struct SessionTotals {
  uint32_t attached = 0;
  uint32_t detached = 0;
  uint32_t ended = 0;
  uint32_t closed = 0;                   // about to go: fenced, or without room in the store
  std::array<uint32_t, 4> objects = {};  // that are tracked, or are to be: by TrackState
  uint64_t queued_bytes = 0;
  int64_t oldest_queue_age_us = 0;
};

// Who may feed the session, and since when nobody does. Committed when a stream attaches or leaves.
struct SessionLifecycle {
  std::string token_digest;           // of the resume token: SHA-256, hex; the token itself is kept nowhere
  std::string previous_token_digest;  // empty: it is no longer good
  uint64_t num_attaches = 0;
  std::optional<absl::Time> detached_at;  // absent while a stream is attached
  uint64_t num_renewals = 0;              // by which its server tells that it lives, while a stream is attached
};

// Where decoding goes on, and what the writer was told until then.
struct StreamPosition {
  std::string decoder;  // EventDecoder::SaveState()
  std::vector<TrackState> reported_states;
  int64_t first_t_us = -1;  // -1: no time has been seen
  int64_t now_us = -1;
  int64_t slice_end_us = 0;

  friend bool operator==(const StreamPosition&, const StreamPosition&) = default;
};

// The state of the tracker, which only a server with the same version of the tracker can read.
struct SavedTracker {
  uint32_t version = 0;
  std::string configuration;  // digest of the configuration and the models that the state belongs to
  std::string bytes;          // Tracker::SaveState()

  friend bool operator==(const SavedTracker&, const SavedTracker&) = default;
};

struct PipelineState {
  StreamPosition position;
  SavedTracker tracker;

  friend bool operator==(const PipelineState&, const PipelineState&) = default;
};

// Where a session can go on from: between two items.
struct SessionCheckpoint {
  uint64_t processed_seq = 0;
  bool ended = false;
  SessionHealth health;  // received_bytes are processed_bytes: the rest is sent again
  LatencyHistogram latencies;
  std::optional<PipelineState> pipeline;  // absent when ended
};

}  // namespace evpose::server

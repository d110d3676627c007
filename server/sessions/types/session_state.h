// SPDX-License-Identifier: Apache-2.0

// The state of a session that readers see, and the part of it that the store has.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/time/time.h"
#include "core/events/decoder.h"
#include "core/tracking/tracker.h"
#include "server/runtime/latency_histogram.h"
#include "server/sessions/types/pose_log.h"
#include "server/sessions/types/session_config.h"
#include "server/sessions/types/stream_data.h"

namespace evpose::server {

struct ObjectHealth {
  TrackState state = TrackState::kInitializing;
  uint32_t losses = 0;
  float explained_ratio = 0.0f;  // explained ratio of the latest pose
  InitializationReport initialization;
};
struct ProcessingHealth {
  double cpu_per_s = 0.0;             // processor seconds per second, averaged with a time constant of one second
  double max_cpu_per_s = 0.0;         // limit of cpu_per_s; 0: none
  bool is_behind = false;             // as LagChange::is_behind
  double tenant_cpu_per_s = 0.0;      // as cpu_per_s, of all sessions of the tenant
  double max_tenant_cpu_per_s = 0.0;  // limit of tenant_cpu_per_s; 0: none
};
// As SessionHealth of the API.
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
  uint64_t skipped_events = 0;  // sum of EventsDropped::num_events, including the gap that is still open
  int64_t skipped_us = 0;       // sensor time of these gaps
  ProcessingHealth processing;
  int64_t latency_p50_us = 0;
  int64_t latency_p99_us = 0;
  std::vector<ObjectHealth> objects;
};

// State in the API.
enum class SessionState { kDetached, kAttached, kEnded };

struct SessionSnapshot {
  SessionState state = SessionState::kDetached;
  absl::Status closed;                    // not OK: the session no longer exists here
  std::optional<absl::Time> expire_time;  // absent while a stream is attached
  SessionHealth health;
};

struct SessionInfo {
  std::string name;
  SessionConfig config;
  absl::Time create_time;
  SessionSnapshot snapshot;
};

// Sums over all sessions of a server.
struct SessionTotals {
  uint32_t attached = 0;
  uint32_t detached = 0;
  uint32_t ended = 0;
  uint32_t closed = 0;  // to be removed: fenced, or without space in the store
  // Number of objects by TrackState, without those of ended sessions.
  std::array<uint32_t, kNumTrackStates> objects = {};
  uint64_t queued_bytes = 0;
  int64_t oldest_queue_age_us = 0;
  uint32_t image_watchers = 0;
};

// Lifecycle record: the tokens with which a client can attach, and the time since when no stream has been attached. It
// is committed when a stream attaches or detaches, when the token changes, and in a shared store periodically while a
// stream is attached.
struct SessionLifecycle {
  std::string token_digest;           // digest of the resume token: SHA-256, hex; the token itself is not stored
  std::string previous_token_digest;  // empty: the previous token is no longer valid
  uint64_t num_attaches = 0;
  std::optional<absl::Time> detached_at;  // absent while a stream is attached
  uint64_t num_renewals = 0;  // incremented regularly while a stream is attached: shows that the server is alive
  // The store has lost the items from this one on, and the client can no longer send them: the session has ended with
  // DATA_LOSS. 0: it has not.
  uint64_t lost_from_seq = 0;
};

// Position from which decoding resumes, and the object states that the stream has been notified of.
struct StreamPosition {
  std::string decoder;  // EventDecoder::SaveState()
  std::vector<TrackState> reported_states;
  int64_t first_t_us = -1;  // -1: no time has been seen
  int64_t now_us = -1;
  int64_t slice_end_us = 0;  // of the present slice of 1 ms: changes of state are reported at its end

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

// State from which a session can be resumed. It is always the state between two items.
struct SessionCheckpoint {
  uint64_t processed_seq = 0;
  bool has_ended = false;
  SessionHealth health;  // received_bytes equals processed_bytes: the client sends the rest again
  LatencyHistogram latencies;
  std::optional<PipelineState> pipeline;  // absent when ended
};

// Returns `health` with the percentiles of `latencies`.
SessionHealth WithLatencies(SessionHealth health, const LatencyHistogram& latencies);
// Returns the number of streams that have attached after the first one.
uint32_t NumReattaches(const SessionLifecycle& lifecycle);
// Returns the health of a session that no server has loaded, as a server that loads it reports it.
SessionHealth StoredHealth(const SessionCheckpoint& checkpoint, const SessionLifecycle& lifecycle);

// State with which a session starts: the stored state, or, for a new session, the lifecycle record with default values
// of the other members.
struct SessionBeginning {
  SessionLifecycle lifecycle;
  SessionCheckpoint checkpoint;
  std::vector<StoredPose> poses;  // consecutive; may extend beyond the checkpoint
  std::optional<TrackingRestarted> restarted;
};

}  // namespace evpose::server

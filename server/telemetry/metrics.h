// SPDX-License-Identifier: Apache-2.0

// What a server counts of its work, for those who operate it; server/metrics writes it down for them. Counting takes no
// lock and no memory, and nothing that is counted comes back into a pose.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>

#include "absl/status/status.h"
#include "core/tracking/track_phase.h"
#include "server/sessions/types/overload.h"
#include "server/sessions/types/session_state.h"

namespace evpose::server {

// Thread-safe. Goes up from 0, where it is when the process starts.
class Counter {
 public:
  void Add(uint64_t count = 1) { value_.fetch_add(count, std::memory_order_relaxed); }
  uint64_t value() const { return value_.load(std::memory_order_relaxed); }

 private:
  std::atomic<uint64_t> value_ = 0;
};

// One for each value of an enumeration whose values are 0 to kNumKinds - 1.
template <typename Kind, size_t kNumKinds, typename What = Counter>
class OneFor {
 public:
  What& operator[](Kind kind) { return all_[static_cast<size_t>(kind)]; }
  const What& operator[](Kind kind) const { return all_[static_cast<size_t>(kind)]; }

 private:
  std::array<What, kNumKinds> all_;
};

// How often something took how long. Thread-safe.
class DurationHistogram {
 public:
  using Duration = std::chrono::steady_clock::duration;

  // What takes up to so long, and longer than the bound before, is in the bucket of a bound; what takes longer than all
  // of them in one more. From the decoding of a small chunk to a pose that nobody wants any more.
  static constexpr std::array<int64_t, 19> kUpperBounds_us = {
      10,     25,     50,      100,     250,     500,       1000,      2500,      5000,      10'000,
      25'000, 50'000, 100'000, 250'000, 500'000, 1'000'000, 2'500'000, 5'000'000, 10'000'000};

  void Add(Duration duration) {
    const auto bucket =
        std::lower_bound(kUpperBounds_us.begin(), kUpperBounds_us.end(), duration,
                         [](int64_t bound_us, Duration value) { return std::chrono::microseconds(bound_us) < value; });
    counts_[static_cast<size_t>(bucket - kUpperBounds_us.begin())].Add();
    sum_ns_.Add(static_cast<uint64_t>(std::max<int64_t>(std::chrono::nanoseconds(duration).count(), 0)));
  }

  struct Reading {
    std::array<uint64_t, kUpperBounds_us.size() + 1> counts = {};  // of the buckets
    double sum_s = 0.0;

    uint64_t total() const;
  };
  Reading Read() const;

 private:
  std::array<Counter, kUpperBounds_us.size() + 1> counts_;
  Counter sum_ns_;
};

enum class StreamKind { kTrack, kWatch };

// Why something is refused, RESOURCE_EXHAUSTED.
enum class QuotaLimit {
  kMaxSessions,
  kMaxStreams,
  kMaxModelStoreBytes,
  kTenantSessions,
  kTenantModelBytes,
  kTenantWatchers,
};

// Why the store has not taken a checkpoint.
enum class CheckpointFailure { kStoreAway, kStoreFull, kFenced, kStoreFailed };

// Of all sessions that there ever were in this process. What is processed again, after a restart or a move, counts
// again.
struct ServerMetrics {
  Counter received_bytes;  // of chunks, those that a session has already excepted
  Counter decoded_events;
  OneFor<DropReason, 3> skipped_events;  // the sums of SessionHealth::skipped_events
  Counter events_before_time;            // as DecodeCounts
  Counter events_outside_sensor;
  Counter unknown_words;
  Counter broken_vectors;
  Counter poses;
  Counter track_losses;
  Counter reinitializations;  // an object has a pose again that it had lost
  OneFor<TrackPhase, kNumTrackPhases, OneFor<TrackPhase, kNumTrackPhases>> track_transitions;  // [from][to]
  OneFor<ObjectPhase, kNumObjectPhases, OneFor<ObjectPhase, kNumObjectPhases>> object_transitions;
  Counter reattaches;

  DurationHistogram pose_latency;         // from a chunk's receipt to each of its poses
  DurationHistogram decode_time;          // of a slice of a chunk
  DurationHistogram track_time;           // of a slice of a chunk, initialization excepted
  DurationHistogram initialization_time;  // of a step in which poses are searched for
  Counter processing_ns;
  Counter sensor_time_us;  // that was processed

  DurationHistogram checkpoint_time;  // from its making until it is durable
  OneFor<CheckpointFailure, 4> checkpoint_failures;

  OneFor<StreamKind, 2, OneFor<absl::StatusCode, 17>> stream_ends;
  OneFor<QuotaLimit, 6> quota_refusals;
  Counter quota_delays;  // a stream was not read for a while: its tenant has sent too many bytes

  uint64_t all_skipped_events() const {
    return skipped_events[DropReason::kLag].value() + skipped_events[DropReason::kMemory].value() +
           skipped_events[DropReason::kReader].value();
  }
};

// How a server is at a moment.
struct ServerState {
  SessionTotals sessions;
  uint32_t max_sessions = 0;
  uint32_t num_workers = 0;
  absl::Status readiness;  // not OK: why it takes no sessions
};

}  // namespace evpose::server

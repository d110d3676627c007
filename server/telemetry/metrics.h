// SPDX-License-Identifier: Apache-2.0

// The counters and histograms of a server; prometheus_text.h formats them. Counting waits for no other thread
// and allocates no memory, and no pose depends on a counter.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "core/tracking/object/track_phase.h"
#include "server/sessions/types/overload.h"
#include "server/sessions/types/session_state.h"
#include "server/stores/common/store.h"

namespace evpose::server {

// A counter that starts at 0 and only rises. Thread-safe.
class Counter {
 public:
  void Add(uint64_t count = 1) { value_.fetch_add(count, std::memory_order_relaxed); }
  uint64_t value() const { return value_.load(std::memory_order_relaxed); }

 private:
  std::atomic<uint64_t> value_ = 0;
};

// An array with one element for each value of an enumeration with the values 0 to kNumKinds - 1.
template <typename Kind, size_t kNumKinds, typename What = Counter>
class OneFor {
 public:
  What& operator[](Kind kind) { return all_[static_cast<size_t>(kind)]; }
  const What& operator[](Kind kind) const { return all_[static_cast<size_t>(kind)]; }

 private:
  std::array<What, kNumKinds> all_;
};

// A recent duration in a bucket of a histogram, with the session that it belongs to.
struct Exemplar {
  std::array<char, 32> trace_id = {};  // TraceIdOf() the session (core/base/trace_context.h)
  std::chrono::nanoseconds duration{0};
  std::chrono::system_clock::time_point time;

  std::string_view trace_id_text() const { return {trace_id.data(), trace_id.size()}; }
};

// Keeps the latest exemplar. Thread-safe. A writer never waits: if another thread is using the slot, its exemplar is
// dropped, because any one will do.
class ExemplarSlot {
 public:
  void Set(const Exemplar& exemplar) {
    if (is_in_use_.exchange(true, std::memory_order_acquire)) return;
    exemplar_ = exemplar;
    is_set_ = true;
    is_in_use_.store(false, std::memory_order_release);
  }
  // Waits for a writer, which holds the slot for some nanoseconds, or until it runs again if it was interrupted.
  std::optional<Exemplar> Get() const;

 private:
  mutable std::atomic<bool> is_in_use_ = false;
  bool is_set_ = false;  // this and the exemplar only while in use
  Exemplar exemplar_;
};

// A histogram of durations. Thread-safe.
class DurationHistogram {
 public:
  using Duration = std::chrono::steady_clock::duration;

  // Inclusive upper bounds of the buckets; one more bucket has the longer durations. They range from the decoding of a
  // small chunk to a latency at which a pose is no longer useful.
  static constexpr std::array<int64_t, 19> kUpperBoundsUs = {
      10,     25,     50,      100,     250,     500,       1000,      2500,      5000,      10'000,
      25'000, 50'000, 100'000, 250'000, 500'000, 1'000'000, 2'500'000, 5'000'000, 10'000'000};

  static constexpr size_t kNumBuckets = kUpperBoundsUs.size() + 1;

  void Add(Duration duration) {
    counts_[BucketOf(duration)].Add();
    sum_ns_.Add(static_cast<uint64_t>(std::max<int64_t>(std::chrono::nanoseconds(duration).count(), 0)));
  }
  // Adds a duration that is also the exemplar of its bucket. Without a trace ID of 32 digits it is none.
  void Add(Duration duration, std::string_view trace_id) {
    Add(duration);
    SetExemplar(duration, trace_id);
  }
  // Sets the exemplar for a duration that was added before.
  void SetExemplar(Duration duration, std::string_view trace_id,
                   std::chrono::system_clock::time_point time = std::chrono::system_clock::now());

  struct Reading {
    std::array<uint64_t, kNumBuckets> counts = {};  // by bucket, not cumulative
    double sum_s = 0.0;
  };
  Reading Read() const;
  // The exemplars by bucket. A Reading that is taken afterwards counts their durations.
  std::array<std::optional<Exemplar>, kNumBuckets> ReadExemplars() const;

 private:
  static size_t BucketOf(Duration duration) {
    const auto bucket =
        std::lower_bound(kUpperBoundsUs.begin(), kUpperBoundsUs.end(), duration,
                         [](int64_t bound_us, Duration value) { return std::chrono::microseconds(bound_us) < value; });
    return static_cast<size_t>(bucket - kUpperBoundsUs.begin());
  }

  std::array<Counter, kNumBuckets> counts_;
  Counter sum_ns_;
  std::array<ExemplarSlot, kNumBuckets> exemplars_;
};

enum class StreamKind { kTrack, kWatch };

// The limits that a call can exceed (RESOURCE_EXHAUSTED).
enum class QuotaLimit {
  kMaxSessions,
  kMaxStreams,
  kMaxModelStoreBytes,
  kTenantSessions,
  kTenantModelBytes,
  kTenantWatchers,
  kSessionMemory,
  kTenantSessionMemory,
  kTenantStreams,
  kMaxUploads,
  kTenantUploads,
  kTenantResponses,
};

// Reasons for which a call was rejected with UNAUTHENTICATED, or an open stream ended with it.
enum class AuthenticationFailure { kNoToken, kBadToken, kBadCertificate };
// Limits for which a connection was closed when it was accepted.
enum class ConnectionRefusal { kMaxConnections, kMaxPerPeer, kDescriptors };

// Reasons for which the store has not accepted a checkpoint.
enum class CheckpointFailure { kStoreUnavailable, kStoreFull, kFenced, kStoreFailed, kRolledBack };

// The parts of a commit (SessionCommit).
enum class CommitPart { kCheckpoint, kPoses, kLifecycle };

// Sums over all sessions since the process started. Events and poses that are processed again after a restart or a move
// count again.
struct ServerMetrics {
  Counter received_bytes;  // bytes of chunks, without those that the session already had
  Counter decoded_events;
  OneFor<DropReason, 3> skipped_events;  // as SessionHealth::skipped_events
  Counter events_before_time;            // this one and the next three: as DecodeCounts
  Counter events_outside_sensor;
  Counter unknown_words;
  Counter broken_vectors;
  Counter poses;
  Counter track_losses;
  Counter reinitializations;  // objects that were found again after their track was lost
  OneFor<TrackPhase, kNumTrackPhases, OneFor<TrackPhase, kNumTrackPhases>> track_transitions;  // [from][to]
  OneFor<ObjectPhase, kNumObjectPhases, OneFor<ObjectPhase, kNumObjectPhases>> object_transitions;
  Counter reattaches;
  Counter falls_behind;  // times that a session began to fall behind its camera

  DurationHistogram turn_time;            // processor time of a session's turn on a worker
  DurationHistogram pose_latency;         // from a chunk's receipt to each of its poses
  DurationHistogram decode_time;          // time to decode a slice of a chunk
  DurationHistogram track_time;           // time to track a slice of a chunk, without initialization
  DurationHistogram initialization_time;  // time of a step with a search for poses
  Counter processing_ns;                  // time of workers for decoding and tracking
  Counter sensor_time_us;                 // processed sensor time

  DurationHistogram checkpoint_time;  // from the serialization until the checkpoint is durable
  OneFor<CheckpointFailure, 5> checkpoint_failures;
  OneFor<CommitPart, 3> commit_bytes;  // of the commits that are durable

  OneFor<StreamKind, 2, OneFor<absl::StatusCode, 17>> stream_ends;
  OneFor<QuotaLimit, 12> quota_refusals;
  OneFor<AuthenticationFailure, 3> authentication_failures;
  Counter quota_delays;  // times that a stream was paused because its tenant exceeded its byte rate

  Counter event_images;          // images of events that watchers have taken
  Counter skipped_event_images;  // images that were replaced by later ones, because a watcher was too slow

  OneFor<ConnectionRefusal, 3> connection_refusals;

  Counter turn_ns;            // the sum of turn_time
  Counter overload_refusals;  // sessions that were not created because of --max-load

  uint64_t all_skipped_events() const {
    return skipped_events[DropReason::kLag].value() + skipped_events[DropReason::kMemory].value() +
           skipped_events[DropReason::kReader].value();
  }
};

// The state of a server at one time, for gauges.
struct ServerState {
  SessionTotals sessions;
  uint32_t max_sessions = 0;
  uint32_t num_workers = 0;
  uint64_t session_memory_bytes = 0;  // charged for all sessions
  uint64_t max_session_memory_bytes = 0;
  std::optional<size_t> num_tokens;  // absent without a token file
  // Absent for a store that does not report it, before the first check, and without a limit.
  std::optional<uint64_t> store_bytes;
  std::optional<uint64_t> store_max_bytes;
  std::optional<double> store_cpu_s;     // absent unless the store is a process of its own that reports it
  uint64_t unreplicated_commits = 0;     // Store::unreplicated_commits()
  std::vector<StoreGroup> store_groups;  // Store::Groups()
  size_t connections = 0;
  absl::Status listening = absl::OkStatus();  // an error explains why the server accepts no connections
  absl::Status readiness;                     // an error explains why the server accepts no sessions
  // How much of the server is in use: the largest of the processor time of the workers per second and worker (averaged,
  // server/scheduling/load_monitor.h), and of the sessions and their memory relative to the limits.
  double load_ratio = 0.0;
  double process_cpu_s = 0.0;
  uint64_t process_resident_bytes = 0;
};

}  // namespace evpose::server

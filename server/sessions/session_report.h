// SPDX-License-Identifier: Apache-2.0

// Progress and health of a session, for readers, streams and checkpoints.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "server/runtime/latency_histogram.h"
#include "server/sessions/session_worker.h"
#include "server/sessions/types/session_state.h"
#include "server/sessions/types/stream_data.h"
#include "server/telemetry/metrics.h"

namespace evpose::server {

// Not thread-safe, without lock or clock.
class SessionReport {
 public:
  // Starts from the checkpoint and the member `restarted` of `beginning`. `objects` is the state of the objects of a
  // new session. `trace_id` is that of the session, for the exemplars of the metrics.
  SessionReport(const SessionBeginning& beginning, std::vector<ObjectHealth> objects, std::string trace_id = "");

  uint64_t poses() const { return health_.poses; }
  uint64_t processed_seq() const { return processed_seq_; }    // last item that has been processed
  uint64_t acked_pose_seq() const { return acked_pose_seq_; }  // last pose of the items up to processed_seq
  const SessionHealth& health() const { return health_; }      // without latencies and queue age
  const LatencyHistogram& latencies() const { return latencies_; }
  SessionHealth HealthWithLatencies() const;

  void AddReceived(uint64_t bytes) { health_.received_bytes += bytes; }
  void AddReattach() { ++health_.reattaches; }
  void AddLagChange(const LagChange& change) { notices_.push_back({health_.poses, change}); }

  // Adds the result of a slice, and counts the difference to the previous state in `metrics`. Notices are kept only for
  // an attached stream.
  void Add(const WorkResult& result, bool is_attached, ServerMetrics& metrics);

  // Returns the last pose number up to which the writer and the session have the same poses. After a restart of
  // tracking, higher numbers belong to other poses until a stream has received the notice of the restart.
  uint64_t LastValidPose(uint64_t last_pose_seq) const {
    return restarted_.has_value() ? std::min(last_pose_seq, restarted_->after_pose_seq) : last_pose_seq;
  }
  // A new stream receives only the notice that tracking was restarted, if no earlier stream has taken it.
  void StartNotices(uint64_t sent_pose_seq);
  void ClearNotices() { notices_.clear(); }
  std::vector<SessionNotice> TakeNotices();
  size_t num_notices() const { return notices_.size(); }

 private:
  void Count(const WorkResult& result, ServerMetrics& metrics) const;
  // Constructs the notice at its place: GCC 12 reports a moved temporary variant as uninitialized.
  template <typename What>
  void AddNotice(uint64_t after_pose_seq, What what);
  void AddNotices(const WorkResult& result);
  void AddTriggers(uint64_t pose_seq, const ChunkTriggers& triggers);

  const std::string trace_id_;
  SessionHealth health_;
  LatencyHistogram latencies_;
  uint64_t processed_seq_ = 0;
  uint64_t acked_pose_seq_ = 0;
  std::vector<SessionNotice> notices_;
  uint64_t untaken_triggers_ = 0;               // not passed on since the last notice of triggers
  std::optional<TrackingRestarted> restarted_;  // until a stream has taken the notice
};

}  // namespace evpose::server

// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/session_report.h"

#include <algorithm>
#include <chrono>
#include <utility>

#include "server/sessions/session_limits.h"

namespace evpose::server {
namespace {

// Returns the increase of a counter; 0 if the counter has been reset.
uint64_t Increase(uint64_t before, uint64_t now) { return now - std::min(before, now); }

}  // namespace

SessionReport::SessionReport(const SessionBeginning& beginning, std::vector<ObjectHealth> objects, std::string trace_id)
    : trace_id_(std::move(trace_id)),
      health_(beginning.checkpoint.health),
      latencies_(beginning.checkpoint.latencies),
      processed_seq_(beginning.checkpoint.processed_seq),
      restarted_(beginning.restarted) {
  if (health_.objects.empty()) health_.objects = std::move(objects);
  health_.received_bytes = health_.processed_bytes;
  health_.reattaches = NumReattaches(beginning.lifecycle);
  acked_pose_seq_ = health_.poses;
}

SessionHealth SessionReport::HealthWithLatencies() const { return WithLatencies(health_, latencies_); }

void SessionReport::Count(const WorkResult& result, ServerMetrics& metrics) const {
  const DecodeCounts& before = health_.counts;
  metrics.decoded_events.Add(Increase(before.cd_events, result.counts.cd_events));
  metrics.events_before_time.Add(Increase(before.dropped_before_time, result.counts.dropped_before_time));
  metrics.events_outside_sensor.Add(Increase(before.dropped_outside_sensor, result.counts.dropped_outside_sensor));
  metrics.unknown_words.Add(Increase(before.unknown_words, result.counts.unknown_words));
  metrics.broken_vectors.Add(Increase(before.broken_vectors, result.counts.broken_vectors));
  metrics.sensor_time_us.Add(
      Increase(static_cast<uint64_t>(health_.sensor_time_us), static_cast<uint64_t>(result.sensor_time_us)));
  metrics.poses.Add(result.poses.size());
  for (const StoredPose& pose : result.poses) metrics.pose_latency.Add(std::chrono::microseconds(pose.latency_us));
  // One exemplar is enough: the poses of a slice have the same latency.
  if (!result.poses.empty()) {
    metrics.pose_latency.SetExemplar(std::chrono::microseconds(result.poses.back().latency_us), trace_id_);
  }
  for (size_t i = 0; i < result.objects.size(); ++i) {
    metrics.track_losses.Add(Increase(health_.objects[i].losses, result.objects[i].losses));
  }
}

template <typename What>
void SessionReport::AddNotice(uint64_t after_pose_seq, What what) {
  SessionNotice& notice = notices_.emplace_back();
  notice.after_pose_seq = after_pose_seq;
  notice.what.emplace<What>(std::move(what));
}

void SessionReport::AddNotices(const WorkResult& result) {
  if (result.gap.has_value()) AddNotice(result.poses_before, *result.gap);
  for (const ObjectStateChange& change : result.state_changes) {
    AddNotice(result.poses_before + change.num_poses_before,
              StateChange{change.object_index, change.t_us, change.state});
  }
  if (!result.finished.has_value()) return;
  if (result.finished->fault.has_value()) AddNotice(result.last_pose_seq(), *result.finished->fault);
  if (result.finished->triggers.has_value()) AddTriggers(result.last_pose_seq(), *result.finished->triggers);
}

// When half of kMaxUntakenNotices wait for the stream, triggers are only counted: a stream that takes its notices
// slowly must not make the session wait, or drop events, sooner than it would without triggers.
void SessionReport::AddTriggers(uint64_t pose_seq, const ChunkTriggers& triggers) {
  if (notices_.size() >= kMaxUntakenNotices / 2) {
    untaken_triggers_ += triggers.triggers.size() + triggers.num_skipped;
    return;
  }
  ChunkTriggers added = triggers;
  added.num_skipped += std::exchange(untaken_triggers_, 0);
  AddNotice(pose_seq, std::move(added));
}

void SessionReport::Add(const WorkResult& result, bool is_attached, ServerMetrics& metrics) {
  Count(result, metrics);
  for (const StoredPose& pose : result.poses) latencies_.Add(pose.latency_us);
  health_.poses = result.last_pose_seq();
  health_.counts = result.counts;
  health_.t_us = result.t_us;
  health_.sensor_time_us = result.sensor_time_us;
  health_.processing_us = result.processing_us;
  health_.objects = result.objects;
  health_.skipped_events += result.dropped_now.num_events;
  health_.skipped_us += result.dropped_now.duration_us();
  if (is_attached) AddNotices(result);
  if (!result.finished.has_value()) return;
  health_.processed_bytes += result.finished->bytes;
  processed_seq_ = std::max(processed_seq_, result.finished->seq);
  acked_pose_seq_ = health_.poses;
}

void SessionReport::StartNotices(uint64_t sent_pose_seq) {
  notices_.clear();
  if (restarted_.has_value()) AddNotice(sent_pose_seq, *restarted_);
}

std::vector<SessionNotice> SessionReport::TakeNotices() {
  restarted_.reset();
  return std::exchange(notices_, {});
}

}  // namespace evpose::server

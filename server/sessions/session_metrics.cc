// SPDX-License-Identifier: Apache-2.0

// What a session counts and logs of its work, and what it adds to the totals of its server.
#include <algorithm>
#include <mutex>

#include "server/sessions/session.h"

namespace evpose::server {
namespace {

uint64_t Since(uint64_t before, uint64_t now) { return now - std::min(before, now); }

bool HasPose(TrackState state) { return state == TrackState::kTracking || state == TrackState::kDegraded; }

}  // namespace

int64_t Session::QueueAge_us() const {
  if (in_work_since_.has_value()) return MicrosecondsSince(*in_work_since_);
  return queue_.empty() ? 0 : MicrosecondsSince(queue_.front().received_at);
}

void Session::AddTo(SessionTotals& totals) const {
  const std::lock_guard lock(mutex_);
  if (!closed_.ok()) {
    ++totals.closed;
    return;
  }
  totals.queued_bytes += queued_bytes_;
  totals.oldest_queue_age_us = std::max(totals.oldest_queue_age_us, QueueAge_us());
  if (ended_) {
    ++totals.ended;
    return;
  }
  ++(is_attached_ ? totals.attached : totals.detached);
  for (const ObjectHealth& object : health_.objects) ++totals.objects[static_cast<size_t>(object.state)];
}

void Session::CountWork(const std::vector<StoredPose>& poses) {
  const DecodeCounts& counts = pipeline_->counts();
  const DecodeCounts& before = health_.counts;
  metrics_->decoded_events.Add(Since(before.cd_events, counts.cd_events));
  metrics_->events_before_time.Add(Since(before.dropped_before_time, counts.dropped_before_time));
  metrics_->events_outside_sensor.Add(Since(before.dropped_outside_sensor, counts.dropped_outside_sensor));
  metrics_->unknown_words.Add(Since(before.unknown_words, counts.unknown_words));
  metrics_->broken_vectors.Add(Since(before.broken_vectors, counts.broken_vectors));
  metrics_->sensor_time_us.Add(
      Since(static_cast<uint64_t>(health_.sensor_time_us), static_cast<uint64_t>(pipeline_->sensor_time_us())));
  metrics_->poses.Add(poses.size());
  for (const StoredPose& pose : poses) metrics_->pose_latency.Add(std::chrono::microseconds(pose.latency_us));
  const Tracker& tracker = pipeline_->tracker();
  for (size_t i = 0; i < health_.objects.size(); ++i) {
    metrics_->track_losses.Add(Since(health_.objects[i].losses, losses_before_[i] + tracker.losses(i)));
  }
  for (const ObjectStateChange& change : output_.state_changes) {
    const bool is_found = HasPose(change.state) && !HasPose(change.state_before);
    if (is_found && tracker.losses(change.object_index) > 0) metrics_->reinitializations.Add();
  }
}

void Session::ObservePipeline() {
  if (pipeline_ == nullptr) return;
  pipeline_->Measure({metrics_, [this] { return steady_now_(); }});
  pipeline_->SetPhaseListener([this](const PhaseTransition& transition) { OnTransition(transition); });
}

void Session::OnTransition(const PhaseTransition& transition) const {
  if (const auto* track = std::get_if<TrackTransition>(&transition.change)) {
    metrics_->track_transitions[track->from][track->to].Add();
  } else {
    const auto& object = std::get<ObjectTransition>(transition.change);
    metrics_->object_transitions[object.from][object.to].Add();
  }
  log_->PhaseChanged(config_.objects[transition.object_index].object_id, transition);
}

void Session::LogWork(bool item_is_done) const {
  for (const ObjectStateChange& change : output_.state_changes) {
    const std::string& object_id = config_.objects[change.object_index].object_id;
    if (change.state == TrackState::kLost) {
      log_->ObjectLost(object_id, change.t_us);
    } else if (HasPose(change.state) && !HasPose(change.state_before)) {
      log_->ObjectFound(object_id, change.t_us, pipeline_->tracker().losses(change.object_index) > 0);
    }
  }
  if (item_is_done && std::holds_alternative<End>(item_->what)) log_->Ended(next_pose_seq_ - 1);
}

}  // namespace evpose::server

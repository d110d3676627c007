// SPDX-License-Identifier: Apache-2.0

// Measures the durations of the stages of a session's pipeline for the metrics. No result of the pipeline depends on
// them.
#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <utility>

#include "core/tracking/tracker.h"
#include "server/telemetry/metrics.h"

namespace evpose::server {

// Not thread-safe.
class StageTimer {
 public:
  using Time = std::chrono::steady_clock::time_point;

  StageTimer() = default;  // runs the stages without measuring
  // `trace_id`: of the session, for the exemplars.
  StageTimer(std::shared_ptr<ServerMetrics> metrics, std::function<Time()> now, std::string trace_id = "")
      : metrics_(std::move(metrics)), now_(std::move(now)), trace_id_(std::move(trace_id)) {}

  template <typename Stage>
  void Decode(const Stage& stage) {
    if (metrics_ == nullptr) return stage();
    const Time begin = now_();
    stage();
    metrics_->decode_time.Add(now_() - begin, trace_id_);
  }

  // Runs a step of tracking. A step in which `tracker` searches for a pose is one sample of initialization_time; the
  // durations of the other steps are summed until EndTracking(), which adds the sum to track_time.
  template <typename Stage>
  void Track(const Tracker& tracker, const Stage& stage) {
    if (metrics_ == nullptr) return stage();
    const uint64_t searches = NumSearches(tracker);
    const Time begin = now_();
    stage();
    const auto duration = now_() - begin;
    if (NumSearches(tracker) == searches) {
      tracking_ += duration;
    } else {
      metrics_->initialization_time.Add(duration, trace_id_);
    }
  }
  void EndTracking() {
    if (metrics_ == nullptr) return;
    metrics_->track_time.Add(std::exchange(tracking_, {}), trace_id_);
  }

 private:
  static uint64_t NumSearches(const Tracker& tracker) {
    uint64_t searches = 0;
    for (size_t i = 0; i < tracker.num_objects(); ++i) searches += tracker.initialization(i).attempts;
    return searches;
  }

  std::shared_ptr<ServerMetrics> metrics_;
  std::function<Time()> now_;
  std::string trace_id_;
  std::chrono::steady_clock::duration tracking_{0};
};

}  // namespace evpose::server

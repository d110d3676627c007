// SPDX-License-Identifier: Apache-2.0
#include "core/calibration/tracked_recording.h"

#include <algorithm>
#include <cmath>
#include <deque>
#include <optional>
#include <utility>

#include "core/base/status_macros.h"
#include "core/recordings/event_reader.h"
#include "core/tracking/object/tracker_options.h"
#include "core/tracking/tracker.h"

namespace evpose {
namespace {

// Called for each piece of a recording with its events and the estimates that they complete.
using OnPiece = absl::FunctionRef<void(absl::Span<const Event>, absl::Span<const PoseEstimate>)>;

bool HasPose(const PoseEstimate& estimate) {
  return estimate.state == TrackState::kTracking || estimate.state == TrackState::kDegraded;
}

absl::Status TrackPieces(RecordingReader& recording, std::shared_ptr<const ObjectModel> model,
                         const CameraModel& camera, const TrackedRecordingOptions& options,
                         RecordingProgress on_progress, OnPiece on_piece) {
  EVPOSE_ASSIGN_OR_RETURN(EventReader events, EventReader::Make(recording));
  TrackerOptions tracker_options;
  tracker_options.sensor = options.sensor;
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Tracker> tracker,
                          Tracker::Create(std::move(model), camera, tracker_options, std::nullopt));
  std::optional<int64_t> first_us, found_us;
  std::vector<PoseEstimate> estimates;
  while (true) {
    EVPOSE_ASSIGN_OR_RETURN(const bool has_piece, events.Next());
    if (!has_piece) break;
    const auto& piece = events.decoded().events;
    if (piece.empty()) continue;
    if (!first_us) first_us = piece.front().t_us;
    estimates.clear();
    tracker->AddEvents(piece, estimates);
    on_piece(piece, estimates);
    const int64_t elapsed_us = piece.back().t_us - *first_us;
    on_progress(1e-6 * static_cast<double>(elapsed_us));
    if (!found_us && std::any_of(estimates.begin(), estimates.end(), HasPose)) found_us = elapsed_us;
    if (elapsed_us >= options.max_duration_us) break;
    if (found_us && elapsed_us - *found_us >= options.max_tracked_us) break;
  }
  estimates.clear();
  tracker->Finish(estimates);
  on_piece({}, estimates);
  return absl::OkStatus();
}

// Cuts intervals out of the stream of events.
class IntervalCollector {
 public:
  IntervalCollector(int recording, const ObjectModel& model, const CameraModel& camera,
                    const TrackedRecordingOptions& options)
      : recording_(recording), options_(options), camera_(camera) {
    for (const ModelLine& line : model.lines) points_.push_back(0.5 * (line.p1 + line.p2));
  }

  void Add(absl::Span<const Event> events, absl::Span<const PoseEstimate> estimates) {
    recent_.insert(recent_.end(), events.begin(), events.end());
    for (const PoseEstimate& estimate : estimates) Consider(estimate);
    const int64_t now_us = recent_.empty() ? 0 : recent_.back().t_us;
    while (!pending_.empty() && (pending_.front().end_us <= now_us || events.empty())) {
      Extract(pending_.front());
      pending_.pop_front();
    }
    // An estimate is of a window of at most 20 ms, and an interval as long.
    constexpr int64_t kMemoryUs = 60'000;
    int64_t keep_us = now_us - kMemoryUs;
    if (!pending_.empty()) keep_us = std::min(keep_us, pending_.front().begin_us);
    // All old events, not only the first ones: an event with a time in the future may stay before them.
    std::erase_if(recent_, [keep_us](const Event& event) { return event.t_us < keep_us; });
  }
  std::vector<CalibrationInterval> Finish() {
    const auto is_degraded = [](const CalibrationInterval& interval) { return interval.is_degraded; };
    const auto degraded = static_cast<size_t>(std::count_if(intervals_.begin(), intervals_.end(), is_degraded));
    if (2 * degraded <= intervals_.size()) std::erase_if(intervals_, is_degraded);
    return std::move(intervals_);
  }

 private:
  struct Pending {
    int64_t begin_us = 0;
    int64_t end_us = 0;
    CalibrationInterval interval;
  };

  // Mean speed of the middles of the lines in the image, px/s.
  double SpeedPxPerS(const PoseEstimate& estimate) const {
    const double depth_m = std::max(estimate.camera_from_object.translation_m.z(), 1e-6);
    double sum = 0.0;
    for (const Eigen::Vector3d& point : points_) {
      const Eigen::Vector3d arm = estimate.camera_from_object.rotation * point;
      const Eigen::Vector3d velocity = estimate.twist.head<3>() + Eigen::Vector3d(estimate.twist.tail<3>()).cross(arm);
      sum += velocity.head<2>().norm();
    }
    return sum / std::max<double>(1.0, static_cast<double>(points_.size())) * camera_.MaxFocalPx() / depth_m;
  }

  void Consider(const PoseEstimate& estimate) {
    if (!HasPose(estimate) || estimate.t_us < next_us_) return;
    // Slow motion is seen for a window's length; below a quarter of the motion, the events cover too few positions
    // between two pixels.
    constexpr double kMinUs = 500.0, kMaxUs = 20'000.0, kMinMotion = 0.25;
    const double length_us = 1e6 * options_.motion_px / std::max(SpeedPxPerS(estimate), 1e-9);
    if (kMinMotion * length_us > kMaxUs) return;
    const auto half_us = static_cast<int64_t>(0.5 * std::clamp(length_us, kMinUs, kMaxUs));
    Pending pending;
    pending.begin_us = estimate.t_us - half_us;
    pending.end_us = estimate.t_us + half_us;
    pending.interval.recording = recording_;
    pending.interval.t_us = estimate.t_us;
    pending.interval.duration_us = 2 * half_us;
    pending.interval.camera_from_object = estimate.camera_from_object;
    pending.interval.twist = estimate.twist;
    pending.interval.is_degraded = estimate.state == TrackState::kDegraded;
    pending_.push_back(std::move(pending));
    next_us_ = estimate.t_us + std::max(spacing_us_, 2 * half_us);
  }

  void Extract(Pending& pending) {
    // Bounds the memory at any rate of events: 300 intervals of as many take 144 MB.
    constexpr size_t kMaxEvents = 30'000;
    std::vector<Event>& events = pending.interval.events;
    for (const Event& event : recent_) {
      if (event.t_us >= pending.begin_us && event.t_us < pending.end_us) events.push_back(event);
    }
    if (events.size() > kMaxEvents) {
      const size_t step = events.size() / kMaxEvents + 1;
      size_t kept = 0;
      for (size_t i = 0; i < events.size(); i += step) events[kept++] = events[i];
      events.resize(kept);
    }
    intervals_.push_back(std::move(pending.interval));
    if (static_cast<int>(intervals_.size()) <= options_.max_intervals) return;
    for (size_t i = 1; 2 * i < intervals_.size(); ++i) intervals_[i] = std::move(intervals_[2 * i]);
    intervals_.resize((intervals_.size() + 1) / 2);
    spacing_us_ = std::max(2 * spacing_us_, kMinSpacingWhenFullUs);
  }

  // A recording that fills the list at first gives one interval for each 20 ms afterwards.
  static constexpr int64_t kMinSpacingWhenFullUs = 20'000;

  const int recording_;
  const TrackedRecordingOptions options_;
  const CameraModel camera_;
  std::vector<Eigen::Vector3d> points_;
  std::vector<Event> recent_;
  std::deque<Pending> pending_;
  std::vector<CalibrationInterval> intervals_;
  int64_t spacing_us_ = 1'000;
  int64_t next_us_ = std::numeric_limits<int64_t>::min();
};

}  // namespace

absl::StatusOr<Trajectory> TrackRecording(RecordingReader& recording, std::shared_ptr<const ObjectModel> model,
                                          const CameraModel& camera, const TrackedRecordingOptions& options,
                                          RecordingProgress on_progress) {
  Trajectory trajectory;
  const auto keep = [&](absl::Span<const Event>, absl::Span<const PoseEstimate> estimates) {
    for (const PoseEstimate& estimate : estimates) {
      if (estimate.state != TrackState::kTracking) continue;
      if (!trajectory.empty() && estimate.t_us <= trajectory.back().t_us) continue;
      trajectory.push_back({estimate.t_us, estimate.camera_from_object});
    }
  };
  EVPOSE_RETURN_IF_ERROR(TrackPieces(recording, std::move(model), camera, options, on_progress, keep));
  return trajectory;
}

absl::StatusOr<std::vector<CalibrationInterval>> CollectIntervals(RecordingReader& recording, int index,
                                                                  std::shared_ptr<const ObjectModel> model,
                                                                  const CameraModel& camera,
                                                                  const TrackedRecordingOptions& options,
                                                                  RecordingProgress on_progress) {
  IntervalCollector collector(index, *model, camera, options);
  const auto add = [&](absl::Span<const Event> events, absl::Span<const PoseEstimate> estimates) {
    collector.Add(events, estimates);
  };
  EVPOSE_RETURN_IF_ERROR(TrackPieces(recording, std::move(model), camera, options, on_progress, add));
  return collector.Finish();
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/real_bench.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/check_range.h"
#include "core/base/find_named.h"
#include "core/base/status_macros.h"
#include "core/events/events_between.h"
#include "core/experiments/speed/measured_time.h"
#include "core/numerics/statistics.h"
#include "core/tracking/tracker.h"

namespace evpose {
namespace {

// Share of a recording over which the starts are spread.
constexpr double kStartsShare = 0.75;
// Sensor time of the events in one call of the tracker, microseconds: the resolution of the time to the first pose.
constexpr int64_t kStepUs = 1000;

using Events = absl::Span<const Event>;

// `ratio`: of the number of starts that precede this one.
int64_t StartUs(int64_t begin_us, int64_t end_us, double ratio) {
  return begin_us + std::llround(kStartsShare * ratio * static_cast<double>(end_us - begin_us));
}

// Tracks an object in `events`, and sets the times and the losses of `run`. Returns the poses; nullopt if `goes_on`,
// which is called with the finished share, returns false.
absl::StatusOr<std::optional<std::vector<PoseEstimate>>> Track(const RealObject& object, const CameraModel& camera,
                                                               const TrackerOptions& options,
                                                               const std::optional<RigidTransform>& pose, Events events,
                                                               const std::function<bool(double)>& goes_on,
                                                               RealRun& run) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Tracker> tracker, Tracker::Create(object.model, camera, options, pose));
  std::vector<PoseEstimate> poses;
  const auto check_found = [&](size_t first_new, int64_t now_us) {
    if (run.is_found()) return;
    const auto is_tracking = [](const PoseEstimate& estimate) { return estimate.state == TrackState::kTracking; };
    if (std::none_of(poses.begin() + static_cast<std::ptrdiff_t>(first_new), poses.end(), is_tracking)) return;
    run.wait_s = 1e-6 * static_cast<double>(now_us - run.start_us);
    run.compute_to_tracking_s = run.compute_s;
  };
  for (size_t i = 0; i < events.size();) {
    const size_t count =
        std::max<size_t>(1, EventsBetween(events.subspan(i), run.start_us, events[i].t_us + kStepUs).size());
    const size_t num_poses = poses.size();
    run.compute_s += ProcessorSecondsOf([&] { tracker->AddEvents(events.subspan(i, count), poses); });
    i += count;
    check_found(num_poses, events[i - 1].t_us);
    if (!goes_on(static_cast<double>(i) / static_cast<double>(events.size()))) return std::nullopt;
  }
  const size_t num_poses = poses.size();
  run.compute_s += ProcessorSecondsOf([&] { tracker->Finish(poses); });
  if (!events.empty()) check_found(num_poses, events.back().t_us);
  run.losses = tracker->losses();
  return poses;
}

// Runs the benchmark over the recordings of a directory.
class RealBench {
 public:
  RealBench(const RealBenchOptions& options, const RealBenchListener& listener, const RealDirectory& directory,
            const std::vector<RealRecording>& recordings)
      : options_(options), listener_(listener), directory_(directory), recordings_(recordings) {
    for (const RealRecording& recording : recordings) {
      if (recording.object >= 0 && options.has_starts) ++num_tasks_;
      for (size_t i = 0; options.has_foreign && i < directory.objects.size(); ++i) {
        if (IsForeign(recording, i)) ++num_tasks_;
      }
    }
  }

  absl::Status Run() {
    for (const RealRecording& recording : recordings_) {
      if (recording.object < 0 || !options_.has_starts) continue;
      EVPOSE_ASSIGN_OR_RETURN(const RealBenchRow row, RunStarts(recording));
      if (listener_.on_row) listener_.on_row(row);
    }
    for (const RealRecording& recording : recordings_) {
      if (!options_.has_foreign) break;
      EVPOSE_RETURN_IF_ERROR(RunForeign(recording));
    }
    return absl::OkStatus();
  }

 private:
  bool IsForeign(const RealRecording& recording, size_t object) const {
    const CameraModel& camera = directory_.objects[object].camera;
    return recording.object != static_cast<int>(object) && recording.geometry.width_px == camera.width_px &&
           recording.geometry.height_px == camera.height_px;
  }

  bool Report(double ratio) const {
    const double done = (static_cast<double>(task_) + ratio) / static_cast<double>(std::max<size_t>(1, num_tasks_));
    return !listener_.on_progress || listener_.on_progress(std::min(done, 1.0), text_);
  }

  absl::StatusOr<RealBenchRow> RunStarts(const RealRecording& recording) {
    EVPOSE_ASSIGN_OR_RETURN(const std::vector<Event> events, ReadRealEvents(recording));
    const int64_t begin_us = std::max(events.front().t_us, recording.reference.front().t_us);
    const int64_t end_us = std::min(events.back().t_us, recording.reference.back().t_us);
    if (begin_us >= end_us) {
      return absl::InvalidArgumentError(absl::StrFormat(
          "%s has events from %.6f to %.6f s, but its reference has poses from %.6f to %.6f s", recording.events_path,
          1e-6 * static_cast<double>(events.front().t_us), 1e-6 * static_cast<double>(events.back().t_us),
          1e-6 * static_cast<double>(recording.reference.front().t_us),
          1e-6 * static_cast<double>(recording.reference.back().t_us)));
    }
    RealBenchRow row;
    row.recording = recording.name;
    for (int i = 0; i < options_.num_starts; ++i) {
      const int64_t start_us = StartUs(begin_us, end_us, static_cast<double>(i) / options_.num_starts);
      const int64_t stop_us =
          options_.max_duration_us > 0 ? std::min(end_us, start_us + options_.max_duration_us) : end_us;
      for (const bool is_given : {false, true}) {
        text_ = absl::StrFormat("%s, start %d of %d%s", recording.name, i + 1, options_.num_starts,
                                is_given ? ", from the reference pose" : "");
        const double done = (i + 0.5 * (is_given ? 1 : 0)) / options_.num_starts;
        EVPOSE_ASSIGN_OR_RETURN(
            RealRun run, RunOnce(recording, EventsBetween(events, start_us, stop_us), start_us, stop_us, is_given,
                                 [&](double ratio) { return Report(done + 0.5 * ratio / options_.num_starts); }));
        (is_given ? row.given : row.searched).push_back(run);
      }
    }
    ++task_;
    return row;
  }

  absl::StatusOr<RealRun> RunOnce(const RealRecording& recording, Events events, int64_t start_us, int64_t stop_us,
                                  bool is_given, const std::function<bool(double)>& goes_on) const {
    const RealObject& object = directory_.objects[recording.object];
    RealRun run;
    run.start_us = start_us;
    run.duration_s = 1e-6 * static_cast<double>(stop_us - start_us);
    std::optional<RigidTransform> pose;
    if (is_given && !events.empty()) {
      EVPOSE_ASSIGN_OR_RETURN(pose, Interpolate(recording.reference, events.front().t_us));
    }
    EVPOSE_ASSIGN_OR_RETURN(const auto poses,
                            Track(object, recording.camera, options_.tracker, pose, events, goes_on, run));
    if (!poses) return absl::CancelledError("interrupted");
    const ReprojectionError error(*object.model, recording.camera);
    ScoreRealPoses(*poses, &recording.reference, &error, options_.bound_px, run);
    return run;
  }

  absl::StatusOr<ForeignBenchRow> SearchForeign(const RealRecording& recording, const RealObject& object, Events events,
                                                int start) {
    const double share = 1.0 / options_.num_absent_starts;
    ForeignBenchRow row = {recording.name, object.name, {}};
    row.run.start_us = StartUs(events.front().t_us, events.back().t_us, start * share);
    row.run.duration_s = 1e-6 * static_cast<double>(events.back().t_us - row.run.start_us);
    text_ =
        absl::StrFormat("%s in %s, start %d of %d", object.name, recording.name, start + 1, options_.num_absent_starts);
    const auto report = [&](double ratio) { return Report((start + ratio) * share); };
    EVPOSE_ASSIGN_OR_RETURN(
        const auto poses,
        Track(object, recording.object < 0 ? object.camera : recording.camera, options_.tracker, std::nullopt,
              EventsBetween(events, row.run.start_us, events.back().t_us + 1), report, row.run));
    if (!poses) return absl::CancelledError("interrupted");
    ScoreRealPoses(*poses, nullptr, nullptr, options_.bound_px, row.run);
    return row;
  }

  absl::Status RunForeign(const RealRecording& recording) {
    std::vector<Event> events;
    for (size_t i = 0; i < directory_.objects.size(); ++i) {
      if (!IsForeign(recording, i)) continue;
      const RealObject& object = directory_.objects[i];
      if (events.empty()) {
        EVPOSE_ASSIGN_OR_RETURN(events, ReadRealEvents(recording));
      }
      for (int start = 0; start < options_.num_absent_starts; ++start) {
        EVPOSE_ASSIGN_OR_RETURN(const ForeignBenchRow row, SearchForeign(recording, object, events, start));
        if (listener_.on_foreign) listener_.on_foreign(row);
      }
      ++task_;
    }
    return absl::OkStatus();
  }

  const RealBenchOptions& options_;
  const RealBenchListener& listener_;
  const RealDirectory& directory_;
  const std::vector<RealRecording>& recordings_;
  size_t num_tasks_ = 0;
  size_t task_ = 0;  // index of the present one
  std::string text_;
};

// The value at a share of the sorted values that are numbers; NaN without any.
double QuantileOf(const std::vector<RealRun>& runs, double RealRun::*member, double share) {
  std::vector<double> values;
  for (const RealRun& run : runs) {
    if (!std::isnan(run.*member)) values.push_back(run.*member);
  }
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  std::sort(values.begin(), values.end());
  return InterpolatedQuantile(values, share);
}

}  // namespace

absl::Status RealBenchOptions::Validate() const {
  if (directory.empty()) return absl::InvalidArgumentError("RealBenchOptions.directory must not be empty");
  EVPOSE_RETURN_IF_ERROR(CheckRange("RealBenchOptions.num_starts", num_starts, 1, 1000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("RealBenchOptions.num_absent_starts", num_absent_starts, 1, 1000));
  EVPOSE_RETURN_IF_ERROR(
      CheckRange("RealBenchOptions.max_duration_us", static_cast<double>(max_duration_us), 0.0, 3.6e9));
  EVPOSE_RETURN_IF_ERROR(CheckRange("RealBenchOptions.bound_px", bound_px, 0.01, 1000.0));
  if (!has_starts && !has_foreign) {
    return absl::InvalidArgumentError("RealBenchOptions.has_starts or has_foreign must be true: else nothing is run");
  }
  return tracker.Validate();
}

RealSummary SummariseRealRuns(const std::vector<RealRun>& runs) {
  RealSummary summary;
  double compute_s = 0.0, duration_s = 0.0;
  for (const RealRun& run : runs) {
    summary.num_found += run.is_found() ? 1 : 0;
    summary.longest_wrong_s = std::max(summary.longest_wrong_s, run.longest_wrong_s);
    summary.right_ratio += run.right_ratio / static_cast<double>(runs.size());
    summary.doubtful_ratio += run.doubtful_ratio / static_cast<double>(runs.size());
    summary.ambiguous_ratio += run.ambiguous_ratio / static_cast<double>(runs.size());
    summary.losses += run.losses;
    summary.num_wrong += run.is_first_wrong ? 1 : 0;
    compute_s += run.compute_s;
    duration_s += run.duration_s;
  }
  summary.compute_ratio = duration_s > 0.0 ? compute_s / duration_s : std::numeric_limits<double>::quiet_NaN();
  summary.median_wait_s = QuantileOf(runs, &RealRun::wait_s, 0.5);
  summary.worst_wait_s = QuantileOf(runs, &RealRun::wait_s, 1.0);
  summary.median_compute_s = QuantileOf(runs, &RealRun::compute_to_tracking_s, 0.5);
  summary.median_error_px = QuantileOf(runs, &RealRun::median_error_px, 0.5);
  summary.p95_error_px = QuantileOf(runs, &RealRun::p95_error_px, 1.0);
  return summary;
}

absl::Status RunRealBench(const RealBenchOptions& options, const RealBenchListener& listener) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_ASSIGN_OR_RETURN(const RealDirectory directory, ReadRealDirectory(options.directory));
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<RealRecording> recordings,
                          FindAllNamed(directory.recordings, options.names, "no recording is called \"$0\""));
  return RealBench(options, listener, directory, recordings).Run();
}

}  // namespace evpose

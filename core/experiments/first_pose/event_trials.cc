// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/first_pose/event_trials.h"

#include <algorithm>
#include <limits>
#include <memory>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/baselines/first_pose/lsd_detector.h"
#include "core/events/events_between.h"
#include "core/experiments/first_pose/pose_comparison.h"
#include "core/experiments/tracking/wrong_time.h"
#include "core/geometry/trajectory.h"
#include "core/models/visibility.h"
#include "core/numerics/random.h"
#include "core/numerics/statistics.h"
#include "core/simulation/simulator.h"
#include "core/tracking/tracker.h"

namespace evpose {
namespace {

// Microseconds of events in which a first pose counts as found in time: 50 ms, as in core/experiments/RESULTS.md,
// The first pose.
constexpr int64_t kBudgetUs = 50'000;
constexpr int64_t kStepUs = 1000;  // microseconds of events per call
// Share of the progress for the simulation, which takes longer than the starts.
constexpr double kSimulationShare = 0.6;

absl::StatusOr<SimulationOptions> MakeScene(const EventTrialOptions& options, int64_t duration_us, uint64_t seed) {
  EVPOSE_ASSIGN_OR_RETURN(SimulationOptions scene,
                          SimulationPreset(SimulatedObjectName(options.object), options.camera, options.speed_scale));
  scene.duration_us = duration_us;
  scene.sensor.noise_ratio = options.noise_ratio;
  scene.seed = seed;
  scene.t_begin_us = 0;
  EVPOSE_RETURN_IF_ERROR(scene.Validate());
  return scene;
}

// Reports `ratio` of the part of the progress from `begin` to `end`. Error: CANCELLED.
absl::Status Report(const TrialProgress& on_progress, double begin, double end, double ratio) {
  if (!on_progress || on_progress(begin + (end - begin) * ratio)) return absl::OkStatus();
  return absl::CancelledError("interrupted");
}

// Errors: INVALID_ARGUMENT for an unknown name.
absl::StatusOr<LineDetectorFactory> FindLineDetector(const std::string& name) {
  if (name == "planes") return LineDetectorFactory();
  if (name == "lsd") {
    return LineDetectorFactory([](SensorGeometry geometry) { return MakeLsdLineDetector({}, geometry); });
  }
  return absl::InvalidArgumentError(absl::StrCat("EventTrialOptions.detector is \"", name, "\"; known are ",
                                                 absl::StrJoin(LineDetectorNames(), ", ")));
}

// Simulated events and the truth. Not movable: the visibility tester keeps a reference to the model.
class Recording {
 public:
  static absl::StatusOr<std::unique_ptr<Recording>> Make(const SimulationOptions& scene,
                                                         const std::function<absl::Status(double)>& on_progress) {
    EVPOSE_ASSIGN_OR_RETURN(ObjectModel model, SimulatedModel(scene));
    auto recording = std::make_unique<Recording>(scene, std::move(model));
    const auto keep = [&](absl::Span<const Event> events) -> absl::Status {
      recording->events_.insert(recording->events_.end(), events.begin(), events.end());
      if (events.empty()) return absl::OkStatus();
      return on_progress(static_cast<double>(events.back().t_us) / static_cast<double>(scene.duration_us));
    };
    EVPOSE_RETURN_IF_ERROR(Simulate(scene, keep).status());
    return recording;
  }

  Recording(const SimulationOptions& scene, ObjectModel model)
      : camera_(scene.camera),
        truth_(SimulatedTruth(scene)),
        model_(std::make_shared<const ObjectModel>(std::move(model))),
        visibility_(*model_, {.grazing_cosine = 0.0}) {}  // faces that are turned away are invisible

  absl::Span<const Event> events() const { return events_; }
  const CameraModel& camera() const { return camera_; }
  const std::shared_ptr<const ObjectModel>& model() const { return model_; }

  absl::Span<const Event> Between(int64_t begin_us, int64_t end_us) const {
    return EventsBetween(events_, begin_us, end_us);
  }

  // Returns whether the estimate is right; false for times outside the recording.
  bool IsRight(int64_t t_us, const RigidTransform& estimate) const {
    const absl::StatusOr<RigidTransform> truth = Interpolate(truth_, t_us);
    return truth.ok() && ComparePoses(*model_, camera_, {}, *truth, estimate).is_right();
  }
  double ReprojectionPx(int64_t t_us, const RigidTransform& estimate) const {
    const absl::StatusOr<RigidTransform> truth = Interpolate(truth_, t_us);
    if (!truth.ok()) return std::numeric_limits<double>::quiet_NaN();
    const std::vector<VisibleSegment> visible = visibility_.VisibleSegments(camera_, *truth);
    return ComparePoses(*model_, camera_, visible, *truth, estimate).reprojection_px;
  }

 private:
  std::vector<Event> events_;
  const CameraModel camera_;
  const Trajectory truth_;
  const std::shared_ptr<const ObjectModel> model_;
  const VisibilityTester visibility_;
};

// Passes the events of [begin_us, end_us), delayed by `delay_us`, to the tracker in steps. Calls `on_pose` with the end
// of the step, each TRACKING pose of these events, and whether it is right. Returns the longest time with wrong ones
// (WrongTime).
int64_t Follow(const Recording& recording, int64_t begin_us, int64_t end_us, int64_t delay_us, Tracker& tracker,
               const std::function<void(int64_t, const PoseEstimate&, bool)>& on_pose) {
  WrongTime wrong;
  for (int64_t t_us = begin_us; t_us < end_us; t_us += kStepUs) {
    const absl::Span<const Event> step = recording.Between(t_us, t_us + kStepUs);
    std::vector<Event> events(step.begin(), step.end());
    for (Event& event : events) event.t_us += delay_us;
    std::vector<PoseEstimate> estimates;
    tracker.AddEvents(events, estimates);
    for (const PoseEstimate& estimate : estimates) {
      if (estimate.t_us < delay_us) continue;
      const bool is_tracking = estimate.state == TrackState::kTracking;
      const bool is_right = recording.IsRight(estimate.t_us - delay_us, estimate.camera_from_object);
      wrong.Add(estimate.t_us, is_tracking && !is_right);
      if (!is_tracking) continue;
      on_pose(t_us + kStepUs, estimate, is_right);
    }
  }
  wrong.Finish(end_us + delay_us);
  return wrong.longest_us();
}

absl::StatusOr<std::unique_ptr<Tracker>> MakeTracker(const EventTrialOptions& options, const Recording& recording) {
  TrackerOptions tracker = options.tracker;
  EVPOSE_ASSIGN_OR_RETURN(tracker.initialization.detector_factory, FindLineDetector(options.detector));
  return Tracker::Create(recording.model(), recording.camera(), tracker, std::nullopt);
}

absl::StatusOr<EventTrial> RunTrial(const Recording& recording, const EventTrialOptions& options, int64_t start_us) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Tracker> tracker, MakeTracker(options, recording));
  EventTrial trial;
  trial.t_start_us = start_us;
  const auto on_pose = [&](int64_t t_us, const PoseEstimate& estimate, bool is_right) {
    if (trial.t_first_pose_us >= 0) return;
    trial.t_first_pose_us = t_us - start_us;
    trial.is_first_right = is_right;
    trial.reprojection_px = recording.ReprojectionPx(estimate.t_us, estimate.camera_from_object);
  };
  trial.wrong_us = Follow(recording, start_us, start_us + options.watch_us, /*delay_us=*/0, *tracker, on_pose);
  trial.attempts = tracker->initialization().attempts;
  return trial;
}

// Noise at the rate of that of the recording, uniform over the sensor.
std::vector<Event> MakeNoise(const Recording& recording, double noise_ratio, int64_t begin_us, int64_t duration_us,
                             uint64_t seed) {
  Random random(seed);
  std::vector<Event> noise;
  const double noise_hz = noise_ratio * static_cast<double>(recording.events().size()) / (begin_us * 1e-6);
  if (!(noise_hz > 0.0)) return noise;
  for (double t_s = random.Exponential(noise_hz); t_s * 1e6 < duration_us; t_s += random.Exponential(noise_hz)) {
    noise.push_back({begin_us + static_cast<int64_t>(t_s * 1e6),
                     static_cast<uint16_t>(random.UniformInt(recording.camera().width_px)),
                     static_cast<uint16_t>(random.UniformInt(recording.camera().height_px)),
                     static_cast<uint8_t>(random.UniformInt(2))});
  }
  return noise;
}

}  // namespace

std::vector<std::string> LineDetectorNames() { return {"planes", "lsd"}; }

bool EventTrial::is_right_in_time() const { return is_first_right && t_first_pose_us <= kBudgetUs; }

absl::Status EventTrialOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("EventTrialOptions.num_starts", num_starts, 1, 1'000'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("EventTrialOptions.noise_ratio", noise_ratio, 0.0, 0.9));
  if (watch_us < kStepUs || recording_us < watch_us) {
    return absl::InvalidArgumentError(absl::StrCat("EventTrialOptions.watch_us (", watch_us, ") must be at least ",
                                                   kStepUs, " and at most recording_us (", recording_us, ")"));
  }
  EVPOSE_RETURN_IF_ERROR(MakeScene(*this, recording_us, seed).status());
  EVPOSE_RETURN_IF_ERROR(FindLineDetector(detector).status());
  return tracker.Validate();
}

absl::StatusOr<std::vector<EventTrial>> RunEventTrials(const EventTrialOptions& options,
                                                       const TrialProgress& on_progress) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_ASSIGN_OR_RETURN(const SimulationOptions scene, MakeScene(options, options.recording_us, options.seed));
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Recording> recording, Recording::Make(scene, [&](double ratio) {
                            return Report(on_progress, 0.0, kSimulationShare, ratio);
                          }));
  Random random(options.seed);
  std::vector<EventTrial> trials;
  for (int i = 0; i < options.num_starts; ++i) {
    const int64_t latest_us = options.recording_us - options.watch_us;
    const int64_t start_us = static_cast<int64_t>(random.Uniform(0.0, static_cast<double>(latest_us)));
    EVPOSE_ASSIGN_OR_RETURN(const EventTrial trial, RunTrial(*recording, options, start_us));
    trials.push_back(trial);
    EVPOSE_RETURN_IF_ERROR(Report(on_progress, kSimulationShare, 1.0, (i + 1.0) / options.num_starts));
  }
  return trials;
}

EventTrialSummary Summarize(absl::Span<const EventTrial> trials) {
  EventTrialSummary summary;
  std::vector<int64_t> times_us;
  int num_first_right = 0;
  double sum_px = 0.0;
  for (const EventTrial& trial : trials) {
    ++summary.num_starts;
    summary.longest_wrong_us = std::max(summary.longest_wrong_us, trial.wrong_us);
    summary.num_right += trial.is_right_in_time();
    if (trial.t_first_pose_us < 0) {
      ++summary.num_none;
      continue;
    }
    times_us.push_back(trial.t_first_pose_us);
    summary.num_wrong += !trial.is_first_right;
    if (!trial.is_first_right) continue;
    ++num_first_right;
    sum_px += trial.reprojection_px;
  }
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  summary.reprojection_mean_px = num_first_right > 0 ? sum_px / num_first_right : kNone;
  summary.first_pose_median_ms = times_us.empty() ? kNone : static_cast<double>(UpperMedian(times_us)) * 1e-3;
  return summary;
}

absl::StatusOr<ReturnTrial> RunReturnTrial(const EventTrialOptions& options, int64_t absence_us,
                                           const TrialProgress& on_progress) {
  // Microseconds of events before the absence, in which the object is found, nearly always within 50 ms, and tracked.
  constexpr int64_t kBeforeUs = 500'000;
  constexpr uint64_t kElsewhere = 1000;  // offset of the seed, for another motion
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  if (absence_us < 0) return absl::InvalidArgumentError(absl::StrCat("absence_us is negative: ", absence_us));
  EVPOSE_ASSIGN_OR_RETURN(const SimulationOptions first, MakeScene(options, kBeforeUs, options.seed));
  EVPOSE_ASSIGN_OR_RETURN(const SimulationOptions second,
                          MakeScene(options, options.watch_us, options.seed + kElsewhere));
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Recording> before,
                          Recording::Make(first, [&](double ratio) { return Report(on_progress, 0.0, 0.5, ratio); }));
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Recording> after,
                          Recording::Make(second, [&](double ratio) { return Report(on_progress, 0.5, 0.8, ratio); }));
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Tracker> tracker, MakeTracker(options, *before));
  ReturnTrial trial;
  trial.seed = options.seed;
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(before->events(), estimates);
  trial.was_tracked = !estimates.empty() && estimates.back().state == TrackState::kTracking &&
                      before->IsRight(estimates.back().t_us, estimates.back().camera_from_object);
  estimates.clear();
  tracker->AddEvents(MakeNoise(*before, options.noise_ratio, kBeforeUs, absence_us, options.seed), estimates);
  for (const PoseEstimate& estimate : estimates) {
    if (estimate.state == TrackState::kTracking) trial.lingering_us = std::max<int64_t>(0, estimate.t_us - kBeforeUs);
  }
  const auto on_pose = [&](int64_t t_us, const PoseEstimate&, bool is_right) {
    if (is_right && trial.tracked_us < 0) trial.tracked_us = t_us;
  };
  trial.wrong_us = Follow(*after, 0, options.watch_us, kBeforeUs + absence_us, *tracker, on_pose);
  EVPOSE_RETURN_IF_ERROR(Report(on_progress, 0.8, 1.0, 1.0));
  return trial;
}

}  // namespace evpose

#include "core/experiments/event_trials.h"

#include <algorithm>
#include <memory>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/random.h"
#include "core/base/status_macros.h"
#include "core/geometry/trajectory.h"
#include "core/models/symmetry.h"
#include "core/models/visibility.h"
#include "core/tracking/tracker.h"

namespace evpose {
namespace {

constexpr double kRightRad = 2.0 * 3.14159265358979323846 / 180.0;
constexpr double kRightDepthRatio = 0.02;
constexpr int64_t kBudgetUs = 50'000;

struct Recording {
  std::vector<Event> events;
  Trajectory truth;
  std::shared_ptr<const ObjectModel> model;
  CameraModel camera;
};

absl::StatusOr<Recording> MakeRecording(const EventTrialOptions& options, int64_t duration_us, uint64_t seed) {
  EVPOSE_ASSIGN_OR_RETURN(SimulationOptions scene,
                          SimulationPreset(SimulatedObjectName(options.object), "evk4", options.speed_scale));
  scene.duration_us = duration_us;
  scene.sensor.noise_ratio = options.noise_ratio;
  scene.seed = seed;
  scene.t_begin_us = 0;
  Recording recording;
  recording.camera = scene.camera;
  EVPOSE_ASSIGN_OR_RETURN(ObjectModel model, SimulatedModel(scene));
  recording.model = std::make_shared<const ObjectModel>(std::move(model));
  recording.truth = SimulatedTruth(scene);
  EVPOSE_RETURN_IF_ERROR(Simulate(scene, [&recording](absl::Span<const Event> events) {
                           recording.events.insert(recording.events.end(), events.begin(), events.end());
                           return absl::OkStatus();
                         }).status());
  return recording;
}

absl::Span<const Event> Between(const std::vector<Event>& events, int64_t begin_us, int64_t end_us) {
  const auto earlier = [](const Event& event, int64_t t_us) { return event.t_us < t_us; };
  const auto begin = std::lower_bound(events.begin(), events.end(), begin_us, earlier);
  const auto end = std::lower_bound(begin, events.end(), end_us, earlier);
  return absl::MakeConstSpan(events).subspan(begin - events.begin(), end - begin);
}

bool IsRight(const Recording& recording, const RigidTransform& truth, const RigidTransform& estimate) {
  const RigidTransform nearest = NearestEquivalent(truth, recording.model->symmetries, estimate);
  return RotationAngle(nearest.rotation, estimate.rotation) <= kRightRad &&
         (nearest.translation_m - estimate.translation_m).norm() <= kRightDepthRatio * truth.translation_m.z();
}

// Mean distance of the projected end points of the lines that are visible at the truth.
double Reprojection(const Recording& recording, const VisibilityTester& visibility, const RigidTransform& truth,
                    const RigidTransform& estimate) {
  const RigidTransform nearest = NearestEquivalent(truth, recording.model->symmetries, estimate);
  double sum_px = 0.0;
  int count = 0;
  for (const VisibleSegment& segment : visibility.VisibleSegments(recording.camera, nearest)) {
    const ModelLine& line = recording.model->lines[segment.line];
    for (const double fraction : {segment.begin, segment.end}) {
      const Eigen::Vector3d point = line.p1 + fraction * (line.p2 - line.p1);
      const Eigen::Vector3d estimated = estimate * point;
      if (estimated.z() <= 0.0) continue;
      sum_px += (recording.camera.Project(estimated) - recording.camera.Project(nearest * point)).norm();
      ++count;
    }
  }
  return count > 0 ? sum_px / count : 0.0;
}

// How long wrong poses were reported without a break.
class WrongStretch {
 public:
  void Add(int64_t t_us, bool is_wrong) {
    if (!is_wrong) {
      since_us_ = -1;
      return;
    }
    if (since_us_ < 0) since_us_ = t_us;
    longest_us_ = std::max(longest_us_, t_us - since_us_);
  }
  int64_t longest_us() const { return longest_us_; }

 private:
  int64_t since_us_ = -1;
  int64_t longest_us_ = 0;
};

absl::StatusOr<EventTrial> RunTrial(const Recording& recording, const VisibilityTester& visibility,
                                    const EventTrialOptions& options, int64_t start_us) {
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<Tracker> tracker,
                          Tracker::Create(recording.model, recording.camera, options.tracker, std::nullopt));
  EventTrial trial;
  trial.t_start_us = start_us;
  WrongStretch wrong;
  constexpr int64_t kStepUs = 1000;
  for (int64_t t_us = start_us; t_us < start_us + options.watch_us; t_us += kStepUs) {
    std::vector<PoseEstimate> estimates;
    tracker->AddEvents(Between(recording.events, t_us, t_us + kStepUs), estimates);
    for (const PoseEstimate& estimate : estimates) {
      if (estimate.state != TrackState::kTracking) continue;
      const absl::StatusOr<RigidTransform> truth = Interpolate(recording.truth, estimate.t_us);
      if (!truth.ok()) continue;
      const bool is_right = IsRight(recording, *truth, estimate.camera_from_object);
      wrong.Add(estimate.t_us, !is_right);
      if (trial.t_first_pose_us >= 0) continue;
      trial.t_first_pose_us = t_us + kStepUs - start_us;
      trial.is_first_right = is_right;
      trial.reprojection_px = Reprojection(recording, visibility, *truth, estimate.camera_from_object);
    }
  }
  trial.wrong_us = wrong.longest_us();
  trial.attempts = tracker->initialization().attempts;
  return trial;
}

}  // namespace

absl::Status EventTrialOptions::Validate() const {
  if (num_starts < 1) return absl::InvalidArgumentError(absl::StrCat("num_starts must be positive: ", num_starts));
  if (watch_us < 1000 || recording_us < watch_us) {
    return absl::InvalidArgumentError(
        absl::StrCat("watch_us (", watch_us, ") must be at least 1000 and at most recording_us (", recording_us, ")"));
  }
  return tracker.Validate();
}

absl::StatusOr<std::vector<EventTrial>> RunEventTrials(const EventTrialOptions& options,
                                                       const std::function<void(const EventTrial&)>& on_trial) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_ASSIGN_OR_RETURN(const Recording recording, MakeRecording(options, options.recording_us, options.seed));
  const VisibilityTester visibility(*recording.model, VisibilityOptions());
  Random random(options.seed);
  std::vector<EventTrial> trials;
  for (int i = 0; i < options.num_starts; ++i) {
    const int64_t latest_us = options.recording_us - options.watch_us;
    const int64_t start_us = static_cast<int64_t>(random.Uniform(0.0, static_cast<double>(latest_us)));
    EVPOSE_ASSIGN_OR_RETURN(const EventTrial trial, RunTrial(recording, visibility, options, start_us));
    if (on_trial) on_trial(trial);
    trials.push_back(trial);
  }
  return trials;
}

EventTrialSummary Summarize(const std::vector<EventTrial>& trials) {
  EventTrialSummary summary;
  std::vector<int64_t> times_us;
  for (const EventTrial& trial : trials) {
    ++summary.num_starts;
    summary.longest_wrong_us = std::max(summary.longest_wrong_us, trial.wrong_us);
    if (trial.t_first_pose_us < 0) continue;
    times_us.push_back(trial.t_first_pose_us);
    if (!trial.is_first_right) {
      ++summary.num_wrong;
    } else if (trial.t_first_pose_us <= kBudgetUs) {
      ++summary.num_right;
      summary.reprojection_mean_px += trial.reprojection_px;
    }
  }
  if (summary.num_right > 0) summary.reprojection_mean_px /= summary.num_right;
  std::sort(times_us.begin(), times_us.end());
  if (!times_us.empty()) summary.first_pose_median_ms = static_cast<double>(times_us[times_us.size() / 2]) * 1e-3;
  return summary;
}

absl::StatusOr<int64_t> RunReturnTrial(const EventTrialOptions& options, int64_t absence_us) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  constexpr int64_t kBeforeUs = 500'000;
  EVPOSE_ASSIGN_OR_RETURN(const Recording before, MakeRecording(options, kBeforeUs, options.seed));
  EVPOSE_ASSIGN_OR_RETURN(const Recording after, MakeRecording(options, options.watch_us, options.seed + 1000));
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<Tracker> tracker,
                          Tracker::Create(before.model, before.camera, options.tracker, std::nullopt));
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(before.events, estimates);

  Random random(options.seed);
  std::vector<Event> noise;
  const double noise_hz = options.noise_ratio * static_cast<double>(before.events.size()) / (kBeforeUs * 1e-6);
  for (double t_s = random.Exponential(noise_hz); t_s * 1e6 < absence_us; t_s += random.Exponential(noise_hz)) {
    noise.push_back({kBeforeUs + static_cast<int64_t>(t_s * 1e6),
                     static_cast<uint16_t>(random.UniformInt(before.camera.width_px)),
                     static_cast<uint16_t>(random.UniformInt(before.camera.height_px)),
                     static_cast<uint8_t>(random.UniformInt(2))});
  }
  tracker->AddEvents(noise, estimates);

  constexpr int64_t kStepUs = 1000;
  const int64_t shift_us = kBeforeUs + absence_us;
  for (int64_t t_us = 0; t_us < options.watch_us; t_us += kStepUs) {
    std::vector<Event> events;
    for (Event event : Between(after.events, t_us, t_us + kStepUs)) {
      event.t_us += shift_us;
      events.push_back(event);
    }
    estimates.clear();
    tracker->AddEvents(events, estimates);
    for (const PoseEstimate& estimate : estimates) {
      if (estimate.state != TrackState::kTracking || estimate.t_us < shift_us) continue;
      const absl::StatusOr<RigidTransform> truth = Interpolate(after.truth, estimate.t_us - shift_us);
      if (truth.ok() && IsRight(after, *truth, estimate.camera_from_object)) return t_us + kStepUs;
    }
  }
  return -1;
}

}  // namespace evpose

#include "core/tracking/tracker.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "core/detection/plane_detector.h"
#include "core/initialization/initializer.h"
#include "core/models/symmetry.h"
#include "core/tracking/hypotheses.h"
#include "core/tracking/pose_track.h"
#include "core/tracking/tracker_options.h"
#include "core/windows/window_memory.h"

namespace evpose {
namespace {

class WindowTracker : public Tracker {
 public:
  WindowTracker(TrackContext context, std::unique_ptr<PoseInitializer> initializer,
                const std::optional<RigidTransform>& initial)
      : context_(std::move(context)),
        windower_(context_.options.windows),
        memory_(context_.options.initialization.memory_us, context_.options.initialization.max_window_events),
        initializer_(std::move(initializer)),
        reference_{context_.options.initialization.reference_rotation, Eigen::Vector3d::Zero()},
        given_pose_(initial),
        retry_us_(context_.options.initialization.retry_us),
        hypotheses_(context_) {}

  void AddEvents(absl::Span<const Event> events, std::vector<PoseEstimate>& estimates) override {
    windower_.Add(events, [&](const EventWindow& window) { OnWindow(window, estimates); });
  }
  void AdvanceTime(int64_t t_us, std::vector<PoseEstimate>& estimates) override {
    windower_.AdvanceTime(t_us, [&](const EventWindow& window) { OnWindow(window, estimates); });
  }
  void Finish(std::vector<PoseEstimate>& estimates) override {
    windower_.Finish([&](const EventWindow& window) { OnWindow(window, estimates); });
    // The events are over, and never spoke for the pose that was given.
    if (is_given_ || given_pose_) Lose();
  }
  void ResetPose(const RigidTransform& camera_from_object) override {
    given_pose_ = camera_from_object;
    given_at_us_ = windower_.now_us();
    hypotheses_.Clear();
    idle_state_ = TrackState::kInitializing;
    is_claimed_ = false;
  }
  TrackState state() const override {
    if (!is_claimed_) return idle_state_;
    return hypotheses_.size() > 1 && !is_decided_ ? TrackState::kDegraded : hypotheses_.best().state();
  }
  InitializationReport initialization() const override { return report_; }
  uint32_t losses() const override { return losses_; }

 private:
  void OnWindow(const EventWindow& window, std::vector<PoseEstimate>& estimates);
  void StartFromGivenPose(const EventWindow& window);
  void Follow(const EventWindow& window, std::vector<PoseEstimate>& estimates);
  // Whether the best hypothesis may be reported now.
  bool MayClaim(const EventWindow& window);
  void Search(const EventWindow& window, std::vector<PoseEstimate>& estimates);
  // The events in memory, undistorted.
  void CollectEvents();
  MotionState StartState(const FirstPose& first) const;
  void Lose();

  const TrackContext context_;
  EventWindower windower_;
  WindowMemory memory_;
  const std::unique_ptr<PoseInitializer> initializer_;  // null: the pose is only ever given

  TrackState idle_state_ = TrackState::kInitializing;  // while no pose is reported
  InitializationReport report_;
  uint32_t losses_ = 0;
  RigidTransform reference_;  // of equivalent poses, the one whose rotation is nearest to this is found
  std::optional<RigidTransform> given_pose_;
  std::optional<int64_t> given_at_us_;
  int64_t next_search_us_ = 0;
  int64_t retry_us_ = 0;

  Hypotheses hypotheses_;
  int64_t followed_since_us_ = 0;
  bool is_given_ = false;    // the hypothesis is a pose that was given, and the events have not spoken for it yet
  bool is_claimed_ = false;  // the best hypothesis is reported
  bool is_decided_ = false;  // there was a time when it was the only one

  std::vector<PixelEvent> pixel_events_;
};

void WindowTracker::OnWindow(const EventWindow& window, std::vector<PoseEstimate>& estimates) {
  if (given_pose_) StartFromGivenPose(window);
  if (!is_claimed_ && initializer_ != nullptr) memory_.Add(window);
  if (!hypotheses_.empty()) {
    Follow(window, estimates);
  } else if (initializer_ != nullptr) {
    Search(window, estimates);
  }
}

void WindowTracker::StartFromGivenPose(const EventWindow& window) {
  const RigidTransform pose = *std::exchange(given_pose_, std::nullopt);
  const int64_t t_us = std::min(given_at_us_.value_or(window.t_begin_us), window.t_mid_us());
  const double focal_px = std::max(context_.camera.fx_px, context_.camera.fy_px);
  hypotheses_.Clear();
  hypotheses_.Add(InitialMotionState(pose, t_us, focal_px, context_.options.initial));
  followed_since_us_ = t_us;
  is_given_ = true;
  is_decided_ = false;
  memory_.Clear();
  report_.status = InitializationStatus::kVerifying;
}

void WindowTracker::Follow(const EventWindow& window, std::vector<PoseEstimate>& estimates) {
  std::optional<PoseEstimate> estimate = hypotheses_.OnWindow(window);
  if (hypotheses_.empty()) {
    if (is_claimed_ || is_given_) Lose();
    report_.status = InitializationStatus::kNoPoseFits;
    return;
  }
  if (!is_claimed_ && estimate && MayClaim(window)) {
    is_claimed_ = true;
    is_given_ = false;
    memory_.Clear();
    retry_us_ = context_.options.initialization.retry_us;
  }
  if (hypotheses_.size() == 1) is_decided_ = true;
  if (is_claimed_) {
    report_.status = is_decided_ ? InitializationStatus::kNotNeeded : InitializationStatus::kAmbiguous;
  } else {
    report_.status = estimate ? InitializationStatus::kAmbiguous : InitializationStatus::kVerifying;
  }
  if (!is_claimed_ || !estimate) return;
  reference_ = estimate->camera_from_object;
  estimate->state = state();
  estimates.push_back(*estimate);
}

bool WindowTracker::MayClaim(const EventWindow& window) {
  return hypotheses_.size() == 1 ||
         window.t_end_us - followed_since_us_ >= context_.options.initialization.undecided_us;
}

void WindowTracker::Search(const EventWindow& window, std::vector<PoseEstimate>& estimates) {
  const InitializationOptions& options = context_.options.initialization;
  if (memory_.num_events() < static_cast<size_t>(options.min_events)) {
    report_.status = InitializationStatus::kWaitingForEvents;
    return;
  }
  if (window.t_end_us < next_search_us_) return;
  next_search_us_ = window.t_end_us + retry_us_;
  retry_us_ = std::min(options.max_retry_us, retry_us_ + retry_us_ / 2);

  CollectEvents();
  const FirstPoses first = initializer_->Find(pixel_events_);
  ++report_.attempts;
  report_.num_lines = first.num_lines;
  constexpr int kMinLines = 3;
  report_.status = first.num_lines < kMinLines ? InitializationStatus::kTooFewLines : InitializationStatus::kNoPoseFits;
  if (first.poses.empty()) return;

  const size_t num_candidates = std::min<size_t>(first.poses.size(), options.max_candidates);
  for (size_t i = 0; i < num_candidates; ++i) hypotheses_.Add(StartState(first.poses[i]));
  followed_since_us_ = first.poses.front().t_us;
  is_decided_ = false;
  // They catch up with the present.
  const size_t num_windows = memory_.size();
  for (size_t i = 0; i < num_windows && !hypotheses_.empty(); ++i) {
    const EventWindow past = memory_.At(i);
    if (past.t_mid_us() >= followed_since_us_) Follow(past, estimates);
  }
}

void WindowTracker::CollectEvents() {
  pixel_events_.clear();
  for (size_t i = 0; i < memory_.size(); ++i) {
    for (const Event& event : memory_.At(i).events) {
      const std::optional<Observation> observation = Observe(context_, event, event.t_us);
      if (!observation) continue;
      pixel_events_.push_back(
          {event.t_us, static_cast<float>(observation->u_px), static_cast<float>(observation->v_px), event.polarity});
    }
  }
}

MotionState WindowTracker::StartState(const FirstPose& first) const {
  const RigidTransform pose = NearestEquivalent(first.camera_from_object, context_.model->symmetries, reference_);
  const double focal_px = std::max(context_.camera.fx_px, context_.camera.fy_px);
  MotionState state = InitialMotionState(pose, first.t_us, focal_px, context_.options.initial);
  state.twist = first.twist;
  state.covariance.bottomRightCorner<6, 6>() = first.twist_covariance;
  return state;
}

void WindowTracker::Lose() {
  hypotheses_.Clear();
  given_pose_.reset();
  is_given_ = false;
  is_claimed_ = false;
  idle_state_ = TrackState::kLost;
  report_.status = InitializationStatus::kWaitingForEvents;
  ++losses_;
}

absl::Status CheckModel(const ObjectModel* model) {
  if (model == nullptr) return absl::InvalidArgumentError("the tracker needs a model");
  if (model->lines.empty()) return absl::InvalidArgumentError("the model has no line: there is nothing to track");
  // Tiles number lines with 16 bits, and a line may be visible in several parts.
  constexpr size_t kMaxLines = 4096;
  if (model->lines.size() > kMaxLines) {
    return absl::InvalidArgumentError(
        absl::StrCat("the model has ", model->lines.size(), " lines; at most ", kMaxLines, " can be tracked"));
  }
  for (size_t k = 0; k < model->lines.size(); ++k) {
    if (!model->lines[k].p1.allFinite() || !model->lines[k].p2.allFinite()) {
      return absl::InvalidArgumentError(absl::StrCat("model line ", k, " has an end point that is not finite"));
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<PoseInitializer>> MakeInitializer(std::shared_ptr<const ObjectModel> model,
                                                                 const CameraModel& camera) {
  const SensorGeometry sensor = {camera.width_px, camera.height_px};
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<LineDetector> detector, MakePlaneLineDetector({}, sensor));
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<PoseSearch> search, MakePoseSearch(model, camera));
  return std::make_unique<PoseInitializer>(std::move(model), camera, std::move(detector), std::move(search));
}

}  // namespace

std::string_view TrackStateName(TrackState state) {
  switch (state) {
    case TrackState::kInitializing:
      return "INITIALIZING";
    case TrackState::kTracking:
      return "TRACKING";
    case TrackState::kDegraded:
      return "DEGRADED";
    case TrackState::kLost:
      return "LOST";
  }
  return "UNKNOWN";
}

std::string_view InitializationStatusName(InitializationStatus status) {
  switch (status) {
    case InitializationStatus::kNotNeeded:
      return "NOT_NEEDED";
    case InitializationStatus::kWaitingForEvents:
      return "WAITING_FOR_EVENTS";
    case InitializationStatus::kTooFewLines:
      return "TOO_FEW_LINES";
    case InitializationStatus::kNoPoseFits:
      return "NO_POSE_FITS";
    case InitializationStatus::kVerifying:
      return "VERIFYING";
    case InitializationStatus::kAmbiguous:
      return "AMBIGUOUS";
  }
  return "UNKNOWN";
}

absl::StatusOr<std::unique_ptr<Tracker>> Tracker::Create(
    std::shared_ptr<const ObjectModel> model, const CameraModel& camera, const TrackerOptions& options,
    const std::optional<RigidTransform>& initial_camera_from_object) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_RETURN_IF_ERROR(camera.Validate());
  EVPOSE_RETURN_IF_ERROR(CheckModel(model.get()));
  if (initial_camera_from_object &&
      !(initial_camera_from_object->rotation.allFinite() && initial_camera_from_object->translation_m.allFinite() &&
        initial_camera_from_object->translation_m.norm() > 1e-9)) {
    return absl::InvalidArgumentError("initial_camera_from_object must be finite, and away from the camera's centre");
  }
  EVPOSE_ASSIGN_OR_RETURN(UndistortionTable undistortion, UndistortionTable::Create(camera));
  std::unique_ptr<PoseInitializer> initializer;
  if (options.initialization.is_automatic) {
    EVPOSE_ASSIGN_OR_RETURN(initializer, MakeInitializer(model, camera));
  }
  return std::make_unique<WindowTracker>(
      TrackContext{model, camera, std::move(undistortion), options, VisibilityTester(*model, options.visibility)},
      std::move(initializer), initial_camera_from_object);
}

}  // namespace evpose

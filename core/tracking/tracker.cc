#include "core/tracking/tracker.h"

#include <algorithm>
#include <limits>
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
        windower_(context_.options.windows, {context_.camera.width_px, context_.camera.height_px}),
        memory_(context_.options.initialization.memory_us, context_.options.initialization.max_window_events,
                context_.options.initialization.max_events),
        initializer_(std::move(initializer)),
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
    given_at_us_ = windower_.has_started() ? std::optional<int64_t>(windower_.now_us()) : std::nullopt;
    hypotheses_.Clear();
    idle_state_ = TrackState::kInitializing;
    report_.status = InitializationStatus::kVerifying;
    is_claimed_ = false;
  }
  TrackState state() const override {
    if (!is_claimed_) return idle_state_;
    return hypotheses_.size() > 1 && !is_decided_ ? TrackState::kDegraded : hypotheses_.first().state();
  }
  InitializationReport initialization() const override { return report_; }
  uint32_t losses() const override { return losses_; }

 private:
  void OnWindow(const EventWindow& window, std::vector<PoseEstimate>& estimates);
  void StartFromGivenPose(const EventWindow& window);
  void Follow(const EventWindow& window, std::vector<PoseEstimate>& estimates);
  // Whether the best hypothesis may be reported now.
  bool MayClaim(const EventWindow& window) const;
  void Claim(const EventWindow& window);
  void Search(const EventWindow& window, std::vector<PoseEstimate>& estimates);
  // Asks the initializer again, and lets what it finds challenge the pose that is reported.
  bool MayReview() const;
  void Review(const EventWindow& window);
  // Adds the hypotheses that the events in memory allow; says why there are none.
  InitializationStatus FindHypotheses(Hypotheses& hypotheses);
  // The events in memory, undistorted.
  void CollectEvents();
  // Of poses that the object's symmetry makes equal, the one whose rotation is nearest to this is found.
  RigidTransform ReferenceAt(int64_t t_us) const;
  MotionState StartState(const FirstPose& first) const;
  void Publish(PoseEstimate estimate, std::vector<PoseEstimate>& estimates);
  void Lose();
  // The pose that was reported, or given, is no longer believed.
  void CountLoss();

  const TrackContext context_;
  EventWindower windower_;
  WindowMemory memory_;
  const std::unique_ptr<PoseInitializer> initializer_;  // null: the pose is only ever given

  TrackState idle_state_ = TrackState::kInitializing;  // while no pose is reported
  InitializationReport report_;
  uint32_t losses_ = 0;
  std::optional<MotionState> last_tracked_;
  int64_t last_published_us_ = std::numeric_limits<int64_t>::min();
  std::optional<RigidTransform> given_pose_;
  std::optional<int64_t> given_at_us_;
  int64_t next_search_us_ = 0;
  int64_t retry_us_ = 0;
  int reviews_left_ = 0;

  Hypotheses hypotheses_;
  int64_t followed_since_us_ = 0;
  bool is_given_ = false;    // the hypothesis is a pose that was given, and the events have not spoken for it yet
  bool is_claimed_ = false;  // the best hypothesis is reported
  bool is_decided_ = false;  // there was a time when it was the only one

  std::vector<PixelEvent> pixel_events_;
};

void WindowTracker::OnWindow(const EventWindow& window, std::vector<PoseEstimate>& estimates) {
  if (given_pose_) StartFromGivenPose(window);
  if (initializer_ != nullptr) {
    if (is_claimed_ && reviews_left_ == 0 && state() == TrackState::kTracking) {
      memory_.Clear();
    } else {
      memory_.Add(window);
    }
  }
  if (!hypotheses_.empty()) {
    Follow(window, estimates);
    if (MayReview() && window.t_end_us >= next_search_us_) Review(window);
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
  const PoseTrack* believed = is_given_ || (is_claimed_ && is_decided_) ? &hypotheses_.first() : nullptr;
  hypotheses_.OnWindow(window);
  if (hypotheses_.empty()) {
    if (is_claimed_ || is_given_) Lose();
    report_.status = InitializationStatus::kNoPoseFits;
    return;
  }
  // The pose that was reported, or given, is refuted, and others are left: one of them is reported when it is sure.
  if (believed != nullptr && believed != &hypotheses_.first()) CountLoss();
  if (hypotheses_.size() == 1) is_decided_ = true;
  // Once one is reported, it is left for a likelier one, not for every wavering of the balance.
  if (!is_decided_ && !is_given_) {
    hypotheses_.PutBestFirst(is_claimed_ ? 0.5 * context_.options.initialization.decision_sigma : 0.0);
  }
  const std::optional<PoseEstimate>& estimate = hypotheses_.estimate();
  if (!is_claimed_) {
    report_.status = estimate ? InitializationStatus::kAmbiguous : InitializationStatus::kVerifying;
    if (!estimate || !MayClaim(window)) return;
    Claim(window);
  }
  report_.status = is_decided_ ? InitializationStatus::kNotNeeded : InitializationStatus::kAmbiguous;
  if (estimate) Publish(*estimate, estimates);
}

void WindowTracker::Publish(PoseEstimate estimate, std::vector<PoseEstimate>& estimates) {
  estimate.state = state();
  if (estimate.state == TrackState::kTracking) last_tracked_ = hypotheses_.first().motion();
  // A search after a loss looks back on windows whose poses are out already.
  if (estimate.t_us <= last_published_us_) return;
  last_published_us_ = estimate.t_us;
  estimates.push_back(estimate);
}

bool WindowTracker::MayClaim(const EventWindow& window) const {
  return is_decided_ || window.t_end_us - followed_since_us_ >= context_.options.initialization.undecided_us;
}

void WindowTracker::Claim(const EventWindow& window) {
  const InitializationOptions& options = context_.options.initialization;
  is_claimed_ = true;
  reviews_left_ = is_given_ ? 0 : options.num_reviews;
  is_given_ = false;
  next_search_us_ = window.t_end_us + options.review_us;
  retry_us_ = options.retry_us;
}

void WindowTracker::Search(const EventWindow& window, std::vector<PoseEstimate>& estimates) {
  const InitializationOptions& options = context_.options.initialization;
  if (memory_.num_events() < static_cast<size_t>(options.min_events)) {
    report_.status = InitializationStatus::kWaitingForEvents;
    next_search_us_ = window.t_end_us + options.retry_us;
    return;
  }
  if (window.t_end_us < next_search_us_) return;
  report_.status = FindHypotheses(hypotheses_);
  const bool is_vain = report_.status == InitializationStatus::kNoPoseFits;
  retry_us_ = std::min(is_vain ? options.max_vain_retry_us : options.max_retry_us, retry_us_ + retry_us_ / 4 + 1);
  next_search_us_ = window.t_end_us + retry_us_;
  if (hypotheses_.empty()) return;
  is_decided_ = false;
  followed_since_us_ = hypotheses_.first().motion().t_us;
  // They catch up with the present.
  const size_t num_windows = memory_.size();
  for (size_t i = 0; i < num_windows && !hypotheses_.empty(); ++i) {
    const EventWindow past = memory_.At(i);
    if (past.t_mid_us() >= followed_since_us_) Follow(past, estimates);
  }
}

bool WindowTracker::MayReview() const {
  if (initializer_ == nullptr || hypotheses_.empty()) return false;
  if (memory_.num_events() < static_cast<size_t>(context_.options.initialization.min_events)) return false;
  // Whether an object stands still or is gone, its own lines do not tell: it may be back elsewhere.
  return !is_claimed_ || reviews_left_ > 0 || state() == TrackState::kDegraded;
}

void WindowTracker::Review(const EventWindow& window) {
  next_search_us_ = window.t_end_us + context_.options.initialization.review_us;
  if (is_claimed_ && reviews_left_ > 0) --reviews_left_;
  Hypotheses challengers(context_);
  FindHypotheses(challengers);
  const int64_t since_us = challengers.empty() ? 0 : challengers.first().motion().t_us;
  for (size_t i = 0; i < memory_.size() && !challengers.empty(); ++i) {
    const EventWindow past = memory_.At(i);
    if (past.t_mid_us() >= since_us) challengers.OnWindow(past);
  }
  if (!challengers.empty()) is_decided_ = is_decided_ && is_claimed_;
  hypotheses_.Join(std::move(challengers));
}

InitializationStatus WindowTracker::FindHypotheses(Hypotheses& hypotheses) {
  constexpr int kMinLines = 3;
  CollectEvents();
  const FirstPoses first = initializer_->Find(pixel_events_);
  ++report_.attempts;
  report_.num_lines = first.num_lines;
  const size_t count = std::min<size_t>(first.poses.size(), context_.options.initialization.max_candidates);
  for (size_t i = 0; i < count; ++i) hypotheses.Add(StartState(first.poses[i]));
  if (!first.poses.empty()) return InitializationStatus::kVerifying;
  if (first.num_lines < kMinLines) return InitializationStatus::kTooFewLines;
  return first.has_moved ? InitializationStatus::kNoPoseFits : InitializationStatus::kWaitingForEvents;
}

void WindowTracker::CollectEvents() {
  pixel_events_.clear();
  for (size_t i = 0; i < memory_.size(); ++i) {
    for (const WindowEvent& event : memory_.At(i).events) {
      const std::optional<Observation> observation = Observe(context_, event, event.t_us);
      if (!observation) continue;
      pixel_events_.push_back(
          {event.t_us, static_cast<float>(observation->u_px), static_cast<float>(observation->v_px), event.polarity});
    }
  }
}

RigidTransform WindowTracker::ReferenceAt(int64_t t_us) const {
  if (!last_tracked_) return {context_.options.initialization.reference_rotation, Eigen::Vector3d::Zero()};
  // Longer than this no motion goes on as it was.
  constexpr int64_t kForesightUs = 100'000;
  const int64_t later_us = std::clamp<int64_t>(t_us - last_tracked_->t_us, 0, kForesightUs);
  return Predict(*last_tracked_, last_tracked_->t_us + later_us, context_.options.motion).camera_from_object;
}

MotionState WindowTracker::StartState(const FirstPose& first) const {
  const RigidTransform pose =
      NearestEquivalent(first.camera_from_object, context_.model->symmetries, ReferenceAt(first.t_us));
  const double focal_px = std::max(context_.camera.fx_px, context_.camera.fy_px);
  MotionState state = InitialMotionState(pose, first.t_us, focal_px, context_.options.initial);
  state.twist = first.twist;
  state.covariance.bottomRightCorner<6, 6>() = first.twist_covariance;
  return state;
}

void WindowTracker::Lose() {
  CountLoss();
  hypotheses_.Clear();
  given_pose_.reset();
}

void WindowTracker::CountLoss() {
  is_claimed_ = false;
  is_decided_ = false;
  is_given_ = false;
  idle_state_ = TrackState::kLost;
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

// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/object_tracker.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/base/yield_point.h"
#include "core/geometry/lines_of_a_pose.h"
#include "core/geometry/single_precision.h"
#include "core/models/continuous_symmetry.h"
#include "core/tracking/object/event_extent.h"
#include "core/tracking/object/tracker_options.h"

namespace evpose {
namespace {

// Least time between two past states, microseconds: lines move little in this time, and that motion is predicted.
constexpr int64_t kPastStateSpacingUs = 2500;
// Inclination of a face at which its mirrored pose is tested, relative to InitializationOptions::merge_rad: both then
// differ by more than poses that are merged.
constexpr double kInclinedOfMerge = 0.6;

}  // namespace

ObjectTracker::ObjectTracker(TrackContext context, std::unique_ptr<PoseInitializer> initializer,
                             const ObjectToTrack& object)
    : context_(std::move(context)),
      reference_rotation_(object.reference_rotation),
      memory_(context_.options.initialization.memory_us, context_.options.initialization.max_window_events,
              context_.options.initialization.max_events),
      initializer_(std::move(initializer)),
      search_schedule_(context_.options.initialization),
      hypotheses_(context_),
      rival_generator_(*context_.model),
      turned_faces_(*context_.edges, kInclinedOfMerge * context_.options.initialization.merge_rad),
      tilt_test_(context_.options.initialization.tilt_view_rad, context_.options.initialization.tilt_residual_growth),
      rival_schedule_(context_.options.initialization) {
  if (object.initial_camera_from_object) given_ = {*object.initial_camera_from_object, std::nullopt};
}

void ObjectTracker::SetOthers(std::vector<const ObjectTracker*> others) {
  others_ = std::move(others);
  if (!others_.empty()) other_objects_ = std::make_unique<OtherObjects>(context_.camera);
}

void ObjectTracker::SetPhaseListener(PhaseListener listener) {
  context_.phase_reporter->listener = std::move(listener);
}

void ObjectTracker::BeginWindow() {
  published_others_.clear();
  for (const ObjectTracker* other : others_) {
    if (IsPublished(other->phase_)) published_others_.push_back(other);
  }
  if (hypotheses_.empty()) past_states_.clear();
}

void ObjectTracker::OnGap(const EventGap& gap) {
  now_us_ = gap.t_end_us;
  // The pose was given for the first event: its time is the beginning of the gap.
  if (given_ && !given_->at_us) given_->at_us = gap.t_begin_us;
  followed_since_us_ += gap.duration_us();
  hypotheses_.OnGap(gap.duration_us());
}

void ObjectTracker::Finish() {
  if (IsGiven(phase_) || given_) {
    Reject(ObjectInput::kUnconfirmed, LossCause::kUnconfirmed);
    hypotheses_.Clear();
    given_.reset();
  } else if (hypotheses_.empty() && initializer_ != nullptr) {
    // The last search may be an exception: if the object rests at the end of the stream, the result of that search does
    // not apply to the time before.
    report_.status = MostFrequentResult(report_.searches);
  }
}

void ObjectTracker::ResetPose(const RigidTransform& camera_from_object, std::optional<int64_t> at_us) {
  given_ = {camera_from_object, at_us};
  hypotheses_.Clear();
  past_states_.clear();
  report_.status = InitializationStatus::kVerifying;
  report_.searches = {};
  Enter(ObjectInput::kReset);
}

double ObjectTracker::ImageSpeedPxPerS() const {
  if (!IsPublished(phase_)) return 0.0;
  const MotionState& motion = hypotheses_.first().motion();
  const Eigen::Vector3d arm = motion.camera_from_object.rotation * context_.sphere.centre;
  const Eigen::Vector3d centre = motion.camera_from_object.translation_m + arm;
  const Eigen::Vector3d angular = motion.twist.tail<3>();
  const Eigen::Vector3d velocity = motion.twist.head<3>() + angular.cross(arm);
  const double depth_m = std::max(centre.z(), context_.sphere.radius_m);
  const Eigen::Vector2d sideways = velocity.head<2>() - velocity.z() / depth_m * centre.head<2>();
  const double about_centre = context_.sphere.radius_m * (angular.norm() + std::abs(velocity.z()) / depth_m);
  return context_.camera.MaxFocalPx() / depth_m * (sideways.norm() + about_centre);
}

TrackState ObjectTracker::state() const {
  if (!IsPublished(phase_)) return ReportedState(acquisition_);
  const bool has_competing_hypotheses = hypotheses_.size() > 1 && IsCompeting(phase_);
  return has_competing_hypotheses ? TrackState::kAmbiguous : hypotheses_.first().state();
}

InitializationReport ObjectTracker::initialization() const {
  InitializationReport report = report_;
  report.num_poses = static_cast<int>(hypotheses_.NumCompared());
  return report;
}

bool ObjectTracker::Outline(ObjectOutline& outline) const {
  if (!IsPublished(phase_)) return false;
  const MotionState& motion = hypotheses_.first().motion();
  outline.state = state();
  // There has been no window since the last call.
  if (outline.t_us == motion.t_us && outline.camera_from_object == motion.camera_from_object) return true;
  outline.t_us = motion.t_us;
  outline.camera_from_object = motion.camera_from_object;
  outline.SetEdges(hypotheses_.first().lines());
  return true;
}

void ObjectTracker::OnWindow(const EventWindow& window, std::vector<PoseEstimate>& estimates) {
  now_us_ = window.t_end_us;
  if (given_) StartFromGivenPose(window);
  if (initializer_ != nullptr) {
    if (IsPublished(phase_) && !search_schedule_.has_repeats() && state() == TrackState::kTracking) {
      memory_.Clear();
      search_schedule_.OnTracking();
    } else {
      memory_.Add(window);
    }
  }
  if (!hypotheses_.empty()) {
    Follow(window, estimates);
    if (MaySearchAgain() && search_schedule_.IsDue(window.t_end_us)) SearchAgain(window);
  } else if (initializer_ != nullptr) {
    Search(window, estimates);
  } else if (context_.options.initialization.is_automatic) {
    report_.status = InitializationStatus::kNotSearchable;
  }
}

void ObjectTracker::StartFromGivenPose(const EventWindow& window) {
  const GivenPose given = *std::exchange(given_, std::nullopt);
  const int64_t t_us = std::min(given.at_us.value_or(window.t_begin_us), window.t_mid_us());
  const double focal_px = context_.camera.MaxFocalPx();
  hypotheses_.Clear();
  past_states_.clear();
  hypotheses_.Add(InitialMotionState(given.camera_from_object, t_us, focal_px, context_.options.initial));
  followed_since_us_ = t_us;
  Enter(ObjectInput::kGivenPose);
  memory_.Clear();
  // The given pose is tested against the events before a search begins.
  search_schedule_.Postpone(window.t_end_us);
  report_.status = InitializationStatus::kVerifying;
}

void ObjectTracker::Follow(const EventWindow& window, std::vector<PoseEstimate>& estimates) {
  const PoseTrack* first = &hypotheses_.first();
  hypotheses_.OnWindow(window, OthersAt(window, hypotheses_.size() == 1 ? &hypotheses_.first().motion() : nullptr));
  hypotheses_.DropIf([this](const PoseTrack& track) { return IsOccupied(track); }, LossCause::kOccupied);
  if (hypotheses_.empty()) {
    Reject(ObjectInput::kAllRejected, hypotheses_.first_removed_because());
    report_.status = InitializationStatus::kNotSupported;
    return;
  }
  if (first != &hypotheses_.first()) {
    if (hypotheses_.is_first_rival()) {
      Enter(ObjectInput::kRivals);  // its rival takes its place
      ContinueWithRival(window.t_end_us);
    } else {
      // The next hypothesis is published when it is confirmed.
      Reject(ObjectInput::kFirstRejected, hypotheses_.first_removed_because());
    }
  }
  if (hypotheses_.size() == 1 && IsCompeting(phase_)) AddRivalsOfLastHypothesis();
  if (hypotheses_.size() == 1) Enter(ObjectInput::kSingleLeft);
  if (hypotheses_.IsUndecided()) Enter(ObjectInput::kRivals);
  // A published pose is replaced only by one that is significantly more likely.
  if (IsCompeting(phase_) && !IsGiven(phase_)) {
    hypotheses_.PutBestFirst(IsPublished(phase_) ? 0.5 * context_.options.initialization.decision_sigma : 0.0);
  }
  StorePastState(window);
  const std::optional<PoseEstimate>& estimate = hypotheses_.estimate();
  if (!IsPublished(phase_)) {
    report_.status = estimate ? InitializationStatus::kAmbiguous : InitializationStatus::kVerifying;
    // If the events support every pose only in part, their comparison may not find the right one. The first one is
    // published, so that a further search may add a pose that the events support as a whole.
    const bool is_decided = !IsCompeting(phase_) || hypotheses_.AreAllDegraded() ||
                            window.t_end_us - followed_since_us_ >= context_.options.initialization.undecided_us;
    if (!estimate || !is_decided) return;
    StartPublishing(window);
  }
  report_.status = IsCompeting(phase_) ? InitializationStatus::kAmbiguous : InitializationStatus::kNotNeeded;
  if (estimate) Publish(*estimate, estimates);
  AddRivals(window);
}

void ObjectTracker::Publish(PoseEstimate estimate, std::vector<PoseEstimate>& estimates) {
  estimate.state = state();
  if (estimate.state == TrackState::kAmbiguous) estimate.alternatives = hypotheses_.Alternatives();
  if (estimate.state == TrackState::kTracking) last_tracked_ = hypotheses_.first().motion();
  // A search after a loss processes stored windows again; poses of some of them have already been published.
  if (estimate.t_us <= last_published_us_) return;
  last_published_us_ = estimate.t_us;
  estimate.covariance = InSinglePrecision(estimate.covariance);
  estimate.twist = InSinglePrecision(estimate.twist);
  estimate.loss_cause = report_.loss_cause;
  estimate.lost_at_us = report_.lost_at_us;
  estimates.push_back(estimate);
}

void ObjectTracker::StartPublishing(const EventWindow& window) {
  const bool is_given = IsGiven(phase_);
  Enter(ObjectInput::kPublication);
  turned_faces_.Reset();
  StartRivalRounds(window.t_end_us, is_given ? RivalPrior::kUnlikely : RivalPrior::kEqual);
  search_schedule_.OnPublication(window.t_end_us, is_given);
}

void ObjectTracker::Search(const EventWindow& window, std::vector<PoseEstimate>& estimates) {
  if (memory_.num_events() < static_cast<size_t>(context_.options.initialization.min_events)) {
    report_.status = InitializationStatus::kWaitingForEvents;
    search_schedule_.Postpone(window.t_end_us);
    return;
  }
  if (!search_schedule_.IsDue(window.t_end_us)) return;
  report_.status = FindHypotheses(hypotheses_);
  search_schedule_.OnSearch(window.t_end_us, report_.status == InitializationStatus::kNoPoseFits);
  if (hypotheses_.empty()) return;
  AddEqualRivals(hypotheses_);
  Enter(ObjectInput::kPosesFound);
  past_states_.clear();
  followed_since_us_ = hypotheses_.first().motion().t_us;
  // The new hypotheses process the stored windows up to the present one.
  const size_t num_windows = memory_.size();
  for (size_t i = 0; i < num_windows && !hypotheses_.empty(); ++i) {
    const EventWindow past = memory_.At(i);
    if (past.t_mid_us() >= followed_since_us_) Follow(past, estimates);
  }
}

bool ObjectTracker::MaySearchAgain() const {
  if (initializer_ == nullptr || hypotheses_.empty()) return false;
  if (memory_.num_events() < static_cast<size_t>(context_.options.initialization.min_events)) return false;
  // Do not search again while ambiguous: a new search would re-create hypotheses that were already rejected, without
  // the evidence accumulated against them.
  if (!IsPublished(phase_) && hypotheses_.estimate()) return false;
  // Events near its lines do not distinguish an object at rest from one that has left: it may reappear elsewhere.
  const TrackState now = state();
  return !IsPublished(phase_) || search_schedule_.has_repeats() || now == TrackState::kDegraded ||
         now == TrackState::kAmbiguous;
}

void ObjectTracker::SearchAgain(const EventWindow& window) {
  search_schedule_.OnSearchBesideHypotheses(window.t_end_us, IsPublished(phase_));
  Hypotheses challengers(context_);
  FindHypotheses(challengers);
  const int64_t since_us = challengers.empty() ? 0 : challengers.first().motion().t_us;
  for (size_t i = 0; i < memory_.size() && !challengers.empty(); ++i) {
    const EventWindow past = memory_.At(i);
    if (past.t_mid_us() >= since_us) challengers.OnWindow(past, OthersAt(past, nullptr));
  }
  if (!challengers.empty()) Enter(ObjectInput::kChallengers);
  hypotheses_.Join(std::move(challengers));
}

InitializationStatus ObjectTracker::FindHypotheses(Hypotheses& hypotheses) {
  const std::vector<PixelEvent> events = CollectEvents();
  const FirstPoses first = initializer_->Find(events);
  ++report_.attempts;
  report_.num_lines = first.num_lines;
  // Contours leave more poses undecided than lines: as many are taken as are kept at all (Hypotheses).
  const int max_count = (first.uses_contours ? 2 : 1) * context_.options.initialization.max_candidates;
  const size_t count = std::min(first.poses.size(), static_cast<size_t>(max_count));
  for (size_t i = 0; i < count; ++i) hypotheses.Add(StartState(first.poses[i]));
  if (!first.poses.empty()) {
    ++report_.searches.poses_found;
    return InitializationStatus::kVerifying;
  }
  if (first.num_lines < kLinesOfAPose) {
    if (const auto why = WhyTooFewEdges(events)) return *why;
    if (!first.uses_contours) {
      ++report_.searches.too_few_lines;
      return InitializationStatus::kTooFewLines;
    }
  }
  if (first.has_moved) {
    ++report_.searches.no_pose_fits;
    return InitializationStatus::kNoPoseFits;
  }
  ++report_.searches.not_enough_motion;
  return InitializationStatus::kNotEnoughMotion;
}

std::optional<InitializationStatus> ObjectTracker::WhyTooFewEdges(absl::Span<const PixelEvent> events) {
  report_.extent_px = EventExtentPx(events, context_.camera.width_px, context_.camera.height_px);
  if (report_.extent_px == 0) {
    ++report_.searches.no_signal;
    return InitializationStatus::kWaitingForEvents;
  }
  if (report_.extent_px < kMinSearchExtentPx) {
    ++report_.searches.too_small;
    return InitializationStatus::kTooSmall;
  }
  return std::nullopt;
}

std::vector<PixelEvent> ObjectTracker::CollectEvents() {
  std::vector<PixelEvent> pixel_events;
  pixel_events.reserve(memory_.num_events());
  for (size_t i = 0; i < memory_.size(); ++i) {
    const EventWindow window = memory_.At(i);
    const OtherObjects* others = OthersAt(window, nullptr);
    for (size_t k = 0; k < window.events.size(); ++k) {
      YieldPoint(k);
      if (k + kPrefetchAhead < window.events.size()) {
        const WindowEvent& ahead = window.events[k + kPrefetchAhead];
        context_.tables->undistortion.Prefetch(ahead.x, ahead.y);
      }
      const WindowEvent& event = window.events[k];
      const std::optional<Observation> observation =
          Observe(context_.camera, context_.tables->undistortion, event, window.t_mid_us());
      if (!observation) continue;
      if (others != nullptr && others->Explains(*observation)) continue;
      pixel_events.push_back(
          {event.t_us, static_cast<float>(observation->u_px), static_cast<float>(observation->v_px), event.polarity});
    }
  }
  // A step back in time is tolerated within a window, but the detectors of the search require the order of time.
  const auto is_earlier = [](const PixelEvent& a, const PixelEvent& b) { return a.t_us < b.t_us; };
  if (!std::is_sorted(pixel_events.begin(), pixel_events.end(), is_earlier)) {
    std::stable_sort(pixel_events.begin(), pixel_events.end(), is_earlier);
  }
  return pixel_events;
}

RigidTransform ObjectTracker::ReferenceAt(int64_t t_us) const {
  if (!last_tracked_) return {reference_rotation_, Eigen::Vector3d::Zero()};
  // The horizon of the motion model: predictions beyond it are not meaningful.
  constexpr int64_t kMaxExtrapolationUs = 100'000;
  const int64_t later_us = std::clamp<int64_t>(t_us - last_tracked_->t_us, 0, kMaxExtrapolationUs);
  return Predict(*last_tracked_, last_tracked_->t_us + later_us, context_.options.motion).camera_from_object;
}

MotionState ObjectTracker::StartState(const FirstPose& first) const {
  const RigidTransform pose = NearestEquivalent(first.camera_from_object, *context_.model, ReferenceAt(first.t_us));
  const double focal_px = context_.camera.MaxFocalPx();
  MotionState state = InitialMotionState(pose, first.t_us, focal_px, context_.options.initial);
  state.twist = first.twist;
  state.covariance.bottomRightCorner<6, 6>() = first.twist_covariance;
  return state;
}

const OtherObjects* ObjectTracker::OthersAt(const EventWindow& window, const MotionState* near) {
  if (other_objects_ == nullptr) return nullptr;
  const std::optional<BoundingSphere> sphere =
      near == nullptr ? std::nullopt : std::optional(SphereAt(near->camera_from_object));
  other_objects_->Clear();
  for (const ObjectTracker* other : published_others_) other->AddTo(window.t_mid_us(), sphere, *other_objects_);
  if (other_objects_->empty()) return nullptr;
  other_objects_->Build();
  return other_objects_.get();
}

void ObjectTracker::AddTo(int64_t t_us, const std::optional<BoundingSphere>& near, OtherObjects& other_objects) const {
  // The widest gate plus the motion of a fast object during a window.
  constexpr double kMarginPx = 64.0;
  const auto is_later = [t_us](const PastState& state) { return state.motion.t_us >= t_us; };
  const auto next = std::find_if(past_states_.begin(), past_states_.end(), is_later);
  if (next == past_states_.begin()) return;
  const PastState& before = *std::prev(next);
  const MotionState state = Predict(before.motion, t_us, context_.options.motion);
  const BoundingSphere sphere = SphereAt(state.camera_from_object);
  if (near && !MayOverlap(context_.camera, *near, sphere, kMarginPx)) return;
  other_objects.Add(state, before.lines, context_.edges->visibility(), context_.sphere,
                    context_.options.sensor.pixel_noise_px);
}

BoundingSphere ObjectTracker::SphereAt(const RigidTransform& camera_from_object) const {
  return {camera_from_object * context_.sphere.centre, context_.sphere.radius_m};
}

bool ObjectTracker::IsOccupied(const PoseTrack& track) const {
  // Two bodies cannot occupy the same place. An estimate that drifts onto another object of the same model comes closer
  // than this well before both coincide.
  constexpr double kSamePlaceRatio = 0.1;  // relative to the radius of the bounding sphere
  const Eigen::Vector3d centre = SphereAt(track.motion().camera_from_object).centre;
  return std::any_of(others_.begin(), others_.end(), [&](const ObjectTracker* other) {
    if (!IsPublished(other->phase_) || other->context_.model != context_.model) return false;
    const RigidTransform& pose = other->hypotheses_.first().motion().camera_from_object;
    return (other->SphereAt(pose).centre - centre).norm() < kSamePlaceRatio * context_.sphere.radius_m;
  });
}

void ObjectTracker::StorePastState(const EventWindow& window) {
  if (others_.empty() || hypotheses_.empty()) return;
  const PoseTrack& track = hypotheses_.first();
  // Another object that processes the same window later needs the state before it, so that the latest two are kept.
  const size_t count = past_states_.size();
  if (count > 2 && past_states_[count - 2].motion.t_us - past_states_[count - 3].motion.t_us < kPastStateSpacingUs) {
    past_states_.erase(past_states_.end() - 2);
  }
  past_states_.push_back({track.motion(), {track.lines().begin(), track.lines().end()}});
  const int64_t oldest_us = window.t_end_us - context_.options.initialization.memory_us;
  while (past_states_.size() > 1 &&
         (past_states_[1].motion.t_us <= oldest_us || past_states_.size() > kMaxPastStates)) {
    past_states_.pop_front();
  }
}

void ObjectTracker::Enter(ObjectInput input) {
  acquisition_ = NextAcquisition(acquisition_, phase_, input);
  const ObjectPhase next = NextPhase(phase_, input);
  context_.phase_reporter->Report(phase_, next, now_us_);
  phase_ = next;
}

void ObjectTracker::Reject(ObjectInput input, LossCause cause) {
  if (IsLoss(phase_, input)) {
    report_.loss_cause = cause;
    report_.lost_at_us = now_us_;
    report_.searches = {};
    search_schedule_.OnLoss();
    ++losses_;
  }
  Enter(input);
}

}  // namespace evpose

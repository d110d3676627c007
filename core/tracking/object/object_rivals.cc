// SPDX-License-Identifier: Apache-2.0

// The rivals of the poses of one object (core/tracking/README.md, section 6).
#include <utility>

#include "core/tracking/object/object_tracker.h"

namespace evpose {

void ObjectTracker::AddRivals(const EventWindow& window) {
  // Without events of the object, as at rest, those of other edges would decide between its inclinations.
  if (phase_ == ObjectPhase::kPublished && state() != TrackState::kTracking) hypotheses_.RemoveTilted();
  if (phase_ != ObjectPhase::kPublished || hypotheses_.size() > 1) {
    turned_faces_.Reset();  // another pose may be published next
    return;
  }
  const double focal_px = context_.camera.MaxFocalPx();
  const MotionState& motion = hypotheses_.first().motion();
  const std::optional<size_t> due = turned_faces_.Update(motion.camera_from_object, focal_px);
  // The published estimators are compared as they are.
  if (state() != TrackState::kTracking || context_.options.estimator_factory) return;
  if (due) {
    const ModelEdges::FacePlane& face = context_.edges->face_planes()[*due];
    hypotheses_.AddRival(MirroredState(motion, face.point, face.normal, focal_px, context_.options.initial),
                         Hypotheses::RivalKind::kSameEdges);
  } else if (tilt_test_.Update(motion.camera_from_object, rival_generator_.centroid(),
                               hypotheses_.first().spread_px())) {
    AddTiltedRivals();
  } else if (rival_schedule_.IsDue(window.t_end_us)) {
    AddGeneratedRivals(window.t_end_us);
  }
}

void ObjectTracker::AddTiltedRivals() {
  const InitializationOptions& options = context_.options.initialization;
  const std::vector<MotionState> rivals =
      rival_generator_.TiltedRivalsOf(hypotheses_.first().motion(), options.tilt_rad, context_.camera.MaxFocalPx(),
                                      context_.options.initial, options.merge_rad);
  for (const MotionState& rival : rivals) hypotheses_.AddRival(rival, Hypotheses::RivalKind::kTilted);
}

void ObjectTracker::AddGeneratedRivals(int64_t t_us) {
  const std::vector<MotionState> rivals = RivalsOf(hypotheses_.first().motion());
  const RivalSchedule::Group group = rival_schedule_.NextGroup(t_us, static_cast<int>(rivals.size()));
  for (int i = group.begin; i < group.end; ++i) {
    const MotionState& rival = rivals[static_cast<size_t>(i)];
    const bool is_unlikely = hypotheses_.HasRejected(rival.camera_from_object);
    hypotheses_.AddRival(rival, Hypotheses::RivalKind::kOtherEdges, is_unlikely ? RivalPrior::kUnlikely : group.prior);
  }
}

void ObjectTracker::StartRivalRounds(int64_t t_us, RivalPrior prior) {
  tilt_test_.Reset();
  rival_schedule_.StartRounds(t_us, prior);
}

void ObjectTracker::ContinueWithRival(int64_t t_us) {
  // The rounds go on with a tilted rival: the generated rivals of both poses are nearly the same.
  if (hypotheses_.is_first_tilted()) {
    tilt_test_.Reset();
  } else {
    StartRivalRounds(t_us, RivalPrior::kEqual);
  }
}

void ObjectTracker::AddRivalsOfLastHypothesis() {
  if (IsGiven(phase_) || hypotheses_.are_rivals_generated() || context_.options.estimator_factory) return;
  for (const MotionState& rival : RivalsOf(hypotheses_.first().motion())) {
    if (hypotheses_.HasRejected(rival.camera_from_object)) continue;
    hypotheses_.AddRival(rival, Hypotheses::RivalKind::kOtherEdges);
  }
  hypotheses_.MarkRivalsGenerated();
}

std::vector<MotionState> ObjectTracker::RivalsOf(const MotionState& state) const {
  return rival_generator_.RivalsOf(state, context_.camera.MaxFocalPx(), context_.options.initial,
                                   context_.options.initialization.merge_rad);
}

void ObjectTracker::AddEqualRivals(Hypotheses& hypotheses) {
  hypotheses.MarkRivalsGenerated();
  if (context_.options.estimator_factory) return;
  const MotionState start = hypotheses.first().motion();
  const std::vector<MotionState> all = RivalsOf(start);
  for (size_t next = 0; next < all.size();) next = AddEqualRivals(start, all, next, hypotheses);
}

size_t ObjectTracker::AddEqualRivals(const MotionState& start, const std::vector<MotionState>& all, size_t next,
                                     Hypotheses& hypotheses) {
  Hypotheses trial(context_);
  trial.Add(start);
  std::vector<std::pair<const PoseTrack*, MotionState>> rivals;
  for (; next < all.size() && !trial.is_full(); ++next) {
    rivals.emplace_back(trial.AddRival(all[next], Hypotheses::RivalKind::kOtherEdges), all[next]);
  }
  for (size_t i = 0; i < memory_.size() && trial.HasRival(); ++i) {
    const EventWindow past = memory_.At(i);
    if (past.t_mid_us() >= start.t_us) trial.OnWindow(past, OthersAt(past, nullptr));
  }
  for (const auto& [track, rival] : rivals) {
    if (!trial.Has(track)) continue;
    if (trial.HasSettled(track) && !hypotheses.is_full()) {
      hypotheses.Add(rival);
    } else {
      hypotheses.AddRival(rival, Hypotheses::RivalKind::kOtherEdges);  // there were too few windows to refine it
    }
  }
  return next;
}

}  // namespace evpose

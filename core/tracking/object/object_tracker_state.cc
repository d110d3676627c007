// SPDX-License-Identifier: Apache-2.0

// The saved state of one object. Its format is that of earlier versions: enums that replaced bools, optionals and other
// enums are stored as those.
#include <algorithm>
#include <optional>
#include <type_traits>

#include "core/tracking/object/object_tracker.h"

namespace evpose {

void ObjectTracker::VisitState(auto& archive, auto& self) {
  auto& [context, reference_rotation, memory, initializer, report, losses, last_tracked, last_published_us, given,
         search_schedule, hypotheses, followed_since_us, phase, acquisition, now_us, others, published_others,
         other_objects, past_states, rival_generator, turned_faces, tilt_test, rival_schedule] = self;
  constexpr int64_t kMaxUs = kMaxStateTimeUs;
  archive(memory);
  VisitAcquisition(archive, acquisition);
  archive(report, losses, last_tracked, last_published_us);
  VisitGivenPose(archive, given);
  archive(search_schedule, hypotheses, InRange(followed_since_us, -kMaxUs, kMaxUs),
          AtMost(phase, ObjectPhase::kPublishedCompeting), past_states, turned_faces, tilt_test, rival_schedule);
  bool is_published = IsPublished(phase);  // not used; it keeps the format of earlier versions
  archive(is_published, InRange(now_us, -kMaxUs, kMaxUs));
}

// Stored as the state of the API, of which only two are possible.
void ObjectTracker::VisitAcquisition(auto& archive, auto& acquisition) {
  TrackState state = ReportedState(acquisition);
  archive(AtMost(state, TrackState::kLost));
  archive.Check(state == TrackState::kInitializing || state == TrackState::kLost,
                "an object without a pose that is neither INITIALIZING nor LOST");
  if constexpr (std::remove_reference_t<decltype(archive)>::kReading) {
    acquisition = state == TrackState::kLost ? Acquisition::kAfterLoss : Acquisition::kFirst;
  }
}

// Stored as two optionals. Earlier versions kept the time after the pose had become a hypothesis.
void ObjectTracker::VisitGivenPose(auto& archive, auto& given) {
  std::optional<RigidTransform> pose;
  std::optional<int64_t> at_us;
  if (given) {
    pose = given->camera_from_object;
    at_us = given->at_us;
  }
  archive(pose, at_us);
  if constexpr (std::remove_reference_t<decltype(archive)>::kReading) {
    given.reset();
    if (pose) given = {*pose, at_us};
  }
}

void ObjectTracker::SaveState(StateWriter& writer) const { VisitState(writer, *this); }

void ObjectTracker::LoadState(StateReader& reader) {
  VisitState(reader, *this);
  reader.Check(IsConsistent(), "an object whose phase, hypotheses and past states contradict each other");
}

bool ObjectTracker::IsConsistent() const {
  if ((phase_ == ObjectPhase::kSearching) != hypotheses_.empty()) return false;
  if (given_ && phase_ != ObjectPhase::kSearching) return false;
  const int64_t given_at_us = given_ ? given_->at_us.value_or(0) : 0;
  if (given_at_us < -kMaxStateTimeUs || given_at_us > kMaxStateTimeUs) return false;
  const int num_curves = context_.edges->num_curves();
  return std::all_of(past_states_.begin(), past_states_.end(), [num_curves](const PastState& state) {
    const auto num_lines = static_cast<int>(state.lines.size());
    const auto is_index = [num_lines](int line) { return line >= -1 && line < num_lines; };
    return std::all_of(state.lines.begin(), state.lines.end(), [&](const TrackedLine& line) {
      return line.curve >= 0 && line.curve < num_curves && is_index(line.previous) && is_index(line.next);
    });
  });
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// One object in the windows of a stream: searched for, followed, lost and found again (core/tracking/README.md).
#pragma once

#include <cstdint>
#include <deque>
#include <limits>
#include <memory>
#include <optional>
#include <vector>

#include "core/association/competitors.h"
#include "core/initialization/initializer.h"
#include "core/tracking/hypotheses.h"
#include "core/tracking/track_phase.h"
#include "core/tracking/tracker.h"
#include "core/windows/event_window.h"
#include "core/windows/window_memory.h"

namespace evpose {

class ObjectTracker {
 public:
  // `initializer` may be null: the pose is only ever given. The pose in `object` is that at the first event.
  ObjectTracker(TrackContext context, std::unique_ptr<PoseInitializer> initializer, const ObjectToTrack& object);

  // The other objects of the stream, which must outlive it or be told nothing any more. They are asked where they were
  // before a window, so that the order in which objects take a window says nothing.
  void SetOthers(std::vector<const ObjectTracker*> others);

  // Before any object takes the next window: what the others are told of this one until then is settled.
  void BeginWindow();
  // Windows in order. Appends at most one estimate for this window; more when a search has looked back.
  void OnWindow(const EventWindow& window, std::vector<PoseEstimate>& estimates);
  // Between two windows.
  void OnGap(const EventGap& gap);
  // After the last window.
  void Finish();
  // Starts again from this pose at `at_us`; at the next window's begin without a time.
  void ResetPose(const RigidTransform& camera_from_object, std::optional<int64_t> at_us);

  // How fast the reported object's image moves at most, anywhere on it; 0 while no pose is reported.
  double ImageSpeedPxPerS() const;

  TrackState state() const;
  InitializationReport initialization() const { return report_; }
  uint32_t losses() const { return losses_; }

  // Between windows. Into one of the same object, camera and options; after a failure (reader.status()) it must not be
  // used.
  void SaveState(StateWriter& writer) const;
  void LoadState(StateReader& reader);

 private:
  // Where the reported pose was, and which lines showed it.
  struct Sighting {
    MotionState motion;
    std::vector<TrackedLine> lines;
    static void VisitState(auto& archive, auto& self) {
      auto& [motion, lines] = self;
      archive(motion, lines);
    }
  };
  static void VisitState(auto& archive, auto& self);
  // Whether what was read, each number of it possible, is possible together.
  bool IsConsistent() const;

  void StartFromGivenPose(const EventWindow& window);
  void Follow(const EventWindow& window, std::vector<PoseEstimate>& estimates);
  // What the others lay claim to in a window; null when there is nothing. `near` limits it to those whose image comes
  // near this object there.
  const Competitors* OthersAt(const EventWindow& window, const MotionState* near);
  // This object where it is predicted for t_us from what was known before; not while no pose is reported.
  void AddTo(int64_t t_us, const std::optional<BoundingSphere>& near, Competitors& competitors) const;
  BoundingSphere SphereAt(const RigidTransform& camera_from_object) const;
  // Whether another object of the same model is reported at this place: it is one and the same.
  bool IsTaken(const PoseTrack& track) const;
  void Remember(const EventWindow& window);
  // Whether the first hypothesis may be reported now.
  bool MayPublish(const EventWindow& window) const;
  void StartPublishing(const EventWindow& window);
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
  // The pose that was reported, or given, was rejected.
  void CountLoss();
  // The one place where the phase changes.
  void Enter(ObjectInput input);

  const TrackContext context_;
  const Eigen::Matrix3d reference_rotation_;
  const BoundingSphere sphere_;  // object frame
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
  ObjectPhase phase_ = ObjectPhase::kSearching;

  std::vector<const ObjectTracker*> others_;
  std::unique_ptr<Competitors> competitors_;  // null without others
  // Of the windows that a search may look back on, in order of time; empty without others.
  std::deque<Sighting> sightings_;
  bool is_known_ = false;  // a pose was reported before this window: the others reckon with this object

  std::vector<PixelEvent> pixel_events_;
};

}  // namespace evpose

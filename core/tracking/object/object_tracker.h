// SPDX-License-Identifier: Apache-2.0

// One object in the windows of a stream: search, tracking, loss and renewed search (core/tracking/README.md).
#pragma once

#include <cstdint>
#include <deque>
#include <limits>
#include <memory>
#include <optional>
#include <vector>

#include "absl/types/span.h"
#include "core/association/other_objects.h"
#include "core/initialization/initializer.h"
#include "core/tracking/object/hypotheses.h"
#include "core/tracking/object/object_outline.h"
#include "core/tracking/object/object_to_track.h"
#include "core/tracking/object/rival_schedule.h"
#include "core/tracking/object/rivals.h"
#include "core/tracking/object/search_schedule.h"
#include "core/tracking/object/track_phase.h"
#include "core/windows/event_window.h"
#include "core/windows/window_memory.h"

namespace evpose {

// Follows the hypotheses about one object and publishes at most one pose per window. Not thread-safe.
class ObjectTracker {
 public:
  // Largest number of past states that are kept for the other objects. They are 2.5 ms apart, so that this number
  // covers the memory of the search, 1 s.
  static constexpr size_t kMaxPastStates = 403;

  // `initializer` may be null: every pose is then given, because the caller wants it or because no edge of the model is
  // visible from any side. The pose in `object` is that at the first event.
  ObjectTracker(TrackContext context, std::unique_ptr<PoseInitializer> initializer, const ObjectToTrack& object);

  // Sets the other objects of the stream, which must be alive whenever this one processes a window. Their states before
  // the window are used. The order of the objects matters only if two objects of one model come to the same place: the
  // first one in the order is tested first.
  void SetOthers(std::vector<const ObjectTracker*> others);

  // To be called for all objects before any of them processes the next window: finds the others that are published.
  void BeginWindow();
  // Processes windows in order of time. Appends at most one estimate for this window, and those of past windows after a
  // search.
  void OnWindow(const EventWindow& window, std::vector<PoseEstimate>& estimates);
  // To be called between two windows.
  void OnGap(const EventGap& gap);
  // To be called after the last window.
  void Finish();
  // Restarts from this pose at `at_us`, or at the beginning of the next window without a time.
  void ResetPose(const RigidTransform& camera_from_object, std::optional<int64_t> at_us);

  // Reports the transitions of the object and of its hypotheses from now on.
  void SetPhaseListener(PhaseListener listener);

  // Upper bound of the image speed of any point of the published object; 0 while no pose is published.
  double ImageSpeedPxPerS() const;

  TrackState state() const;
  InitializationReport initialization() const;
  uint32_t losses() const { return losses_; }
  // See Tracker::Outline().
  bool Outline(ObjectOutline& outline) const;

  // To be called between windows. LoadState() requires the same object, camera and options; after a failure
  // (reader.status()) the tracker must not be used.
  void SaveState(StateWriter& writer) const;
  void LoadState(StateReader& reader);

 private:
  // A past state of the first hypothesis, and the lines that were visible then.
  struct PastState {
    MotionState motion;
    std::vector<TrackedLine> lines;
    static void VisitState(auto& archive, auto& self) {
      auto& [motion, lines] = self;
      archive(motion, lines);
    }
  };
  // A pose that becomes the only hypothesis in the next window.
  struct GivenPose {
    RigidTransform camera_from_object;
    std::optional<int64_t> at_us;  // its time; absent: the beginning of that window
  };
  static void VisitState(auto& archive, auto& self);
  static void VisitGivenPose(auto& archive, auto& given);
  static void VisitAcquisition(auto& archive, auto& acquisition);
  // Whether the values that were read, each of them valid, are valid together.
  bool IsConsistent() const;

  void StartFromGivenPose(const EventWindow& window);
  void Follow(const EventWindow& window, std::vector<PoseEstimate>& estimates);
  // The other published objects in a window; null when there are none. `near` restricts them to those whose image is
  // near this object in that state.
  const OtherObjects* OthersAt(const EventWindow& window, const MotionState* near);
  // Adds this object at its prediction for t_us from earlier states.
  void AddTo(int64_t t_us, const std::optional<BoundingSphere>& near, OtherObjects& other_objects) const;
  BoundingSphere SphereAt(const RigidTransform& camera_from_object) const;
  // Whether another object of the same model is published at this place: both would be the same physical object.
  bool IsOccupied(const PoseTrack& track) const;
  void StorePastState(const EventWindow& window);
  void StartPublishing(const EventWindow& window);
  void Search(const EventWindow& window, std::vector<PoseEstimate>& estimates);
  // Adds rivals of the published pose: the mirrored one when a face of the object has passed the position in which it
  // is seen edge-on, the tilted ones when the view has turned, and the generated ones at intervals.
  void AddRivals(const EventWindow& window);
  void AddTiltedRivals();
  void AddGeneratedRivals(int64_t t_us);
  // Starts the tests of the generated rivals of a pose that is published from now on.
  void StartRivalRounds(int64_t t_us, RivalPrior prior);
  // Starts the tests of the rivals of a rival that is published from now on.
  void ContinueWithRival(int64_t t_us);
  // Adds the generated rivals of the last remaining hypothesis, unless they have been tested: a pose that was preferred
  // to others may still have rivals.
  void AddRivalsOfLastHypothesis();
  std::vector<MotionState> RivalsOf(const MotionState& state) const;
  // Adds the generated rivals of the first of `hypotheses`, which is in its start state, that explain the stored events
  // as well as it does, to decide between them before one is published.
  void AddEqualRivals(Hypotheses& hypotheses);
  // The same for those of the rivals from `next` on that are followed together. Returns the first one that is left.
  size_t AddEqualRivals(const MotionState& start, const std::vector<MotionState>& all, size_t next,
                        Hypotheses& hypotheses);
  // Returns whether a search is allowed while hypotheses exist.
  bool MaySearchAgain() const;
  // Searches beside the present hypotheses and adds the poses that are found as competing ones.
  void SearchAgain(const EventWindow& window);
  // Searches in the stored events and adds the poses that are found as hypotheses. Returns the reason if there are
  // none, and counts the result.
  InitializationStatus FindHypotheses(Hypotheses& hypotheses);
  // Returns the status if the region of `events` is absent or too small for a search, and counts it; else nullopt.
  std::optional<InitializationStatus> WhyTooFewEdges(absl::Span<const PixelEvent> events);
  // Returns the stored events, undistorted. Not kept between searches, because the objects of a stream search in turn.
  std::vector<PixelEvent> CollectEvents();
  // Returns the pose to which a found pose is compared: among the poses that are equal by the symmetry of the object,
  // the one nearest to its rotation is chosen. It is the last tracked pose, predicted, or else the reference rotation.
  RigidTransform ReferenceAt(int64_t t_us) const;
  MotionState StartState(const FirstPose& first) const;
  void Publish(PoseEstimate estimate, std::vector<PoseEstimate>& estimates);
  // Calls Enter() with an input by which the object may be lost. If it is lost, stores the cause and the time, and
  // starts the counts and intervals of its searches anew.
  void Reject(ObjectInput input, LossCause cause);
  // Applies the transition functions and reports the transition. No other function changes the phase and the
  // acquisition.
  void Enter(ObjectInput input);

  const TrackContext context_;
  const Eigen::Matrix3d reference_rotation_;
  WindowMemory memory_;
  const std::unique_ptr<PoseInitializer> initializer_;  // null: every pose is given

  InitializationReport report_;
  uint32_t losses_ = 0;
  std::optional<MotionState> last_tracked_;
  int64_t last_published_us_ = std::numeric_limits<int64_t>::min();
  std::optional<GivenPose> given_;
  SearchSchedule search_schedule_;

  Hypotheses hypotheses_;
  int64_t followed_since_us_ = 0;
  ObjectPhase phase_ = ObjectPhase::kSearching;
  Acquisition acquisition_ = Acquisition::kFirst;
  int64_t now_us_ = 0;  // end of the latest window or gap, for the reports of transitions and losses only

  std::vector<const ObjectTracker*> others_;
  std::vector<const ObjectTracker*> published_others_;  // those that were published before this window
  std::unique_ptr<OtherObjects> other_objects_;         // null without others
  // Past states for the stored windows, in order of time; empty without other objects.
  std::deque<PastState> past_states_;
  const RivalGenerator rival_generator_;
  TurnedFaceDetector turned_faces_;
  TiltTestTrigger tilt_test_;
  RivalSchedule rival_schedule_;
};

}  // namespace evpose

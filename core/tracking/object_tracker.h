// One object in the windows of a stream: searched for, followed, lost and found again (method.md 2.3 to 2.9).
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <vector>

#include "core/initialization/initializer.h"
#include "core/tracking/hypotheses.h"
#include "core/tracking/tracker.h"
#include "core/windows/event_window.h"
#include "core/windows/window_memory.h"

namespace evpose {

class ObjectTracker {
 public:
  // `initializer` may be null: the pose is only ever given. The pose in `object` is that at the first event.
  ObjectTracker(TrackContext context, std::unique_ptr<PoseInitializer> initializer, const ObjectToTrack& object);

  // Windows in order. Appends at most one estimate for this window; more when a search has looked back.
  void OnWindow(const EventWindow& window, std::vector<PoseEstimate>& estimates);
  // After the last window.
  void Finish();
  // Starts again from this pose at `at_us`; at the next window's begin without a time.
  void ResetPose(const RigidTransform& camera_from_object, std::optional<int64_t> at_us);

  TrackState state() const;
  InitializationReport initialization() const { return report_; }
  uint32_t losses() const { return losses_; }

 private:
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
  const Eigen::Matrix3d reference_rotation_;
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

}  // namespace evpose

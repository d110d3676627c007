// SPDX-License-Identifier: Apache-2.0

// Output of the tracker: the state of the track of an object, its pose, and the progress of its initialization.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "core/base/state_io.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

// The states, in the order of the numbers of the API. They are described in core/tracking/README.md, section 3.
enum class TrackState { kInitializing, kTracking, kDegraded, kLost, kAmbiguous };
inline constexpr int kNumTrackStates = 5;
std::string_view TrackStateName(TrackState state);  // "INITIALIZING", "TRACKING", "DEGRADED", "LOST", "AMBIGUOUS"

// Progress of the initialization, or the reason why there is no pose.
enum class InitializationStatus {
  kNotNeeded,         // a pose is tracked
  kWaitingForEvents,  // too few events: nothing is in view, or the object is at rest
  kTooFewLines,       // fewer than three lines were detected
  kNoPoseFits,        // lines were detected, but no pose of the model fits them
  kVerifying,         // a pose, found or given, is being tested against the events
  kAmbiguous,         // several poses explain the events equally well so far
  kNotSearchable,     // no edge of the model is visible from any side; a pose must be given
  kNotEnoughMotion,   // edges were detected, but they moved by less than a pixel
  kTooSmall,          // fewer than three lines were detected, and the events lie in a region too small for them
  kNotSupported,      // a pose was found or given, and the events do not support it
};
inline constexpr InitializationStatus kLastInitializationStatus = InitializationStatus::kNotSupported;
std::string_view InitializationStatusName(InitializationStatus status);  // "NOT_NEEDED", "WAITING_FOR_EVENTS", ...

// Why a published or given pose was rejected.
enum class LossCause {
  kNone,          // no pose has been rejected
  kContradicted,  // the events contradicted it
  kUncertain,     // its uncertainty exceeded HealthOptions::max_uncertainty_px, or there was no usable fit
  kOutOfView,     // the same, with all of its edges outside the image
  kBetterPose,    // another pose explains the events significantly better
  kOccupied,      // another object with the same model is tracked at its place
  kUnconfirmed,   // the stream ended before the events confirmed the given pose
};

// Searches by their result, since the start or the latest loss. A search that found poses is counted as such even if
// the events rejected them later.
struct SearchCounts {
  uint64_t no_signal = 0;  // no region has more events than the noise
  uint64_t too_small = 0;
  uint64_t too_few_lines = 0;
  uint64_t not_enough_motion = 0;
  uint64_t no_pose_fits = 0;
  uint64_t poses_found = 0;

  friend bool operator==(const SearchCounts&, const SearchCounts&) = default;
  static void VisitState(auto& archive, auto& self) {
    auto& [no_signal, too_small, too_few_lines, not_enough_motion, no_pose_fits, poses_found] = self;
    archive(no_signal, too_small, too_few_lines, not_enough_motion, no_pose_fits, poses_found);
  }
};
// Returns the result of most searches, as the reason for the absence of a pose; among equal counts the one that came
// nearest to a pose; kWaitingForEvents without any search.
InitializationStatus MostFrequentResult(const SearchCounts& searches);

struct InitializationReport {
  InitializationStatus status = InitializationStatus::kWaitingForEvents;
  uint64_t attempts = 0;  // searches for the pose so far
  int num_lines = 0;      // detected by the latest search
  SearchCounts searches;
  int extent_px = 0;  // extent of the region of the events (EventExtentPx) in the latest search without enough lines
  int num_poses = 0;  // the first pose, and those that are compared with it
  LossCause loss_cause = LossCause::kNone;  // cause of the latest loss
  int64_t lost_at_us = 0;                   // its sensor time

  static void VisitState(auto& archive, auto& self) {
    auto& [status, attempts, num_lines, searches, extent_px, num_poses, loss_cause, lost_at_us] = self;
    archive(AtMost(status, kLastInitializationStatus), attempts, num_lines, searches, extent_px, num_poses,
            AtMost(loss_cause, LossCause::kUnconfirmed), lost_at_us);
  }
};

// Another pose that explains the events, beside the one that is reported.
struct PoseAlternative {
  RigidTransform camera_from_object;
  // Natural logarithm of the likelihood of this pose divided by that of the reported one; 0 means equally likely
  // (core/tracking/README.md, equation (4)).
  double log_likelihood_ratio = 0.0;

  static void VisitState(auto& archive, auto& self) {
    auto& [camera_from_object, log_likelihood_ratio] = self;
    archive(camera_from_object, Finite(log_likelihood_ratio));
  }
};

// The most likely alternatives, in decreasing order. They are stored inline, because poses are made without allocation.
class PoseAlternatives {
 public:
  // Real ambiguities have two to four poses (PoseSearchOptions::max_hypotheses); more would enlarge every pose.
  static constexpr size_t kMaxSize = 4;

  // Inserts an alternative behind those that are at least as likely; the least likely one beyond kMaxSize is dropped.
  void Add(const PoseAlternative& alternative) {
    size_t at = size_;
    while (at > 0 && items_[at - 1].log_likelihood_ratio < alternative.log_likelihood_ratio) --at;
    if (at == kMaxSize) return;
    size_ = std::min<uint32_t>(size_ + 1, kMaxSize);
    std::copy_backward(items_.begin() + at, items_.begin() + size_ - 1, items_.begin() + size_);
    items_[at] = alternative;
  }
  size_t size() const { return size_; }
  bool empty() const { return size_ == 0; }
  const PoseAlternative& operator[](size_t index) const { return items_[index]; }
  const PoseAlternative* begin() const { return items_.data(); }
  const PoseAlternative* end() const { return items_.data() + size_; }

  static void VisitState(auto& archive, auto& self) {
    auto& [items, size] = self;
    archive(AtMost(size, uint32_t{kMaxSize}));
    for (size_t i = 0; i < size; ++i) archive(items[i]);
  }

 private:
  std::array<PoseAlternative, kMaxSize> items_;
  uint32_t size_ = 0;
};

// Pose of one object at one time, in the notation of the Pose message of the API. Covariance and twist of a published
// pose are numbers of single precision (core/geometry/single_precision.h).
struct PoseEstimate {
  uint32_t object_index = 0;
  // Sensor time of the pose: the middle of the window, where its uncertainty is smallest (core/estimation/README.md,
  // section 2).
  int64_t t_us = 0;
  RigidTransform camera_from_object;
  // Covariance of [tx ty tz rx ry rz], m^2, m rad and rad^2, left perturbation. Along the free directions of an object
  // with a continuous symmetry it has the variance kFreeAngleVarianceRad2 (core/estimation/README.md, equation (14)).
  Matrix6d covariance = Matrix6d::Zero();
  Vector6d twist = Vector6d::Zero();  // [vx vy vz wx wy wz]: dT/dt = v, dR/dt = [w]x R, m/s and rad/s
  TrackState state = TrackState::kInitializing;
  uint32_t num_events = 0;       // events in the gates of the lines, without downsampling
  float explained_ratio = 0.0f;  // share of the gated events that the lines explain
  float residual_rms_px = 0.0f;
  PoseAlternatives alternatives;  // empty unless the state is kAmbiguous and other poses have been compared
  // The object's latest loss before this pose, as in InitializationReport. Set when the pose is published.
  LossCause loss_cause = LossCause::kNone;
  int64_t lost_at_us = 0;

  // The loss is not saved: the estimates in the state of a tracker are not published again.
  static void VisitState(auto& archive, auto& self) {
    auto& [object_index, t_us, pose, covariance, twist, state, num_events, explained_ratio, residual_rms_px,
           alternatives, loss_cause, lost_at_us] = self;
    archive(object_index, t_us, pose, covariance, twist, AtMost(state, TrackState::kAmbiguous), num_events,
            explained_ratio, residual_rms_px, alternatives);
  }
};

}  // namespace evpose

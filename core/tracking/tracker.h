// SPDX-License-Identifier: Apache-2.0

// Events in, poses of one object or several out: windows, prediction, association, estimation, health (method.md 2).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/base/state_io.h"
#include "core/events/event.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"
#include "core/windows/event_window.h"

namespace evpose {

struct CameraTables;
class SearchModel;

enum class TrackState { kInitializing, kTracking, kDegraded, kLost };
std::string_view TrackStateName(TrackState state);  // "INITIALIZING", "TRACKING", "DEGRADED", "LOST"

enum class Estimator {
  kMixture,  // pose and twist in the window, normal + uniform mixture, soft association, motion prior
  // For comparison. The paper's: one pose per window, hard association with its gates; its formulas corrected.
  kStaticLs,
  kStaticM,
  kStaticS,
  kStaticMm,
  kErrorStateFilter,  // event by event, with the motion prior, as line-SLAM with events does
  // The static ones as the paper's released code computes: no visibility, no prediction (method.md 2.6).
  kReleasedLs,
  kReleasedM,
  kReleasedS,
  kReleasedMm,
};
// Every estimator and what it is called where people choose one.
inline constexpr std::pair<Estimator, std::string_view> kEstimatorNames[] = {
    {Estimator::kMixture, "mixture"},        {Estimator::kStaticLs, "static-ls"},
    {Estimator::kStaticM, "static-m"},       {Estimator::kStaticS, "static-s"},
    {Estimator::kStaticMm, "static-mm"},     {Estimator::kErrorStateFilter, "error-state-filter"},
    {Estimator::kReleasedLs, "released-ls"}, {Estimator::kReleasedM, "released-m"},
    {Estimator::kReleasedS, "released-s"},   {Estimator::kReleasedMm, "released-mm"},
};

// Why there is no pose yet.
enum class InitializationStatus {
  kNotNeeded,         // a pose is tracked
  kWaitingForEvents,  // too few: nothing is in view, or what is there stands still
  kTooFewLines,       // events, but fewer than three lines in them
  kNoPoseFits,        // lines, but the model fits them in no pose that the events support
  kVerifying,         // the events are being asked about a pose, found or given
  kAmbiguous,         // two poses explain the events equally well so far
};
std::string_view InitializationStatusName(InitializationStatus status);  // "NOT_NEEDED", "WAITING_FOR_EVENTS", ...

struct InitializationReport {
  InitializationStatus status = InitializationStatus::kWaitingForEvents;
  uint64_t attempts = 0;  // searches for the pose so far
  int num_lines = 0;      // that the last of them saw

  static void VisitState(auto& archive, auto& self) {
    auto& [status, attempts, num_lines] = self;
    archive(AtMost(status, InitializationStatus::kAmbiguous), attempts, num_lines);
  }
};

// Every field of it is in tracker_options.h with unit, default and reason.
struct TrackerOptions;

// What to look for in the events.
struct ObjectToTrack {
  std::shared_ptr<const ObjectModel> model;  // shared: many sessions, and many objects of one, track the same model
  // The pose at the first event; without one it is found from the events.
  std::optional<RigidTransform> initial_camera_from_object;
  // camera_from_object. Of the poses that a symmetric object cannot tell apart, the one nearest to this is reported.
  Eigen::Matrix3d reference_rotation = Eigen::Matrix3d::Identity();
  std::shared_ptr<const SearchModel> search_model;  // of the model; null: made when it is needed

  // INVALID_ARGUMENT saying what is wrong with the model, or naming the field.
  absl::Status Validate() const;
};

// One estimate, in the notation of the API's Pose message.
struct PoseEstimate {
  uint32_t object_index = 0;
  int64_t t_us = 0;  // the time the pose is for: the events' mid-window, where it is best known (method.md 2.8)
  RigidTransform camera_from_object;
  Matrix6d covariance = Matrix6d::Zero();  // of [tx ty tz rx ry rz], m and rad, left perturbation
  Vector6d twist = Vector6d::Zero();       // [vx vy vz wx wy wz]: dT/dt = v, dR/dt = w^ R, m/s and rad/s
  TrackState state = TrackState::kInitializing;
  uint32_t num_events = 0;       // in the gate
  float explained_ratio = 0.0f;  // share of the gated events that the lines explain
  float residual_rms_px = 0.0f;

  static void VisitState(auto& archive, auto& self) {
    auto& [object_index, t_us, pose, covariance, twist, state, num_events, explained_ratio, residual_rms_px] = self;
    archive(object_index, t_us, pose, covariance, twist, AtMost(state, TrackState::kLost), num_events, explained_ratio,
            residual_rms_px);
  }
};

// Tracks the objects of one stream of events side by side, window by window: they share its windows (EventWindower) and
// its events. Not thread-safe; deterministic: the estimates depend on the events and options alone, not on how the
// events are cut into calls. Memory is bounded whatever the event rate.
class Tracker {
 public:
  // 1 or more objects; PoseEstimate::object_index counts them from 0. Errors: INVALID_ARGUMENT naming the field of
  // options, camera or object that is wrong. `tables` are those of the camera; null: made here.
  static absl::StatusOr<std::unique_ptr<Tracker>> Create(std::vector<ObjectToTrack> objects, const CameraModel& camera,
                                                         const TrackerOptions& options,
                                                         std::shared_ptr<const CameraTables> tables = nullptr);
  // Of one object.
  static absl::StatusOr<std::unique_ptr<Tracker>> Create(
      std::shared_ptr<const ObjectModel> model, const CameraModel& camera, const TrackerOptions& options,
      const std::optional<RigidTransform>& initial_camera_from_object);
  virtual ~Tracker() = default;

  // Events in order of time (a step back is tolerated: such an event joins the open window). Appends the estimates of
  // all windows that these events close: by window, then by object. A LOST or INITIALIZING object has none: no pose is
  // claimed.
  virtual void AddEvents(absl::Span<const Event> events, std::vector<PoseEstimate>& estimates) = 0;
  // The sensor's clock has reached t_us without further events (a TimeMark): windows close on time.
  virtual void AdvanceTime(int64_t t_us, std::vector<PoseEstimate>& estimates) = 0;
  // Time went on to t_us, and these events came meanwhile, but there is no time to look at them. What the open window
  // has is given up, too; the next one begins at the gap's end. Nothing is concluded from what was not looked at,
  // neither that an object moved nor that it rested: its uncertainty grows with the time, and it is LOST when that is
  // too much.
  virtual EventGap Skip(absl::Span<const Event> events, int64_t t_us) = 0;
  // End of the stream: closes what is open.
  virtual void Finish(std::vector<PoseEstimate>& estimates) = 0;
  // The caller knows better: that object starts again from this pose at the present time.
  virtual void ResetPose(size_t object_index, const RigidTransform& camera_from_object) = 0;

  virtual size_t num_objects() const = 0;
  virtual TrackState state(size_t object_index) const = 0;
  virtual InitializationReport initialization(size_t object_index) const = 0;
  virtual uint32_t losses(size_t object_index) const = 0;  // changes to LOST so far

  // All that later estimates depend on, bit for bit. A state is loaded into a tracker made of the same objects, camera
  // and options, before anything else; after a failure (reader.status()) the tracker must not be used.
  virtual void SaveState(StateWriter& writer) const = 0;
  virtual void LoadState(StateReader& reader) = 0;

  // The same of the first object, which is often the only one.
  void ResetPose(const RigidTransform& camera_from_object) { ResetPose(0, camera_from_object); }
  TrackState state() const { return state(0); }
  InitializationReport initialization() const { return initialization(0); }
  uint32_t losses() const { return losses(0); }
};

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// Output of the tracker: the state of the track of an object, its pose, and the progress of its initialization.
#pragma once

#include <cstdint>
#include <string_view>

#include "core/base/state_io.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

enum class TrackState { kInitializing, kTracking, kDegraded, kLost };
std::string_view TrackStateName(TrackState state);  // "INITIALIZING", "TRACKING", "DEGRADED", "LOST"

// Progress of the initialization, or the reason why there is no pose.
enum class InitializationStatus {
  kNotNeeded,         // a pose is tracked
  kWaitingForEvents,  // too few events: nothing is in view, or the object is at rest
  kTooFewLines,       // fewer than three lines were detected
  kNoPoseFits,        // lines were detected, but no pose of the model fits them and is supported by the events
  kVerifying,         // a pose, found or given, is being tested against the events
  kAmbiguous,         // two poses explain the events equally well so far
  kNotSearchable,     // no edge of the model is visible from any side; a pose must be given
};
std::string_view InitializationStatusName(InitializationStatus status);  // "NOT_NEEDED", "WAITING_FOR_EVENTS", ...

struct InitializationReport {
  InitializationStatus status = InitializationStatus::kWaitingForEvents;
  uint64_t attempts = 0;  // searches for the pose so far
  int num_lines = 0;      // detected by the latest search

  static void VisitState(auto& archive, auto& self) {
    auto& [status, attempts, num_lines] = self;
    archive(AtMost(status, InitializationStatus::kNotSearchable), attempts, num_lines);
  }
};

// Pose of one object at one time, in the notation of the Pose message of the API.
struct PoseEstimate {
  uint32_t object_index = 0;
  // Sensor time of the pose: the middle of the window, where its uncertainty is smallest (core/estimation/README.md,
  // section 2).
  int64_t t_us = 0;
  RigidTransform camera_from_object;
  // Covariance of [tx ty tz rx ry rz], m^2, m rad and rad^2, left perturbation. Along the free directions of an object
  // with a continuous symmetry it has the variance kFreeAngleVarianceRad2 (core/estimation/README.md, equation (13)).
  Matrix6d covariance = Matrix6d::Zero();
  Vector6d twist = Vector6d::Zero();  // [vx vy vz wx wy wz]: dT/dt = v, dR/dt = w^ R, m/s and rad/s
  TrackState state = TrackState::kInitializing;
  uint32_t num_events = 0;       // events in the gates of the lines, without downsampling
  float explained_ratio = 0.0f;  // share of the gated events that the lines explain
  float residual_rms_px = 0.0f;

  static void VisitState(auto& archive, auto& self) {
    auto& [object_index, t_us, pose, covariance, twist, state, num_events, explained_ratio, residual_rms_px] = self;
    archive(object_index, t_us, pose, covariance, twist, AtMost(state, TrackState::kLost), num_events, explained_ratio,
            residual_rms_px);
  }
};

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// For tests: events as the tracker's own model of them says, without a simulator. Each event lies on a visible line at
// its own time, but for a normal error and the rounding to pixels; clutter is uniform over the sensor.
#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "core/estimation/sensor_profile.h"
#include "core/events/event.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose::testing {

// A cube with 12 lines about the origin.
std::shared_ptr<const ObjectModel> MakeCube(double edge_m);
CameraModel MakeCamera(int width_px, int height_px, double focal_px);

// Pose at a time in seconds.
using Motion = std::function<RigidTransform(double t_s)>;

// From `start`, constant twist: T = T0 + v t, R = exp(w t) R0.
Motion ConstantTwist(const RigidTransform& start, const Vector6d& twist);
RigidTransform MakePose(const Eigen::Vector3d& translation_m, const Eigen::Vector3d& rotation_rad);

struct IdealEventOptions {
  double events_per_px2 = 2.0;    // of the area that lines sweep
  double sigma_px = 0.5;          // across the line
  double clutter_per_s = 50'000;  // over the whole sensor
  int64_t t_begin_us = 0;
  int64_t duration_us = 100'000;
  uint64_t seed = 1;
  // Whether something stands before the pixel at a time in seconds from t_begin_us: its events are left out.
  std::function<bool(const Eigen::Vector2d& pixel, double t_s)> is_hidden;
};

// The profile of a sensor whose events lie on their lines, as ideal ones do.
SensorProfile UnbiasedSensor();

// A model before the camera hides pixels from what lies behind it. Keeps a reference to the model.
std::function<bool(const Eigen::Vector2d& pixel, double t_s)> HiddenBehind(const ObjectModel& model,
                                                                           const CameraModel& camera, Motion motion);

// The events of several streams, each in order of time, in order of time.
std::vector<Event> MergeEvents(const std::vector<std::vector<Event>>& streams);

// In order of time. The object must be convex: a line shows when one of its faces is turned to the camera.
std::vector<Event> MakeIdealEvents(const ObjectModel& model, const CameraModel& camera, const Motion& motion,
                                   const IdealEventOptions& options);

}  // namespace evpose::testing

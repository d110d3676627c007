// SPDX-License-Identifier: Apache-2.0

// For tests: events that follow the tracker's model exactly, without a simulator. Each event lies on a visible line at
// its own time, with a normal error across the line and rounding to pixels; clutter is uniform over the sensor.
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

// Returns a cube with 12 lines, centred at the origin.
std::shared_ptr<const ObjectModel> MakeCube(double edge_m);
CameraModel MakeCamera(int width_px, int height_px, double focal_px);

// Pose (camera_from_object) at a time in seconds.
using Motion = std::function<RigidTransform(double t_s)>;

// Motion with constant twist from `start`: T = T0 + v t, R = exp(w t) R0.
Motion ConstantTwist(const RigidTransform& start, const Vector6d& twist);
RigidTransform MakePose(const Eigen::Vector3d& translation_m, const Eigen::Vector3d& rotation_rad);

struct IdealEventOptions {
  double events_per_px2 = 2.0;    // events per square pixel that a line sweeps
  double sigma_px = 0.5;          // standard deviation across the line
  double clutter_per_s = 50'000;  // events of the clutter per second over the whole sensor
  int64_t t_begin_us = 0;
  int64_t duration_us = 100'000;
  uint64_t seed = 1;
  // Returns whether an occluder covers the pixel at a time in seconds from t_begin_us; events there are omitted. Null:
  // there is no occluder.
  std::function<bool(const Eigen::Vector2d& pixel, double t_s)> is_hidden;
};

// Returns the profile of a sensor without edge bias, as that of the ideal events, which is known exactly.
SensorProfile UnbiasedSensor();

// Returns IdealEventOptions::is_hidden for a model that moves between the camera and the object. The model must outlive
// it.
std::function<bool(const Eigen::Vector2d& pixel, double t_s)> HiddenBehind(const ObjectModel& model,
                                                                           const CameraModel& camera, Motion motion);

// Merges several streams, each in order of time, into one in order of time.
std::vector<Event> MergeEvents(const std::vector<std::vector<Event>>& streams);

// Returns the events in order of time. The straight lines must be those of a convex object: a line is visible when one
// of its faces is turned towards the camera. Curves and contours are those of an EdgeElementExtractor with short
// chords.
std::vector<Event> MakeIdealEvents(const ObjectModel& model, const CameraModel& camera, const Motion& motion,
                                   const IdealEventOptions& options);

}  // namespace evpose::testing

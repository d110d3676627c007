// SPDX-License-Identifier: Apache-2.0

// Helpers of the tests of this folder: a camera, a cube, and the options of a tracker for ideal events.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "core/estimation/ideal_events_testing.h"
#include "core/models/symmetry.h"
#include "core/tracking/object/tracker_options.h"

namespace evpose {

inline const CameraModel kCamera = testing::MakeCamera(640, 480, 600.0);
// First pose of the cube in most tests.
inline const RigidTransform kStart = testing::MakePose({0.02, -0.01, 0.6}, {0.6, 0.5, 0.2});

// Velocity in m/s and angular velocity in rad/s.
inline Vector6d Twist(double vx, double vy, double vz, double wx, double wy, double wz) {
  Vector6d twist;
  twist << vx, vy, vz, wx, wy, wz;
  return twist;
}

// A cube with its symmetries, which MakeCube() leaves out.
inline std::shared_ptr<const ObjectModel> Cube(double edge_m = 0.15) {
  auto cube = std::make_shared<ObjectModel>(*testing::MakeCube(edge_m));
  cube->symmetries = FindSymmetries(*cube);
  return cube;
}

// Ideal events of the model's lines, with the clutter of IdealEventOptions.
inline std::vector<Event> EventsOf(const ObjectModel& model, const testing::Motion& motion, int64_t t_begin_us,
                                   int64_t duration_us, uint64_t seed = 1) {
  testing::IdealEventOptions options;
  options.t_begin_us = t_begin_us;
  options.duration_us = duration_us;
  options.seed = seed;
  return testing::MakeIdealEvents(model, kCamera, motion, options);
}

// Uniform clutter without events of lines.
inline std::vector<Event> Noise(double rate_hz, int64_t t_begin_us, int64_t duration_us, uint64_t seed = 1) {
  testing::IdealEventOptions options;
  options.events_per_px2 = 0.0;
  options.clutter_per_s = rate_hz;
  options.t_begin_us = t_begin_us;
  options.duration_us = duration_us;
  options.seed = seed;
  const testing::Motion rest = testing::ConstantTwist(kStart, Vector6d::Zero());
  return testing::MakeIdealEvents(*testing::MakeCube(0.15), kCamera, rest, options);
}

// Options for ideal events, which have neither lag nor shift.
inline TrackerOptions IdealSensor() {
  TrackerOptions options;
  options.sensor = testing::UnbiasedSensor();
  return options;
}

// Options for ideal events and given poses; a lost object is not searched for.
inline TrackerOptions WithoutInitialization() {
  TrackerOptions options = IdealSensor();
  options.initialization.is_automatic = false;
  return options;
}

}  // namespace evpose

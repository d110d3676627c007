// SPDX-License-Identifier: Apache-2.0

// Directions from which an object is looked at, distinct modulo its symmetries.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "core/models/object_model.h"

namespace evpose {

struct ViewSphere {
  // Unit vectors from the centre of the object to the camera, object frame. The first `num_coarse` of them are a coarse
  // sampling of the same set.
  std::vector<Eigen::Vector3d> directions;
  int num_coarse = 0;
  // Whether turns about the line of sight are the same view: the object is a sphere.
  bool is_turn_free = false;
};

// Vertices of an icosahedron whose triangles are divided `subdivisions` times, at least once (three times: 642
// directions, 7 to 9 degrees apart), without those that a rotation of the object maps to the vicinity of another one.
// The coarse ones are those of one division less. For an object with an axis: a meridian in steps of 6 degrees.
ViewSphere MakeViewSphere(const ObjectModel& model, int subdivisions);

}  // namespace evpose

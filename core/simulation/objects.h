// SPDX-License-Identifier: Apache-2.0

// The simulated objects: their models for the tracker, and their surfaces and paint for the renderer.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"
#include "core/simulation/scene.h"

namespace evpose {

// A flat polygon painted on a surface. `under` is the reflectance of the covered paint: the renderer adds polygons, so
// that paint contributes the difference.
struct Paint {
  std::vector<Eigen::Vector3d> outline;  // object frame, metres; the winding of its surface
  double reflectance = 0.0;
  double under = 0.0;
};

struct Surface {
  std::vector<Eigen::Vector3d> outline;  // object frame, metres; counter-clockwise seen from outside
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  double reflectance = 0.0;
  std::vector<Paint> paints;
};

// A convex solid, or a plate: its surfaces that face the camera never hide one another.
struct Body {
  std::vector<Surface> surfaces;
  // This body lies in the half space normal . X > offset, and every later body of the object in the other one. The side
  // of the camera determines the order of painting. Not used in the last body.
  Eigen::Vector3d separator_normal = Eigen::Vector3d::UnitZ();
  double separator_offset_m = 0.0;
};

struct SceneObject {
  ObjectModel model;                                   // without its faces for a model of the user
  std::vector<Body> bodies;                            // empty for a model of the user
  std::vector<Eigen::Vector3d> extremes;               // points whose convex hull contains the object
  Eigen::Vector3d centre_m = Eigen::Vector3d::Zero();  // object frame; the motion is that of this point
  double radius_m = 0.0;                               // radius of the sphere about the centre that contains the object
  Eigen::Matrix3d view_from_object = Eigen::Matrix3d::Identity();  // an attitude in which most faces are visible
};

// Makes an object with the longest side `size_m`, positive.
SceneObject MakeSceneObject(SimulatedObject object, double size_m);

// The place and the size of a model with faces; its attitude is random.
SceneObject MakeModelObject(const ObjectModel& model, uint64_t seed);

// Returns the indices of the bodies from the farthest to the nearest, for a camera position in the object frame.
std::vector<int> PaintersOrder(const std::vector<Body>& bodies, const Eigen::Vector3d& camera_object);

}  // namespace evpose

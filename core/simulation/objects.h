// SPDX-License-Identifier: Apache-2.0

// The simulated objects: what they are (model) and how they look (surfaces and paint).
#pragma once

#include <Eigen/Core>
#include <vector>

#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"
#include "core/simulation/scene.h"

namespace evpose {

// A flat polygon painted on a surface. `under` is the reflectance of what it covers: pictures are sums, so paint adds
// the difference.
struct Paint {
  std::vector<Eigen::Vector3d> outline;  // object frame, metres; wound like its surface
  double reflectance = 0.0;
  double under = 0.0;
};

struct Surface {
  std::vector<Eigen::Vector3d> outline;  // object frame, metres; counter-clockwise seen from outside
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  double reflectance = 0.0;
  std::vector<Paint> paints;
};

// A convex solid, or a plate: of its surfaces, those that face the camera never hide one another.
struct Body {
  std::vector<Surface> surfaces;
  // This body lies where normal . X > offset, every later body of the object where it is less: the painter's order
  // follows from the side that the camera is on. Unused in the last body.
  Eigen::Vector3d separator_normal = Eigen::Vector3d::UnitZ();
  double separator_offset_m = 0.0;
};

struct SceneObject {
  ObjectModel model;
  std::vector<Body> bodies;
  double radius_m = 0.0;  // of the sphere about the origin that holds the object
  Eigen::Matrix3d view_from_object = Eigen::Matrix3d::Identity();  // an attitude that shows it well
};

// `size_m`: its longest side, positive.
SceneObject MakeSceneObject(SimulatedObject object, double size_m);

// Indices of the bodies from the farthest to the nearest, for a camera at this place in the object frame.
std::vector<int> PaintersOrder(const std::vector<Body>& bodies, const Eigen::Vector3d& camera_object);

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// The surface that a mesh approximates: regions without creases, with the normals of the surface and, where one fits,
// the plane, cylinder, cone or sphere (core/mesh/README.md).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

namespace evpose {

enum class RegionShape : uint8_t { kPlane, kCylinder, kCone, kSphere, kFree };

// A connected part of the surface that no crease crosses.
struct SurfaceRegion {
  RegionShape shape = RegionShape::kFree;
  Eigen::Vector3d point = Eigen::Vector3d::Zero();  // plane, cylinder: on it, on its axis; cone: apex; sphere: centre
  Eigen::Vector3d axis = Eigen::Vector3d::Zero();   // unit; plane: outward normal; cone: from the apex into the cone
  double radius_m = 0.0;                            // cylinder, sphere
  double half_angle_rad = 0.0;                      // cone: between axis and surface
  // False: the outward normals point towards the axis or centre, as on the wall of a hole.
  bool is_convex = true;

  // A flat region has no contour.
  bool is_flat() const { return shape == RegionShape::kPlane; }
};

// The surface of a mesh; the lists have the order of its triangles.
struct SmoothSurface {
  std::vector<uint32_t> region_of;                      // index into `regions`
  std::vector<std::array<Eigen::Vector3f, 3>> normals;  // outward unit normals of the surface at the corners
  std::vector<SurfaceRegion> regions;

  bool empty() const { return regions.empty(); }
};

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// The surface of a model as the search for symmetries compares it: by what lies on it, not by its triangles.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "core/models/object_model.h"
#include "core/models/triangle_bvh.h"

namespace evpose {

// Points on the surface with its normals, and points just beyond the rims of its faces that do not lie on it. A
// rotation maps the surface onto itself when the first fall on the surface, and the second do not. However the faces
// are cut into triangles, the answer is the same. Immutable.
class CentredSurface {
 public:
  // Of a large mesh, some thousands of triangles give samples, spread over all of them. Without triangles every
  // rotation will do.
  CentredSurface(const ObjectModel& model, const Eigen::Vector3d& centre, double tolerance_m);

  bool IsMappedOntoItself(const Eigen::Matrix3d& rotation) const;

 private:
  struct Sample {
    Eigen::Vector3d point;   // from the centre, metres
    Eigen::Vector3d normal;  // zero: of no weight, the triangle is too small for it
    bool is_on_surface;
  };
  void AddSamples(const std::vector<Eigen::Vector3d>& points, const std::array<uint32_t, 3>& triangle,
                  std::vector<Sample>& samples) const;
  // Whether a face is that near to the point and, unless the normal is zero, looks the same way.
  bool IsNear(const Eigen::Vector3d& point, const Eigen::Vector3d& normal, double distance_m) const;

  double tolerance_m_;
  TriangleBvh faces_;
  std::vector<Sample> samples_;  // neighbours far apart: a wrong rotation is found out soon
};

}  // namespace evpose

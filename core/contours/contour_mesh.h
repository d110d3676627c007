// SPDX-License-Identifier: Apache-2.0

// The triangles of curved regions, and the occluding contours on them (core/contours/README.md, sections 1 and 2).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <limits>
#include <vector>

#include "absl/types/span.h"
#include "core/contours/rim_point.h"
#include "core/models/object_model.h"

namespace evpose {

// Successive points of one contour, on one region.
struct RimChain {
  uint32_t region = 0;  // number among the curved regions
  uint32_t begin = 0;   // points [begin, end)
  uint32_t end = 0;
  bool is_ring = false;  // the last point is the first one again
  // True for a contour between facets of the object: its points are connected by straight edges, and have no radius.
  bool is_faceted = false;
};

struct Rims {
  std::vector<RimPoint> points;
  std::vector<RimChain> chains;
};

// Subtracts the heights of the eye along `count` normals, given by coordinate, from `heights`, those of points of the
// surface. `is_back` gets 1 where the rest is not negative: the surface there does not face the eye.
void SubtractEye(const double* x, const double* y, const double* z, const Eigen::Vector3d& eye, size_t count,
                 double* heights, uint8_t* is_back);

// Immutable after construction. Keeps a reference: `model` must outlive it.
class ContourMesh {
 public:
  explicit ContourMesh(const ObjectModel& model);

  uint32_t num_regions() const { return num_regions_; }  // curved ones
  // Finds the contours for the camera centre `eye`, in the order of the triangles. A segment between successive points
  // is divided if its sagitta has an angular size above `max_sagitta_rad` at the camera.
  void FindRims(const Eigen::Vector3d& eye, double max_sagitta_rad, Rims& rims) const;

 private:
  static constexpr uint32_t kNone = std::numeric_limits<uint32_t>::max();
  struct Triangle {
    std::array<uint32_t, 3> corners;     // indices of points and normals that are shared within a region
    std::array<uint32_t, 3> neighbours;  // across the edges from corner k to k + 1: 3 * triangle + edge, or kNone
    uint32_t region;                     // index into the regions of the model
  };
  struct Crossing {
    uint32_t triangle;
    uint8_t in, out;  // the edges at which the contour enters and leaves
    bool is_visited;
  };
  struct EyeHeights;  // the eye, and n . (p - eye) at each corner p with the normal n

  void AddTriangles(const std::vector<uint32_t>& curved_number);
  void LinkTriangles();
  // The triangles through which contours pass, in ascending order.
  std::vector<Crossing> FindCrossings(const EyeHeights& eye_heights) const;
  void FollowContour(const EyeHeights& eye_heights, absl::Span<Crossing> crossings, size_t first, Rims& rims) const;
  Eigen::Vector3d CrossingOfEdge(const EyeHeights& eye_heights, const Triangle& triangle, int edge) const;
  // Curvature of the surface along the ray, 1/m.
  double CurvatureAlongRay(const EyeHeights& eye_heights, const Triangle& triangle, const Eigen::Vector3d& ray) const;
  // The contour point at barycentric coordinates; `other` is the second triangle at an edge, or the same one.
  RimPoint MakeRimPoint(const EyeHeights& eye_heights, const Triangle& triangle, const Triangle& other,
                        const Eigen::Vector3d& barycentric) const;
  void AppendDivided(const EyeHeights& eye_heights, const Triangle& triangle, const Eigen::Vector3d& from,
                     const Eigen::Vector3d& to, const RimPoint& end, Rims& rims) const;

  const ObjectModel& model_;
  uint32_t num_regions_ = 0;
  std::vector<uint32_t> region_number_;  // number of each region of the model among the curved ones
  std::vector<Triangle> triangles_;
  std::vector<std::array<uint32_t, 3>> corners_of_;  // those of `triangles_`, without gaps for the search
  std::vector<Eigen::Vector3d> points_;
  std::array<std::vector<double>, 3> normals_;  // by coordinate
  std::vector<double> heights_m_;               // normal . point
};

}  // namespace evpose

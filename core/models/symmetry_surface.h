// SPDX-License-Identifier: Apache-2.0

// The surface of a model for the search for symmetries, as sample points that do not depend on its triangulation, and
// the search for a model that has nothing else.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/mesh/triangle_bvh.h"
#include "core/models/object_model.h"

namespace evpose {

// Largest distance, metres, between the sides of the triangles and the smooth surface whose normals turn from one end
// to the other: of a circular arc of length L and angle a, the sagitta is L a / 8. At most 1 % of the diameter.
double AllowedSagitta(const ObjectModel& model);

// Sample points on the surface, with normals, and points just beyond the rims of its faces, which are not on it. A
// rotation maps the surface onto itself if it maps the former onto the surface and the latter off it. Immutable.
class CentredSurface {
 public:
  // Samples some thousands of triangles of a large mesh, evenly. A model without triangles accepts every rotation.
  CentredSurface(const ObjectModel& model, const Eigen::Vector3d& centre, double tolerance_m);

  // Adds the number of tested samples to `samples`. Returns false when it reaches `max_samples`.
  // `witness` is the index of the sample that is tested first and becomes that of the one that fails: a sample that
  // contradicts one rotation often contradicts the next one, too.
  bool IsMappedOntoItself(const Eigen::Matrix3d& rotation, int64_t max_samples, int64_t& samples,
                          size_t& witness) const;
  // The same for several rotations that are symmetries together: each sample is tested with one of them in turn.
  bool IsMappedOntoItself(absl::Span<const Eigen::Matrix3d> rotations, int64_t max_samples, int64_t& samples) const;

 private:
  struct Sample {
    Eigen::Vector3d point;   // from the centre, metres
    Eigen::Vector3d normal;  // zero if it is not compared: of an edge, or of a triangle that is too small
    bool is_on_surface;
  };
  void AddSamples(const std::vector<Eigen::Vector3d>& points, const std::array<uint32_t, 3>& triangle,
                  std::vector<Sample>& samples) const;
  bool IsMapped(const Sample& sample, const Eigen::Matrix3d& rotation) const;
  // Whether a face is within the distance of the point and, unless the normal is zero, has a similar normal.
  bool IsNear(const Eigen::Vector3d& point, const Eigen::Vector3d& normal, double distance_m) const;

  double tolerance_m_;
  TriangleBvh faces_;
  std::vector<Sample> samples_;  // successive ones are far apart, so that a wrong rotation is rejected early
};

// The symmetries of a model without edges.
struct SurfaceGroup {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  // centroid of the area, which every symmetry keeps in place
  std::vector<Eigen::Matrix3d> rotations;            // the identity first
  int64_t num_samples = 0;                           // number of searches for the image of a point of the surface
  bool was_cut_short = false;                        // `max_samples` was reached
};
// Either rotations about one axis by equal steps, at most 16, and half turns about axes perpendicular to it; or half
// turns about three perpendicular axes. Objects with several axes of higher order, such as a rounded cube, keep the
// identity only. `tolerance_m` is that of exact surfaces; the sagitta of the facets is added.
SurfaceGroup FindSurfaceGroup(const ObjectModel& model, double tolerance_m, int64_t max_samples);

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// Samples of the edges and of the surface of a model, with directions, for the search for near-symmetries
// (near_symmetries.h).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/models/object_model.h"

namespace evpose {

struct OrientedSample {
  Eigen::Vector3d point;      // object frame, metres
  Eigen::Vector3d direction;  // unit: along an edge, either sign; or the outward normal of the surface
  // Share of the visible edges of all views, up to a common factor: 1 on an edge; on the surface its mean curvature,
  // 1/m, to which the expected length of contours is proportional. 0 on flat parts.
  double weight = 1.0;
};

// Samples at equal steps of the length of all lines and curves, and of the area of all triangles, in their order. The
// spacing is that between neighbours, metres: at least a small share of the diameter, and such that there are at most
// 20,000 samples.
double EdgeSpacing(const ObjectModel& model);
std::vector<OrientedSample> SampleEdges(const ObjectModel& model);
double SurfaceSpacing(const ObjectModel& model);
std::vector<OrientedSample> SampleSurface(const ObjectModel& model);

// Directions, unit, about which rotations are tested: the principal axes of either set of samples, the directions of
// the longest lines and of the largest areas, and the diagonals between the former. None is within 3 degrees of an
// earlier one or its opposite.
std::vector<Eigen::Vector3d> CandidateAxes(const ObjectModel& model, absl::Span<const OrientedSample> edges,
                                           absl::Span<const OrientedSample> surface);

// Finds the nearest sample in the same direction. Immutable.
class OrientedIndex {
 public:
  // `max_reach_m`: upper bound of the reach of Nearest().
  OrientedIndex(std::vector<OrientedSample> samples, bool is_surface, double max_reach_m);

  absl::Span<const OrientedSample> samples() const { return samples_; }
  // Returns the nearest sample with a direction that differs by less than 20 degrees from that of `sample`; null if no
  // such sample is within `reach_m`.
  const OrientedSample* Nearest(const OrientedSample& sample, double reach_m) const;
  // The projection onto the directions in which a distance from the sample counts: across an edge, or along a normal.
  Eigen::Matrix3d Across(const OrientedSample& sample) const;

 private:
  std::array<int, 3> CellOf(const Eigen::Vector3d& point) const;
  size_t Number(const std::array<int, 3>& cell) const {
    return (static_cast<size_t>(cell[2]) * static_cast<size_t>(sizes_[1]) + static_cast<size_t>(cell[1])) *
               static_cast<size_t>(sizes_[0]) +
           static_cast<size_t>(cell[0]);
  }

  std::vector<OrientedSample> samples_;
  bool is_surface_;
  double cell_m_;
  Eigen::Vector3d low_ = Eigen::Vector3d::Zero();
  std::array<int, 3> sizes_ = {1, 1, 1};
  std::vector<uint32_t> begin_;    // of each cell in `by_cell_`
  std::vector<uint32_t> by_cell_;  // indices of samples
};

}  // namespace evpose

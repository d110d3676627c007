// SPDX-License-Identifier: Apache-2.0

// The lines and curves of a model as circles about an axis, for the search for continuous symmetries.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/models/object_model.h"

namespace evpose {

// Rotations about an axis map lines and curves onto themselves if and only if they are complete circles about it, or
// lie on it. Immutable.
class AxialRings {
 public:
  // `axis` is a unit vector, `tolerance_m` the largest distance between equal points.
  AxialRings(const ObjectModel& model, const Eigen::Vector3d& centre, const Eigen::Vector3d& axis, double tolerance_m);

  // Share of the length of all lines and curves that is neither part of a complete circle nor on the axis; 0 without
  // any.
  double broken_ratio() const { return length_m_ > 0.0 ? broken_m_ / length_m_ : 0.0; }
  // Whether half turns about the axes through the centre that are perpendicular to `axis` map circles onto circles.
  bool AreFlippable() const;

 private:
  // Part of a circle, which is identified by the cell of its radius and of its height along the axis.
  struct Arc {
    EdgeKind kind;
    int64_t radius_cell;
    int64_t height_cell;
    double begin_rad, end_rad;  // in [-pi, pi]
    double radius_m, height_m;
    double length_m;
  };
  struct Polar {
    double radius_m, height_m, angle_rad;
  };
  static bool IsBefore(const Arc& a, const Arc& b);
  Polar ToPolar(const Eigen::Vector3d& point) const;
  int64_t Cell(double coordinate_m) const;
  // `may_bend`: the segment is a chord of a curve, whose distance from the chord is not compared.
  void AddSegment(const Eigen::Vector3d& p1, const Eigen::Vector3d& p2, EdgeKind kind, bool may_bend);
  void AddArc(Arc arc, double begin_rad, double turn_rad);
  // Adds the length of the incomplete circles to broken_m_.
  void CountIncomplete();
  // Appends the arcs whose circle is within one cell.
  void FindNear(EdgeKind kind, int64_t radius_cell, int64_t height_cell, std::vector<Arc>& found) const;
  // Whether the arcs cover all angles.
  bool CoverAll(std::vector<Arc>& arcs) const;

  const Eigen::Vector3d centre_, axis_;
  Eigen::Vector3d first_, second_;  // perpendicular to the axis and to each other
  const double tolerance_m_;
  double length_m_ = 0.0;
  double broken_m_ = 0.0;
  bool has_one_sided_axis_line_ = false;  // a line on the axis that the half turns do not map onto itself
  std::vector<Arc> arcs_;                 // sorted
};

}  // namespace evpose

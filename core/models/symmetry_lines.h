// SPDX-License-Identifier: Apache-2.0

// The lines and curves of a model relative to its centre, for the search for symmetries.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "absl/types/span.h"
#include "core/models/object_model.h"

namespace evpose {

// The segments of a model. Lines with matching faces that continue each other or overlap are one segment, so that the
// division of an edge into lines has no effect. A curve with ends is four segments between points at equal lengths
// along it, a ring one segment along its axis, to both sides of its centre as long as its radius. Immutable.
class CentredSegments {
 public:
  // `max_tolerance_m`: upper bound of the tolerance of Find().
  CentredSegments(const ObjectModel& model, double max_tolerance_m);

  // The centre of the length of lines and curves (core/models/README.md, equation (1)), which every symmetry keeps in
  // place. Object frame, metres.
  const Eigen::Vector3d& centre() const { return centre_; }
  absl::Span<const ModelLine> segments() const { return segments_; }

  struct Match {
    size_t index = 0;
    bool is_reversed = false;  // p1 is mapped onto p2
  };
  // The segment onto which `rotation` maps the given one: the nearest one with both ends within the tolerance and with
  // matching normals, made of the same kind of edge. nullopt if there is none.
  std::optional<Match> Find(const Eigen::Matrix3d& rotation, size_t segment, double tolerance_m) const;
  // Points at equal steps along a ring that is no circle; empty for other segments.
  absl::Span<const Eigen::Vector3d> outline(size_t segment) const { return outlines_[segment]; }
  // The lobes of a ring that is no circle are its parts that are farther from an axis through the centre than the mean
  // of the largest and the least distance, by `least_m`. Returns the angles of their middles about the axis, from
  // axis.unitOrthogonal().
  std::vector<double> LobesOf(size_t segment, const Eigen::Vector3d& axis, double least_m) const;

 private:
  enum class Origin : uint8_t { kLine, kCurve, kRing };
  // To be called before the segments are centred.
  void AddCurve(const EdgeCurve& curve, double tolerance_m);
  uint64_t Cell(const Eigen::Vector3d& point, const Eigen::Vector3d& offset, int corner) const;

  Eigen::Vector3d centre_ = Eigen::Vector3d::Zero();
  std::vector<ModelLine> segments_;  // relative to the centre
  std::vector<Origin> origins_;      // origin of each segment
  std::vector<std::vector<Eigen::Vector3d>> outlines_;
  double cell_m_;
  std::vector<std::pair<uint64_t, uint32_t>> grid_;  // cell of the midpoint, segment; sorted
};

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// The lines of a model about its centre, as the search for symmetries compares them.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "absl/types/span.h"
#include "core/models/object_model.h"

namespace evpose {

struct CentredSegment {
  Eigen::Vector3d p1;  // from the centre, metres
  Eigen::Vector3d p2;
  std::vector<Eigen::Vector3d> normals;
};

// Lines that continue each other or overlap, with the same faces, are one segment: an edge drawn in two parts is the
// edge. Immutable.
class CentredSegments {
 public:
  // `max_tolerance_m`: the largest that Find() will be asked for.
  CentredSegments(const ObjectModel& model, double max_tolerance_m);

  // Of the lines' length: every motion that maps the lines onto themselves leaves it where it is. Object frame, metres.
  const Eigen::Vector3d& centre() const { return centre_; }
  absl::Span<const CentredSegment> segments() const { return segments_; }

  struct Match {
    size_t index = 0;
    bool is_reversed = false;  // p1 falls on p2
    double distance_m = 0.0;   // of the ends that are farther apart
  };
  // The segment that `rotation` maps this one to: the nearest with both ends within the tolerance, and whose faces
  // look the same way. None: there is no such segment.
  std::optional<Match> Find(const Eigen::Matrix3d& rotation, size_t segment, double tolerance_m) const;

 private:
  uint64_t Cell(const Eigen::Vector3d& point, const Eigen::Vector3d& offset, int corner) const;
  void BuildGrid();

  Eigen::Vector3d centre_ = Eigen::Vector3d::Zero();
  std::vector<CentredSegment> segments_;
  double cell_m_;
  std::vector<std::pair<uint64_t, uint32_t>> grid_;  // cell of the midpoint, segment; sorted
};

}  // namespace evpose

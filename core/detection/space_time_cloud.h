// SPDX-License-Identifier: Apache-2.0

// The events of one polarity as points (u, v, c t), and the neighbours of each point.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/detection/event_stretch.h"

namespace evpose {

// Returns one point for each cell with the side `cell_px` that has an event: the mean of its events, pixels, with
// c = `px_per_s`. More than `max_points` points are downsampled uniformly. The order is that of the cells and does not
// depend on that of the events' times.
std::vector<Eigen::Vector3f> SpaceTimePoints(const EventStretch& stretch, uint8_t polarity, double px_per_s,
                                             double cell_px, int max_points);

// The nearest neighbours of each point, including the point itself: at most `max_neighbours` within `radius` (pixels).
class NeighbourTable {
 public:
  NeighbourTable(const std::vector<Eigen::Vector3f>& points, double radius, int max_neighbours);

  absl::Span<const int32_t> Of(size_t point) const {
    return absl::MakeConstSpan(neighbours_).subspan(begin_[point], begin_[point + 1] - begin_[point]);
  }
  // Returns the table of the points for which `is_kept` is true, with new indices.
  NeighbourTable Restricted(const std::vector<bool>& is_kept) const;

 private:
  NeighbourTable() = default;

  std::vector<size_t> begin_;
  std::vector<int32_t> neighbours_;
};

}  // namespace evpose

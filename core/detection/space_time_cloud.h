// SPDX-License-Identifier: Apache-2.0

// Events of one polarity as points (u, v, c t), and which of them are neighbours.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/detection/event_stretch.h"

namespace evpose {

// One point for each cell of the given side that holds an event: the mean of its events. c = `px_per_s`. The cells of
// at most about `max_points` points are kept, chosen by their place. In order of cells.
std::vector<Eigen::Vector3f> SpaceTimePoints(const EventStretch& stretch, uint8_t polarity, double px_per_s,
                                             double cell_px, int max_points);

// For each point its nearest neighbours, itself among them: at most `max_neighbours` within `radius`.
class NeighbourTable {
 public:
  NeighbourTable(const std::vector<Eigen::Vector3f>& points, double radius, int max_neighbours);

  absl::Span<const int32_t> Of(size_t point) const {
    return absl::MakeConstSpan(neighbours_).subspan(begin_[point], begin_[point + 1] - begin_[point]);
  }
  // The table of the points for which `is_kept` alone.
  NeighbourTable Restricted(const std::vector<bool>& is_kept) const;

 private:
  NeighbourTable() = default;

  std::vector<size_t> begin_;
  std::vector<int32_t> neighbours_;
};

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// A spatial index of the events of a stretch.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/detection/event_stretch.h"

namespace evpose {

class EventGrid {
 public:
  // Indexes the events of the selected polarities (OFF, ON). The order in which Near() returns events does not depend
  // on the selection.
  explicit EventGrid(const std::vector<StretchEvent>& events, std::array<bool, 2> is_polarity = {true, true});

  // Appends the indices of all events within `reach_px` of the segment, and of some events up to a cell (8 px) farther.
  void Near(const Eigen::Vector2d& p1_px, const Eigen::Vector2d& p2_px, double reach_px,
            std::vector<int32_t>& indices) const;

 private:
  int Column(double u_px) const;
  int Row(double v_px) const;

  double low_u_px_ = 0.0;
  double low_v_px_ = 0.0;
  int columns_ = 0;
  int rows_ = 0;
  std::vector<int32_t> begin_;   // start of each cell in sorted_, row by row, and the end
  std::vector<int32_t> sorted_;  // indices of events, cell by cell
};

}  // namespace evpose

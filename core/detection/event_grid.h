// SPDX-License-Identifier: Apache-2.0

// The events of a stretch by their place in the image.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/detection/event_stretch.h"

namespace evpose {

class EventGrid {
 public:
  // Of those polarities. Of whichever they are, they come in the same order.
  explicit EventGrid(const std::vector<StretchEvent>& events, std::array<bool, 2> is_polarity = {true, true});

  // Appends the indices of all events within `reach_px` of the segment, and some that are a cell farther.
  void Near(const Eigen::Vector2d& p1_px, const Eigen::Vector2d& p2_px, double reach_px,
            std::vector<int32_t>& indices) const;

 private:
  int Column(double u_px) const;
  int Row(double v_px) const;

  double low_u_px_ = 0.0;
  double low_v_px_ = 0.0;
  int columns_ = 0;
  int rows_ = 0;
  std::vector<int32_t> begin_;   // of each cell in indices_, row by row
  std::vector<int32_t> sorted_;  // indices of events, cell by cell
};

}  // namespace evpose

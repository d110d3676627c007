// SPDX-License-Identifier: Apache-2.0
#include "core/numerics/connected_cells.h"

#include <algorithm>

#include "core/base/yield_point.h"

namespace evpose {

std::vector<std::vector<size_t>> ConnectedCells(int columns, int rows, const std::vector<bool>& is_set) {
  std::vector<std::vector<size_t>> groups;
  std::vector<bool> is_waiting = is_set;  // set and not yet in a group
  std::vector<size_t> open;
  for (size_t first = 0; first < is_set.size(); ++first) {
    YieldPoint(first);
    if (!is_waiting[first]) continue;
    std::vector<size_t>& group = groups.emplace_back();
    open = {first};
    is_waiting[first] = false;
    while (!open.empty()) {
      YieldPoint(group.size());
      const size_t cell = open.back();
      open.pop_back();
      group.push_back(cell);
      const int column = static_cast<int>(cell % static_cast<size_t>(columns));
      const int row = static_cast<int>(cell / static_cast<size_t>(columns));
      for (int y = std::max(0, row - 1); y <= std::min(rows - 1, row + 1); ++y) {
        for (int x = std::max(0, column - 1); x <= std::min(columns - 1, column + 1); ++x) {
          const size_t next = static_cast<size_t>(y) * static_cast<size_t>(columns) + static_cast<size_t>(x);
          if (!is_waiting[next]) continue;
          is_waiting[next] = false;
          open.push_back(next);
        }
      }
    }
  }
  return groups;
}

}  // namespace evpose

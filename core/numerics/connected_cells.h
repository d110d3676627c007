// SPDX-License-Identifier: Apache-2.0

// Connected cells of a grid.
#pragma once

#include <cstddef>
#include <vector>

namespace evpose {

// Divides the cells that are set into groups of connected ones, where a cell is connected with its 8 neighbours. Cells
// are numbered by row. The groups are in the order of their first cells; within a group the first cell is the first,
// and the others follow in an order that depends on the cells only. `is_set` has columns * rows values.
std::vector<std::vector<size_t>> ConnectedCells(int columns, int rows, const std::vector<bool>& is_set);

}  // namespace evpose

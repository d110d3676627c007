// SPDX-License-Identifier: Apache-2.0

// The cell of a line: the part of its gate in which no other line is nearer. Each event is counted for its nearest
// line, so that a line has a share of uniform clutter in proportion to its cell and not to its gate
// (core/association/README.md, section 6).
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "absl/types/span.h"
#include "core/association/association.h"

namespace evpose {

// Returns the distance from line A at which line B becomes nearer, README, equation (13), for a point at the distance
// `own_px` (>= 0) from A that moves away from it; infinite if none. `other_px` is the signed distance of the point from
// B with |other_px| >= own_px, and `cosine` that between the direction of motion and the gradient of other_px.
inline double CellBoundaryPx(double own_px, double other_px, double cosine) {
  constexpr double kParallel = 1e-3;  // B moves away as fast as A: the border is beyond every gate
  const double approach = other_px < 0.0 ? -cosine : cosine;
  if (1.0 - approach < kParallel) return std::numeric_limits<double>::infinity();
  return (std::abs(other_px) - approach * own_px) / (1.0 - approach);
}

// Widths of the cell of one line.
struct LineCell {
  // More places give the area of a cell more exactly, and the time of FindCells() is proportional to their number.
  static constexpr int kPlaces = 4;  // equally spaced along the line; those of an element are equal
  // Distance to the border of the cell at each place, on the side of negative and of positive distances.
  std::array<std::array<float, 2>, kPlaces> border_px;
};

// Computes the cells of all lines of the grid. Borders are exact up to half of the reach of the grid; beyond it the
// tiles list only some of the lines.
void FindCells(const TileGrid& grid, absl::Span<const ImageLine> lines, std::vector<LineCell>& cells);

// Returns the area, in square pixels, of the part of the gate of line `index` that lies in its cell. Without `cells`
// (empty) no other line is near. The sum over the lines is the area of the union of their gates.
double GateAreaPx2(absl::Span<const LineCell> cells, absl::Span<const ImageLine> lines, size_t index, double gate_px);

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/association/line_cells.h"

#include "core/base/yield_point.h"

namespace evpose {
namespace {

using Borders = std::array<float, 2>;

// The borders of the cell of line `index` at a point on it.
Borders BordersAt(const TileGrid& grid, absl::Span<const ImageLine> lines, size_t index,
                  const Eigen::Vector2d& point_px) {
  // Pixels beyond its end up to which another line takes events from this one: half of a tile, so that lines that meet
  // in a corner do.
  constexpr double kEndPx = 4.0;
  Borders borders = {std::numeric_limits<float>::infinity(), std::numeric_limits<float>::infinity()};
  const uint32_t tile = grid.TileOf(point_px.x(), point_px.y());
  if (tile == TileGrid::kNoTile || !grid.has_lines(tile)) return borders;
  const Eigen::Vector2d& direction = lines[index].direction;
  for (const uint16_t other : grid.Lines(tile)) {
    const ImageLine& line = lines[other];
    if (other == index || !line.in_view()) continue;
    const double distance_px =
        (point_px.y() - line.p1_px.y()) * line.direction.x() - (point_px.x() - line.p1_px.x()) * line.direction.y();
    if (!line.Spans(line.AlongPx(point_px.x(), point_px.y()), distance_px, kEndPx, 0.0)) continue;
    const double cosine = direction.dot(line.direction);
    borders[0] = std::min(borders[0], static_cast<float>(CellBoundaryPx(0.0, distance_px, -cosine)));
    borders[1] = std::min(borders[1], static_cast<float>(CellBoundaryPx(0.0, distance_px, cosine)));
  }
  return borders;
}

}  // namespace

void FindCells(const TileGrid& grid, absl::Span<const ImageLine> lines, std::vector<LineCell>& cells) {
  cells.clear();
  for (size_t k = 0; k < lines.size(); ++k) {
    YieldPoint(k);
    LineCell& cell = cells.emplace_back();
    if (!lines[k].in_view()) continue;
    const int num_places = lines[k].is_element ? 1 : LineCell::kPlaces;
    for (int i = 0; i < num_places; ++i) {
      cell.border_px[i] = BordersAt(grid, lines, k, lines[k].PointAt((i + 0.5) / num_places));
    }
    for (int i = num_places; i < LineCell::kPlaces; ++i) cell.border_px[i] = cell.border_px[0];
  }
}

double GateAreaPx2(absl::Span<const LineCell> cells, absl::Span<const ImageLine> lines, size_t index, double gate_px) {
  if (!lines[index].in_view()) return 0.0;
  if (cells.empty()) return 2.0 * gate_px * lines[index].length_px;
  double width_px = 0.0;
  for (const Borders& borders : cells[index].border_px) {
    for (const float border_px : borders) width_px += std::min(gate_px, static_cast<double>(border_px));
  }
  return width_px / LineCell::kPlaces * lines[index].length_px;
}

}  // namespace evpose

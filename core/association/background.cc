// SPDX-License-Identifier: Apache-2.0
#include "core/association/background.h"

#include <algorithm>

#include "core/numerics/statistics.h"

namespace evpose {

BackgroundRate::BackgroundRate(const CameraModel& camera) {
  const TileGrid grid(camera);
  const auto cell_columns = static_cast<size_t>(grid.cell_columns());
  const size_t num_cells = grid.num_cells();
  cell_events_.resize(num_cells);
  line_tiles_.resize(num_cells);
  cells_.resize(num_cells);
  on_sensor_.resize(num_cells);
  constexpr double kCellPx = TileGrid::kCellTiles * TileGrid::kTilePx;
  for (size_t i = 0; i < num_cells; ++i) {
    const size_t column = i % cell_columns;
    const size_t row = i / cell_columns;
    const double left = static_cast<double>(column) * kCellPx - TileGrid::kMarginPx;
    const double top = static_cast<double>(row) * kCellPx - TileGrid::kMarginPx;
    on_sensor_[i] = left >= 0.0 && top >= 0.0 && left + kCellPx <= camera.width_px && top + kCellPx <= camera.height_px;
  }
}

void BackgroundRate::CloseWindow(const TileGrid& grid, double duration_s) {
  // Ten events determine a cell's rate to about a third, and the median over the cells much better; the memory is then
  // as short as possible, so that a sudden change of the rate is followed at once.
  constexpr double kMemoryEventsPerCell = 10.0;
  std::fill(line_tiles_.begin(), line_tiles_.end(), 0);
  for (const uint32_t tile : grid.tiles_with_lines()) ++line_tiles_[TileGrid::CellOf(tile)];

  double remembered = 0.0, counted = 0.0;
  for (size_t i = 0; i < cells_.size(); ++i) {
    remembered += cells_[i].events;
    counted += cell_events_[i];
  }
  const double memory = kMemoryEventsPerCell * static_cast<double>(cells_.size());
  const double keep = remembered > 0.0 ? std::clamp((memory - counted) / remembered, 0.0, 1.0) : 1.0;
  for (size_t i = 0; i < cells_.size(); ++i) {
    const double px2 = (TileGrid::kTilesPerCell - line_tiles_[i]) * TileGrid::kTilePx * TileGrid::kTilePx;
    cells_[i].events = keep * cells_[i].events + cell_events_[i];
    cells_[i].px2_s = keep * cells_[i].px2_s + px2 * duration_s;
  }
  std::fill(cell_events_.begin(), cell_events_.end(), 0.0);
  rates_.clear();
  for (size_t i = 0; i < cells_.size(); ++i) {
    if (on_sensor_[i] && cells_[i].px2_s > 0.0) rates_.push_back(cells_[i].events / cells_[i].px2_s);
  }
  hz_per_px_ = rates_.empty() ? 0.0 : UpperMedian(rates_);
}

}  // namespace evpose

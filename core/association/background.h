// SPDX-License-Identifier: Apache-2.0

// The rate of background events: events away from the object's lines, from sensor noise, flashes or flicker. It
// determines the number of events that are expected near a line by chance (core/association/README.md, section 4, and
// core/tracking/README.md, section 1).
#pragma once

#include <vector>

#include "core/association/association.h"
#include "core/geometry/camera.h"

namespace evpose {

// Estimates the rate as the median over image cells of 64 x 64 undistorted pixels, without the tiles near lines. Moving
// objects in less than half of the cells do not affect a median.
class BackgroundRate {
 public:
  explicit BackgroundRate(const CameraModel& camera);

  // Counts an event of the window. `tile` must have no lines near it; `events` is the number of events of the sensor
  // that the sampled event represents.
  void Count(uint32_t tile, double events) { cell_events_[TileGrid::CellOf(tile)] += events; }
  // Ends the window and updates the rate. `grid` has the lines of the window; `duration_s` is its duration.
  void CloseWindow(const TileGrid& grid, double duration_s);

  // Events per second and pixel. The average covers the latest windows with about ten events per cell in total; a
  // window with more events replaces all earlier ones. 0 before the first window, and if no cell lies away from lines.
  double hz_per_px() const { return hz_per_px_; }

  // Valid only between windows.
  static void VisitState(auto& archive, auto& self) {
    auto& [on_sensor, cell_events, line_tiles, cells, rates, hz_per_px] = self;
    for (auto& cell : cells) archive(cell);
    archive(InRange(hz_per_px, 0.0, kMaxState));
  }

 private:
  struct Cell {
    double events = 0.0;
    double px2_s = 0.0;  // area times duration over which the events were counted
    static void VisitState(auto& archive, auto& self) {
      auto& [events, px2_s] = self;
      archive(InRange(events, 0.0, kMaxState), InRange(px2_s, 0.0, kMaxState));
    }
  };
  // Upper bound of loaded numbers: their sums and ratios stay finite, so that rates can be sorted.
  static constexpr double kMaxState = 1e18;
  std::vector<bool> on_sensor_;  // by cell: lies entirely inside the sensor's rectangle
  std::vector<double> cell_events_;
  std::vector<uint32_t> line_tiles_;
  std::vector<Cell> cells_;
  std::vector<double> rates_;
  double hz_per_px_ = 0.0;
};

}  // namespace evpose

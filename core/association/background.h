// SPDX-License-Identifier: Apache-2.0

// How many events come from nowhere near the object: the sensor's noise, a flash, a flood. What is near a line is to be
// judged against that (core/windows/README.md and core/tracking/README.md, section 1).
#pragma once

#include <vector>

#include "core/association/association.h"
#include "core/geometry/camera.h"

namespace evpose {

// The median over cells of the image, so that what moves in some of them does not count. Cells of 64 x 64 undistorted
// pixels, of which the tiles near lines are left out.
class BackgroundRate {
 public:
  explicit BackgroundRate(const CameraModel& camera);

  // For each event of a window, the index of its tile, and how many events it stands for.
  void Count(uint32_t tile, double events) { cell_events_[cell_of_tile_[tile]] += events; }
  // Closes the window: `grid` knows its lines. Events in tiles near lines must not have been counted.
  void CloseWindow(const TileGrid& grid, double duration_s);

  // Events per second and pixel, of the last windows: as many of them as make about ten events in a cell, and of those
  // that are longer the last alone. 0 before the first, and in an image full of lines.
  double hz_per_px() const { return hz_per_px_; }

  // Between windows.
  static void VisitState(auto& archive, auto& self) {
    auto& [cell_of_tile, on_sensor, cell_events, line_tiles, cells, rates, hz_per_px] = self;
    for (auto& cell : cells) archive(cell);
    archive(InRange(hz_per_px, 0.0, kMaxState));
  }

 private:
  struct Cell {
    double events = 0.0;
    double px2_s = 0.0;  // area times time in which they came
    static void VisitState(auto& archive, auto& self) {
      auto& [events, px2_s] = self;
      archive(InRange(events, 0.0, kMaxState), InRange(px2_s, 0.0, kMaxState));
    }
  };
  // A ratio of such numbers, and of what they become, is one that can be sorted.
  static constexpr double kMaxState = 1e18;
  static constexpr int kCellTiles = 8;
  double Median();

  std::vector<uint32_t> cell_of_tile_;
  std::vector<bool> on_sensor_;  // cells that lie on the sensor as a whole
  std::vector<double> cell_events_;
  std::vector<uint32_t> line_tiles_;
  std::vector<Cell> cells_;
  std::vector<double> rates_;
  double hz_per_px_ = 0.0;
};

}  // namespace evpose

// Events of one polarity as points (u, v, c t), and which of them are neighbours.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "core/detection/event_stretch.h"

namespace evpose {

// One point for each cell of the given side that holds an event: the mean of its events. c = `px_per_s`. The cells of
// at most about `max_points` points are kept, chosen by their place. In order of cells.
std::vector<Eigen::Vector3f> SpaceTimePoints(const EventStretch& stretch, uint8_t polarity, double px_per_s,
                                             double cell_px, int max_points);

struct Neighbour {
  float squared_distance = 0.0f;
  int32_t index = 0;

  friend bool operator<(const Neighbour& a, const Neighbour& b) {
    return a.squared_distance != b.squared_distance ? a.squared_distance < b.squared_distance : a.index < b.index;
  }
};

// For each point its nearest neighbours, itself first, nearest first: at most `max_neighbours` within `radius`.
class NeighbourTable {
 public:
  NeighbourTable(const std::vector<Eigen::Vector3f>& points, double radius, int max_neighbours);

  const Neighbour* begin(size_t point) const { return &neighbours_[begin_[point]]; }
  size_t size(size_t point) const { return begin_[point + 1] - begin_[point]; }

 private:
  std::vector<size_t> begin_;
  std::vector<Neighbour> neighbours_;
};

}  // namespace evpose

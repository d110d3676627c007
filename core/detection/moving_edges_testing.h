// SPDX-License-Identifier: Apache-2.0

// For tests: simulates the events of straight edges with a given motion.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "core/detection/line_detector.h"
#include "core/numerics/random.h"

namespace evpose::testing {

struct MovingEdge {
  Eigen::Vector2d p1_px;  // at t = 0
  Eigen::Vector2d p2_px;
  Eigen::Vector2d velocity_px_per_s = Eigen::Vector2d::Zero();
  double turn_rad_per_s = 0.0;  // about the middle
  uint8_t polarity = 1;
  double stops_at_s = 1e9;

  ImageSegment At(double t_s) const;
};

struct EdgeEventOptions {
  double duration_s = 0.03;
  double events_per_px2 = 2.0;    // events per swept area
  double noise_px = 0.4;          // standard deviation across the edge
  double clutter_per_px2 = 1e-3;  // uniform events per image area, over the whole duration
  int width_px = 640;
  int height_px = 480;
  int64_t t_begin_us = 1'000'000;
  uint64_t seed = 1;
};

// Returns the events in order of time.
std::vector<PixelEvent> MakeEdgeEvents(const std::vector<MovingEdge>& edges, const EdgeEventOptions& options);

}  // namespace evpose::testing

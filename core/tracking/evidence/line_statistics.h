// SPDX-License-Identifier: Apache-2.0

// Counts of the events near one straight line or curve (core/tracking/README.md, section 1).
#pragma once

#include <Eigen/Core>

#include "core/base/state_io.h"

namespace evpose {

// The counts of one straight line or curve since the last test result.
struct LineStatistics {
  double gated = 0.0;  // events within gate_px of the line for which no other line is nearer
  // Equation (2) of the README: the near events minus their expected number under clutter, the variance of this
  // difference, and its value if all events were those of the line at the right pose. Each polarity of a window is
  // weighted down as its share of far events grows: while a lamp brightens, ON events occur everywhere and would mask
  // the OFF events of the lines.
  double excess = 0.0;
  double variance = 0.0;
  double right_excess = 0.0;
  double information = 0.0;  // sum of (p - c)^2 / (c (1 - c)), without weights
  double noise = 0.0;        // gated events that the background rate explains
  double expected = 0.0;     // lower bound of the number of events that the line's motion should have produced
  // Histogram of the gated events along the line: the line's own events are spread along it, those of an edge that
  // crosses it are concentrated at one place.
  Eigen::Matrix<double, 8, 1> along = Eigen::Matrix<double, 8, 1>::Zero();
  double length_px = 0.0;  // mean projected length, weighted by time
  // Number of straight lines that constrain a pose as much: of a curve, its arcs of 45 degrees that are long enough.
  int lines = 1;

  // Multiplies the counts by `kept_ratio`, then adds `other`.
  void Add(const LineStatistics& other, double kept_ratio = 1.0);

  static constexpr int kMaxLines = 8;  // number of lines of a circle

  // Most lines of a large model have no counts; one flag is stored for each of these.
  static void VisitState(auto& archive, auto& self) {
    auto& [gated, excess, variance, right_excess, information, noise, expected, along, length_px, lines] = self;
    bool is_empty =
        gated == 0 && excess == 0 && variance == 0 && noise == 0 && expected == 0 && length_px == 0 && lines == 1;
    archive(is_empty);
    if (is_empty) return;
    archive(Finite(gated), Finite(excess), Finite(variance), Finite(right_excess), Finite(information), Finite(noise),
            Finite(expected), Finite(along), Finite(length_px), InRange(lines, 1, kMaxLines));
  }
};

}  // namespace evpose

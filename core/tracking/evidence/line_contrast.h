// SPDX-License-Identifier: Apache-2.0

// How much denser the events are on the lines of a pose than beside them (core/tracking/README.md, section 1).
#pragma once

#include "core/base/state_io.h"
#include "core/estimation/estimator.h"

namespace evpose {

// Sums over the windows of about the last HealthOptions::contrast_memory_us: a lamp that flickers adds events beside
// the lines in some windows, and the ratio of few events is uncertain.
class LineContrast {
 public:
  // `kept_ratio`: factor of the sums of the earlier windows; below 0 it counts as 0.
  void Add(const WindowFit& fit, double kept_ratio);
  // Standard deviation of the explained events about the lines; 0 without windows.
  double SpreadPx() const;
  // The density of the explained events at the middle of the lines, divided by that of the events in the gates that are
  // neither explained nor background. Infinite if there are none of these, without windows, and for estimators without
  // a gate.
  double Ratio() const;

  static void VisitState(auto& archive, auto& self) {
    auto& [explained, beside, squares_px2, gates_px] = self;
    archive(Finite(explained), Finite(beside), Finite(squares_px2), Finite(gates_px));
  }

 private:
  double explained_ = 0.0;
  double beside_ = 0.0;
  double squares_px2_ = 0.0;  // of the distances of the explained events
  double gates_px_ = 0.0;     // sum of the gates, weighted by the explained events
};

}  // namespace evpose

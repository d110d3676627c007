// SPDX-License-Identifier: Apache-2.0

// Bias of the events of a line while a lamp changes its brightness (flicker) and produces events of the other polarity
// beside the line.
//
// A pixel responds to the sum of the changes of log light by the edge and by the lamp. While a lamp becomes darker, an
// edge that brightens its pixels produces ON events only where its own change is the faster one. If u is the number of
// OFF events per pixel away from the edge, e(x) - u of its e(x) events per pixel remain, and none where u > e(x). The
// events of the edge are therefore missing in its flank on the side of the flickering surface, and the mean of the
// remaining ones is displaced away from this side. For a bright object on a dark background this is outwards, so that
// the object appears nearer. While the lamp becomes brighter, the events of the surface have the polarity of the edge
// and are clutter beside it (line_clutter.h).
//
// The sum holds for fine steps of the lamp. If the thresholds are so coarse that the lamp causes less than one event
// while the edge passes, it holds in the mean.
#pragma once

#include <array>

#include "core/estimation/line_clutter.h"
#include "core/numerics/robust.h"

namespace evpose {

class FlickerBias {
 public:
  // The table does not depend on the sensor; it is computed once.
  static const FlickerBias& Get();

  // Displacement of the mean of the events of an edge away from the flickering side, in units of their standard
  // deviation. `ratio` is the number of flicker events per unit of the standard deviation divided by the number of
  // remaining events of the edge. It is clamped to the tabulated range [0, 0.7], at whose end the density of the
  // flicker events is nine tenths of the peak density of the edge.
  double Away(double ratio) const;

 private:
  // Steps of the table, between which the displacement is interpolated linearly, and the ratio at its end. Beyond the
  // end almost no event of the flank remains, and the displacement changes quickly with the ratio, so that it is
  // bounded instead.
  static constexpr int kSteps = 64;
  static constexpr double kMaxRatio = 0.7;

  FlickerBias();

  std::array<double, kSteps + 1> away_ = {};
};

// Displacement of the events of a line along its normal, in pixels. `counts` are the observations of the window in a
// gate of half-width `gate_px`, `events_per_observation` the downsampling factor of each polarity, and `spread_px` the
// standard deviation of the events about the line.
double FlickerBiasPx(const LineCounts& counts, const ByPolarity& events_per_observation, double gate_px,
                     double spread_px);

}  // namespace evpose

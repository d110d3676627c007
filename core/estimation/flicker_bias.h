// SPDX-License-Identifier: Apache-2.0

// Where a line's events lie while a lamp's change floods what is beside it with events of the other polarity.
//
// A pixel deficit_counts to the sum of what the edge and what the lamp do to the logarithm of its light. While a lamp
// grows darker, an edge that brightens its pixels makes ON events only where it is the faster of the two: of its e(x)
// events per pixel e(x) - u are left, u being the OFF events per pixel where there is no edge, and none where u is
// more. So the edge's events are missing in its flanks on the side of the surface that floods, and those that are left
// have their mean away from it: of a bright object on a dark background outwards, which looks nearer for it. Where the
// lamp grows brighter, the flood has the edge's own polarity and is clutter beside it (line_clutter.h).
//
// The sum is of a lamp's fine steps; with thresholds so coarse that it makes less than an event while an edge passes,
// it holds in the mean.
#pragma once

#include <array>

#include "core/estimation/line_clutter.h"
#include "core/numerics/robust.h"

namespace evpose {

class FlickerBias {
 public:
  // The same for all sensors; computed once.
  static const FlickerBias& Get();

  // How far the mean of an edge's events is from where it is without the flood, away from it, in units of the events'
  // spread. `ratio`: flood per unit of the spread, over the events that are left; clamped to what is tabulated, [0,
  // 0.7], where the flood is nine tenths of the edge's highest density.
  double Away(double ratio) const;

 private:
  static constexpr int kSteps = 64;
  static constexpr double kMaxRatio = 0.7;

  FlickerBias();

  std::array<double, kSteps + 1> away_ = {};
};

// The displacement of a line's events along its normal, pixels, from what came in its gate of `gate_px` in a window;
// `spread_px` is one standard deviation.
double FlickerBiasPx(const LineCounts& counts, const ByPolarity& events_per_observation, double gate_px,
                     double spread_px);

}  // namespace evpose

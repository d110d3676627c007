// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/flicker_bias.h"

#include <algorithm>

#include "core/numerics/math.h"

namespace evpose {
namespace {

// Result for an edge with one event in total and a standard deviation of one.
struct Remaining {
  double ratio = 0.0;  // flicker events per unit length divided by the remaining events
  double away = 0.0;   // mean position of the remaining events
};

// `flicker_share`: density of the flicker events, relative to the peak density of the edge.
Remaining RemainingBeside(double flicker_share) {
  // Range of the integration in standard deviations, and its steps: the rest is below 1e-6.
  constexpr double kReach = 5.0;
  constexpr int kSteps = 500;
  constexpr double kStep = kReach / kSteps;
  constexpr double kPeak = MixtureDensity::kInverseSqrt2Pi;
  const double flicker = flicker_share * kPeak;
  // The other side of the edge keeps its half of the events, which have a first moment of kPeak.
  double events = 0.5;
  double moment = kPeak;
  for (int i = 0; i < kSteps; ++i) {
    const double x = (i + 0.5) * kStep;
    const double density = std::max(0.0, kPeak * DeterministicExp(-0.5 * x * x) - flicker) * kStep;
    events += density;
    moment -= x * density;
  }
  return {flicker / events, moment / events};
}

}  // namespace

const FlickerBias& FlickerBias::Get() {
  static const FlickerBias bias;
  return bias;
}

FlickerBias::FlickerBias() {
  // Step of the flicker density, small enough for linear interpolation between the computed points.
  constexpr double kShareStep = 0.005;
  Remaining below;
  double share = 0.0;
  Remaining above = RemainingBeside(share);
  for (int i = 1; i <= kSteps; ++i) {
    const double ratio = i * kMaxRatio / kSteps;
    while (above.ratio < ratio) {
      below = above;
      share += kShareStep;
      above = RemainingBeside(share);
    }
    away_[i] = below.away + (ratio - below.ratio) / (above.ratio - below.ratio) * (above.away - below.away);
  }
}

double FlickerBias::Away(double ratio) const {
  const double place = std::clamp(ratio, 0.0, kMaxRatio) * (kSteps / kMaxRatio);
  const int below = std::min(static_cast<int>(place), kSteps - 1);
  return away_[below] + (place - below) * (away_[below + 1] - away_[below]);
}

double FlickerBiasPx(const LineCounts& counts, const ByPolarity& events_per_observation, double gate_px,
                     double spread_px) {
  // Events of the line, a lower bound for the denominator: fewer are no estimate of the rate.
  constexpr double kFewEvents = 10.0;
  const double strip_px = (1.0 - LineCounts::kLateralRatio) * gate_px;
  // Noise has both polarities and removes no events of the edge; the change of a lamp has one polarity. The excess of
  // ON over OFF events on each side therefore measures the flicker.
  std::array<double, 2> on_excess;
  for (int side = 0; side < 2; ++side) {
    on_excess[side] =
        counts.beside[side][1] * events_per_observation[1] - counts.beside[side][0] * events_per_observation[0];
  }
  double all = 0.0;
  double moment = 0.0;
  for (int polarity = 0; polarity < 2; ++polarity) {
    const double own = counts.own[polarity] * events_per_observation[polarity];
    const double to_ratio = spread_px / (strip_px * std::max(own, kFewEvents));
    std::array<double, 2> away;
    for (int side = 0; side < 2; ++side) {
      const double flicker = polarity == 1 ? -on_excess[side] : on_excess[side];
      away[side] = flicker > 0.0 ? FlickerBias::Get().Away(flicker * to_ratio) : 0.0;
    }
    all += own;
    moment += own * (away[0] - away[1]);
  }
  return all > 0.0 ? spread_px * moment / all : 0.0;
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/flicker_bias.h"

#include <algorithm>

#include "core/numerics/math.h"

namespace evpose {
namespace {

// Of an edge with one event in all and a spread of one, its flood's density a share of its highest.
struct Left {
  double ratio = 0.0;  // of the flood to the events that are left
  double away = 0.0;   // their mean
};

Left LeftBeside(double flood_share) {
  constexpr double kReach = 5.0;
  constexpr int kSteps = 500;
  constexpr double kStep = kReach / kSteps;
  constexpr double kPeak = MixtureDensity::kInverseSqrt2Pi;
  const double flood = flood_share * kPeak;
  // On the other side half of the events are, with a mean of 2 * kPeak.
  double events = 0.5;
  double moment = kPeak;
  for (int i = 0; i < kSteps; ++i) {
    const double x = (i + 0.5) * kStep;
    const double density = std::max(0.0, kPeak * DeterministicExp(-0.5 * x * x) - flood) * kStep;
    events += density;
    moment -= x * density;
  }
  return {flood / events, moment / events};
}

}  // namespace

const FlickerBias& FlickerBias::Get() {
  static const FlickerBias shift;
  return shift;
}

FlickerBias::FlickerBias() {
  constexpr double kShareStep = 0.005;
  Left below;
  double share = 0.0;
  Left above = LeftBeside(share);
  for (int i = 1; i <= kSteps; ++i) {
    const double ratio = i * kMaxRatio / kSteps;
    while (above.ratio < ratio) {
      below = above;
      share += kShareStep;
      above = LeftBeside(share);
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
  // Fewer of its own do not tell how many there are of its own.
  constexpr double kFewEvents = 10.0;
  const double strip_px = (1.0 - LineCounts::kLateralRatio) * gate_px;
  // Noise comes in both polarities, and takes nothing away: a lamp's change in one.
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
      const double flood = polarity == 1 ? -on_excess[side] : on_excess[side];
      away[side] = flood > 0.0 ? FlickerBias::Get().Away(flood * to_ratio) : 0.0;
    }
    all += own;
    moment += own * (away[0] - away[1]);
  }
  return all > 0.0 ? spread_px * moment / all : 0.0;
}

}  // namespace evpose

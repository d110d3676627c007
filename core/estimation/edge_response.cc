// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/edge_response.h"

#include <algorithm>
#include <vector>

#include "core/numerics/math.h"
#include "core/numerics/robust.h"

namespace evpose {
namespace {

// The blurred step is integrated over +-5 standard deviations; the rest is 1e-6 of its height. 1000 steps of the
// midpoint rule have an error below that of the interpolation in the table.
constexpr double kBlurReach = 5.0;
constexpr int kBlurSteps = 1000;

// A point of a blurred step of log contrast L, from its dark side: position x in units of the blur, level l(x) above
// the dark side, and the integral of x dl up to this point.
struct StepPoint {
  double x = 0.0;
  double level = 0.0;
  double moment = 0.0;
};

// Integrates dl/dx = phi(x) (e^L - 1) / (1 + Phi(x) (e^L - 1)) by the midpoint rule. For L = 0 the level is in units of
// L, which is the limit for small L.
std::vector<StepPoint> IntegrateStep(double contrast) {
  const double step = 2.0 * kBlurReach / kBlurSteps;
  const double gain = DeterministicExp(contrast) - 1.0;
  std::vector<StepPoint> points = {{-kBlurReach, 0.0, 0.0}};
  double cumulative = 0.0;
  for (int i = 0; i < kBlurSteps; ++i) {
    const double x = -kBlurReach + (i + 0.5) * step;
    const double density = MixtureDensity::kInverseSqrt2Pi * DeterministicExp(-0.5 * x * x) * step;
    const double rise = contrast > 0.0 ? gain * density / (1.0 + gain * (cumulative + 0.5 * density)) : density;
    cumulative += density;
    points.push_back({x + 0.5 * step, points.back().level + rise, points.back().moment + rise * x});
  }
  return points;
}

// Integral of x dl from the dark side up to a level.
double MomentAt(const std::vector<StepPoint>& points, double level) {
  const auto above = std::lower_bound(points.begin(), points.end(), level,
                                      [](const StepPoint& point, double value) { return point.level < value; });
  if (above == points.begin()) return 0.0;
  if (above == points.end()) return points.back().moment;
  const auto below = above - 1;
  const double share = (level - below->level) / (above->level - below->level);
  return below->moment + share * (above->moment - below->moment);
}

// Clamps to [0, 1]; NaN becomes 0, so that it cannot index outside the table.
double ClampToUnit(double x) { return x > 0.0 ? std::min(x, 1.0) : 0.0; }

}  // namespace

const EdgeResponse& EdgeResponse::Get() {
  static const EdgeResponse response;
  return response;
}

EdgeResponse::EdgeResponse() {
  for (int i = 0; i <= kContrastSteps; ++i) Tabulate(i);
}

void EdgeResponse::Tabulate(int contrast_index) {
  const std::vector<StepPoint> points = IntegrateStep(contrast_index * kMaxContrast / kContrastSteps);
  const double full = points.back().level;
  for (int k = 0; k <= kHysteresisSteps; ++k) {
    const double skipped = full * k * kMaxHysteresis / kHysteresisSteps;
    // A pixel that becomes brighter crosses the dark side of the edge first: there x points against the motion.
    const double upper = points.back().moment - MomentAt(points, skipped);
    on_events_[contrast_index][k] = -upper / (full - skipped);
    off_events_[contrast_index][k] = MomentAt(points, full - skipped) / (full - skipped);
  }
}

double EdgeResponse::Interpolate(const Table& table, double contrast, double hysteresis) {
  const double row = ClampToUnit(contrast / kMaxContrast) * kContrastSteps;
  const double column = ClampToUnit(hysteresis / kMaxHysteresis) * kHysteresisSteps;
  const int i = std::min(static_cast<int>(row), kContrastSteps - 1);
  const int k = std::min(static_cast<int>(column), kHysteresisSteps - 1);
  const double u = row - i;
  const double v = column - k;
  return (1.0 - u) * ((1.0 - v) * table[i][k] + v * table[i][k + 1]) +
         u * ((1.0 - v) * table[i + 1][k] + v * table[i + 1][k + 1]);
}

}  // namespace evpose

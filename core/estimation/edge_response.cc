// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/edge_response.h"

#include <algorithm>
#include <vector>

#include "core/numerics/math.h"
#include "core/numerics/robust.h"

namespace evpose {
namespace {

// The blurred step between these many standard deviations; what lies beyond is 1e-6 of it.
constexpr double kBlurReach = 5.0;
constexpr int kBlurSteps = 1000;

// Along a blurred step of log contrast L, from its dark side: place x, level l(x) above dark, and the integral of x dl
// up to there.
struct StepPoint {
  double x = 0.0;
  double level = 0.0;
  double moment = 0.0;
};

// dl/dx = phi(x) (e^L - 1) / (1 + Phi(x) (e^L - 1)), by the midpoint rule. For L to 0 the level is Phi(x) L: then l
// counts in units of L.
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

// The integral of x dl up to a level.
double MomentAt(const std::vector<StepPoint>& points, double level) {
  const auto above = std::lower_bound(points.begin(), points.end(), level,
                                      [](const StepPoint& point, double value) { return point.level < value; });
  if (above == points.begin()) return 0.0;
  if (above == points.end()) return points.back().moment;
  const auto below = above - 1;
  const double share = (level - below->level) / (above->level - below->level);
  return below->moment + share * (above->moment - below->moment);
}

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
    // The pixel that gets brighter sees the edge's dark side first, and that from ahead: x points against the motion.
    const double upper = points.back().moment - MomentAt(points, skipped);
    brighter_[contrast_index][k] = -upper / (full - skipped);
    darker_[contrast_index][k] = MomentAt(points, full - skipped) / (full - skipped);
  }
}

// Within [0, 1]; 0 for what is no number, so that it indexes nothing.
double Share(double x) { return x > 0.0 ? std::min(x, 1.0) : 0.0; }

double EdgeResponse::Interpolate(const Table& table, double contrast, double hysteresis) {
  const double row = Share(contrast / kMaxContrast) * kContrastSteps;
  const double column = Share(hysteresis / kMaxHysteresis) * kHysteresisSteps;
  const int i = std::min(static_cast<int>(row), kContrastSteps - 1);
  const int k = std::min(static_cast<int>(column), kHysteresisSteps - 1);
  const double u = row - i;
  const double v = column - k;
  return (1.0 - u) * ((1.0 - v) * table[i][k] + v * table[i][k + 1]) +
         u * ((1.0 - v) * table[i + 1][k] + v * table[i + 1][k + 1]);
}

double EdgeResponse::Brighter(double contrast, double hysteresis) const {
  return Interpolate(brighter_, contrast, hysteresis);
}

double EdgeResponse::Darker(double contrast, double hysteresis) const {
  return Interpolate(darker_, contrast, hysteresis);
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/calibration/event_displacement.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace evpose {

EventDisplacement FitDisplacement(absl::Span<const double> distances_px, double gate_px, double start_px,
                                  const ExpTable& table, absl::Span<const double> companions_px) {
  constexpr int kIterations = 25;      // enough for the convergence of expectation and maximisation
  constexpr double kMinSigmaPx = 0.2;  // below the rounding of pixels (0.29 px)
  constexpr double kMinOutlierRatio = 0.01, kMaxOutlierRatio = 0.9;  // keep both components present
  // Start: a usual standard deviation and share of clutter.
  EventDisplacement fit{start_px, 0.8, 0.0};
  double outlier_ratio = 0.2;
  const double share = 1.0 / (1.0 + static_cast<double>(companions_px.size()));
  std::vector<double> densities(companions_px.size());
  for (int i = 0; i < kIterations; ++i) {
    const MixtureDensity density{fit.spread_px, outlier_ratio, gate_px};
    double weight = 0.0, sum = 0.0, squares = 0.0;
    for (const double value : distances_px) {
      const double line = share * density.Line(value - fit.mean_px, table);
      double all = line + density.Outlier();
      for (size_t k = 0; k < companions_px.size(); ++k) {
        densities[k] = share * density.Line(value - companions_px[k] - fit.mean_px, table);
        all += densities[k];
      }
      const auto add = [&](double w, double distance) {
        weight += w;
        sum += w * distance;
        squares += w * distance * distance;
      };
      add(line / all, value);
      for (size_t k = 0; k < companions_px.size(); ++k) add(densities[k] / all, value - companions_px[k]);
    }
    if (weight <= 0.0) return {};
    fit.mean_px = sum / weight;
    fit.spread_px = std::max(kMinSigmaPx, std::sqrt(std::max(0.0, squares / weight - fit.mean_px * fit.mean_px)));
    fit.num_events = weight;
    outlier_ratio =
        std::clamp(1.0 - weight / static_cast<double>(distances_px.size()), kMinOutlierRatio, kMaxOutlierRatio);
  }
  return fit;
}

}  // namespace evpose

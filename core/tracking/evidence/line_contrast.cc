// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/evidence/line_contrast.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace evpose {

void LineContrast::Add(const WindowFit& fit, double kept_ratio) {
  kept_ratio = std::max(0.0, kept_ratio);
  explained_ = kept_ratio * explained_ + fit.num_explained;
  beside_ = kept_ratio * beside_ + fit.num_gated - fit.num_background - fit.num_explained;
  squares_px2_ = kept_ratio * squares_px2_ + fit.num_explained * fit.residual_rms_px * fit.residual_rms_px;
  gates_px_ = kept_ratio * gates_px_ + fit.num_explained * fit.gate_px;
}

double LineContrast::SpreadPx() const { return explained_ > 0.0 ? std::sqrt(squares_px2_ / explained_) : 0.0; }

double LineContrast::Ratio() const {
  if (!(beside_ > 0.0 && squares_px2_ > 0.0 && gates_px_ > 0.0)) return std::numeric_limits<double>::infinity();
  const double gate_px = gates_px_ / explained_;
  const double width_px = std::sqrt(2.0 * std::numbers::pi) * SpreadPx();
  return explained_ / width_px / (beside_ / (2.0 * gate_px));
}

}  // namespace evpose

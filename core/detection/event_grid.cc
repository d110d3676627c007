// SPDX-License-Identifier: Apache-2.0
#include "core/detection/event_grid.h"

#include <algorithm>
#include <cmath>

#include "core/base/yield_point.h"

namespace evpose {
namespace {

// Side of a cell, pixels: of the order of the queries' reach, so that few events outside the reach are returned.
constexpr double kCellPx = 8.0;
const double kCellRadiusPx = kCellPx * std::sqrt(0.5);

double DistanceToSegment(const Eigen::Vector2d& point, const Eigen::Vector2d& p1, const Eigen::Vector2d& p2) {
  const Eigen::Vector2d extent = p2 - p1;
  const double squared = extent.squaredNorm();
  const double share = squared > 0.0 ? std::clamp((point - p1).dot(extent) / squared, 0.0, 1.0) : 0.0;
  return (point - p1 - share * extent).norm();
}

}  // namespace

EventGrid::EventGrid(const std::vector<StretchEvent>& events, std::array<bool, 2> is_polarity) {
  if (events.empty()) return;
  YieldPoint();
  double high_u = low_u_px_ = events[0].u_px, high_v = low_v_px_ = events[0].v_px;
  for (const StretchEvent& event : events) {
    low_u_px_ = std::min<double>(low_u_px_, event.u_px);
    low_v_px_ = std::min<double>(low_v_px_, event.v_px);
    high_u = std::max<double>(high_u, event.u_px);
    high_v = std::max<double>(high_v, event.v_px);
  }
  columns_ = static_cast<int>((high_u - low_u_px_) / kCellPx) + 1;
  rows_ = static_cast<int>((high_v - low_v_px_) / kCellPx) + 1;
  const auto cell = [this](const StretchEvent& event) { return Row(event.v_px) * columns_ + Column(event.u_px); };
  begin_.assign(static_cast<size_t>(columns_) * rows_ + 1, 0);
  for (const StretchEvent& event : events) begin_[cell(event) + 1] += is_polarity[event.polarity] ? 1 : 0;
  YieldPoint();
  for (size_t i = 1; i < begin_.size(); ++i) begin_[i] += begin_[i - 1];
  std::vector<int32_t> next(begin_.begin(), begin_.end() - 1);
  sorted_.resize(begin_.back());
  for (size_t i = 0; i < events.size(); ++i) {
    if (is_polarity[events[i].polarity]) sorted_[next[cell(events[i])]++] = static_cast<int32_t>(i);
  }
}

int EventGrid::Column(double u_px) const {
  return static_cast<int>(std::clamp((u_px - low_u_px_) / kCellPx, 0.0, columns_ - 1.0));
}

int EventGrid::Row(double v_px) const {
  return static_cast<int>(std::clamp((v_px - low_v_px_) / kCellPx, 0.0, rows_ - 1.0));
}

void EventGrid::Near(const Eigen::Vector2d& p1_px, const Eigen::Vector2d& p2_px, double reach_px,
                     std::vector<int32_t>& indices) const {
  if (sorted_.empty()) return;
  const Eigen::Vector2d low = p1_px.cwiseMin(p2_px), high = p1_px.cwiseMax(p2_px);
  const int last_row = Row(high.y() + reach_px), last_column = Column(high.x() + reach_px);
  for (int row = Row(low.y() - reach_px); row <= last_row; ++row) {
    for (int column = Column(low.x() - reach_px); column <= last_column; ++column) {
      const int cell = row * columns_ + column;
      if (begin_[cell] == begin_[cell + 1]) continue;
      const Eigen::Vector2d centre(low_u_px_ + (column + 0.5) * kCellPx, low_v_px_ + (row + 0.5) * kCellPx);
      if (DistanceToSegment(centre, p1_px, p2_px) > reach_px + kCellRadiusPx) continue;
      indices.insert(indices.end(), sorted_.begin() + begin_[cell], sorted_.begin() + begin_[cell + 1]);
    }
  }
}

}  // namespace evpose

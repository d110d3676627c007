// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/templates/edge_distance_map.h"

#include <algorithm>
#include <cmath>

#include "core/base/yield_point.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

// Margin of the map on each side of the box, relative to its longer side: a box may lack a part of the object.
constexpr double kMarginOfBox = 0.25;
// A cell is not smaller: edge points are known to a few tenths of a pixel.
constexpr double kLeastMapCellPx = 0.5;
constexpr int kMapReach = EdgeDistanceMap::kReach;

struct NearCell {
  int dx = 0;
  int dy = 0;
  uint8_t nearness = 0;
};

// The cells about an edge, the nearest first.
std::vector<NearCell> MakeNearCells() {
  std::vector<NearCell> cells;
  for (int dy = -kMapReach; dy <= kMapReach; ++dy) {
    for (int dx = -kMapReach; dx <= kMapReach; ++dx) {
      const double distance = std::sqrt(static_cast<double>(dx * dx + dy * dy));
      const int nearness = RoundNonNegative(255.0 * std::max(0.0, 1.0 - distance / kMapReach));
      if (distance < kMapReach && nearness > 0) cells.push_back({dx, dy, static_cast<uint8_t>(nearness)});
    }
  }
  return cells;
}

}  // namespace

EdgeDistanceMap::EdgeDistanceMap(absl::Span<const EventEdgePoint> points, const ImageBox& box) : box_(box) {
  const double side_px = std::max(box.size_px().maxCoeff(), 1.0);
  cell_px_ = std::max(kLeastMapCellPx, side_px / kCellsOfBox);
  const double margin_px = kMarginOfBox * side_px;
  origin_px_ = box.low_px.array() - margin_px;
  const Eigen::Vector2d cells = (box.size_px().array() + 2.0 * margin_px) / cell_px_;
  width_ = 1 + static_cast<int>(cells.x());
  height_ = 1 + static_cast<int>(cells.y());
  CollectEdges(points);
  FillDistances();
}

CameraModel EdgeDistanceMap::CameraOf(const CameraModel& camera) const {
  CameraModel out;
  out.width_px = width_;
  out.height_px = height_;
  out.fx_px = camera.fx_px / cell_px_;
  out.fy_px = camera.fy_px / cell_px_;
  out.cx_px = (camera.cx_px - origin_px_.x()) / cell_px_;
  out.cy_px = (camera.cy_px - origin_px_.y()) / cell_px_;
  return out;
}

void EdgeDistanceMap::CollectEdges(absl::Span<const EventEdgePoint> points) {
  std::array<std::vector<uint16_t>, kOrientationBins> index;
  for (auto& of_bin : index) of_bin.resize(static_cast<size_t>(width_) * height_, kNoEdge);
  for (size_t i = 0; i < points.size(); ++i) {
    YieldPoint(i);
    const EventEdgePoint& point = points[i];
    const Eigen::Vector2d at = ToCells(point.at_px);
    const int x = static_cast<int>(std::floor(at.x() + 0.5)), y = static_cast<int>(std::floor(at.y() + 0.5));
    if (!IsInside(x, y)) continue;
    const int bin = OrientationBin(-point.normal.y(), point.normal.x());
    uint16_t& edge = index[bin][Place(x, y)];
    if (edge == kNoEdge) {
      if (edges_.size() == kNoEdge) continue;
      edge = static_cast<uint16_t>(edges_.size());
      edges_.push_back({.bin = static_cast<uint8_t>(bin)});
    }
    MapEdge& sums = edges_[edge];
    sums.at += point.weight * at.cast<float>();
    sums.flow += point.weight * (point.flow_px_per_s / cell_px_).cast<float>();
    sums.weight += point.weight;
  }
  for (MapEdge& edge : edges_) {
    edge.at /= edge.weight;
    edge.flow /= edge.weight;
    edge_weight_ += edge.weight;
  }
}

void EdgeDistanceMap::FillDistances() {
  static const std::vector<NearCell> kNearCells = MakeNearCells();
  for (auto& of_bin : nearness_) of_bin.resize(static_cast<size_t>(width_) * height_, 0);
  for (auto& of_bin : nearest_) of_bin.resize(static_cast<size_t>(width_) * height_, kNoEdge);
  for (size_t i = 0; i < edges_.size(); ++i) {
    YieldPoint(i);
    const MapEdge& edge = edges_[i];
    const int x = static_cast<int>(std::floor(edge.at.x() + 0.5f)),
              y = static_cast<int>(std::floor(edge.at.y() + 0.5f));
    for (int turn = -1; turn <= 1; ++turn) {
      const int bin = (edge.bin + turn + kOrientationBins) % kOrientationBins;
      for (const NearCell& cell : kNearCells) {
        if (!IsInside(x + cell.dx, y + cell.dy)) continue;
        const size_t place = Place(x + cell.dx, y + cell.dy);
        if (cell.nearness <= nearness_[bin][place]) continue;
        nearness_[bin][place] = cell.nearness;
        nearest_[bin][place] = static_cast<uint16_t>(i);
      }
    }
  }
}

}  // namespace evpose

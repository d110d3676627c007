// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/templates/edge_blobs.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

#include "core/numerics/connected_cells.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

// Cells per diagonal of the sensor; points in neighbouring cells are connected. A gap of up to 2 % of the diagonal is
// bridged, as where an edge moves along itself.
constexpr double kCellsOfDiagonal = 75.0;
constexpr double kMinCellPx = 4.0;
// Points of a group: fewer determine no pose. A group with less than this share of the largest one is clutter.
constexpr size_t kMinPoints = 40;
constexpr double kMinShare = 0.1;
// Share of the points outside the box at each side, so that single points of noise do not enlarge it. A larger share
// would cut off thin parts of the object.
constexpr double kOutside = 0.01;

class BlobGrid {
 public:
  BlobGrid(absl::Span<const EventEdgePoint> points, SensorGeometry sensor) {
    const double width = sensor.width_px, height = sensor.height_px;
    const double cell_px = std::max(kMinCellPx, std::sqrt(width * width + height * height) / kCellsOfDiagonal);
    columns_ = 1 + static_cast<int>(width / cell_px);
    rows_ = 1 + static_cast<int>(height / cell_px);
    members_.resize(static_cast<size_t>(columns_) * rows_);
    for (size_t i = 0; i < points.size(); ++i) {
      const int x = std::clamp(static_cast<int>(std::floor(points[i].at_px.x() / cell_px)), 0, columns_ - 1);
      const int y = std::clamp(static_cast<int>(std::floor(points[i].at_px.y() / cell_px)), 0, rows_ - 1);
      members_[static_cast<size_t>(y) * columns_ + x].push_back(i);
    }
  }

  // The groups of connected cells, as indices of points.
  std::vector<std::vector<size_t>> Groups() const {
    std::vector<bool> is_occupied;
    is_occupied.reserve(members_.size());
    for (const std::vector<size_t>& members : members_) is_occupied.push_back(!members.empty());
    std::vector<std::vector<size_t>> groups;
    for (const std::vector<size_t>& cells : ConnectedCells(columns_, rows_, is_occupied)) {
      std::vector<size_t>& group = groups.emplace_back();
      for (const size_t cell : cells) group.insert(group.end(), members_[cell].begin(), members_[cell].end());
    }
    return groups;
  }

 private:
  int columns_ = 0;
  int rows_ = 0;
  std::vector<std::vector<size_t>> members_;
};

ImageBox BoxOf(absl::Span<const EventEdgePoint> points, const std::vector<size_t>& group) {
  ImageBox box;
  std::vector<double> values(group.size());
  for (int axis = 0; axis < 2; ++axis) {
    for (size_t i = 0; i < group.size(); ++i) values[i] = points[group[i]].at_px[axis];
    box.low_px[axis] = UpperQuantile(values, kOutside);
    box.high_px[axis] = UpperQuantile(values, 1.0 - kOutside);
  }
  return box;
}

}  // namespace

std::vector<ImageBox> FindEdgeBlobs(absl::Span<const EventEdgePoint> points, SensorGeometry sensor, int max_boxes) {
  std::vector<std::vector<size_t>> groups = BlobGrid(points, sensor).Groups();
  std::stable_sort(groups.begin(), groups.end(), [](const auto& a, const auto& b) { return a.size() > b.size(); });
  std::vector<ImageBox> boxes;
  std::vector<size_t> all;
  for (const std::vector<size_t>& group : groups) {
    if (group.size() < kMinPoints ||
        static_cast<double>(group.size()) < kMinShare * static_cast<double>(groups[0].size()))
      break;
    all.insert(all.end(), group.begin(), group.end());
    if (static_cast<int>(boxes.size()) < max_boxes) boxes.push_back(BoxOf(points, group));
  }
  if (boxes.size() < 2) return boxes;
  if (static_cast<int>(boxes.size()) == max_boxes) boxes.pop_back();
  boxes.push_back(BoxOf(points, all));
  return boxes;
}

}  // namespace evpose

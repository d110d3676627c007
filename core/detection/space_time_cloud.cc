// SPDX-License-Identifier: Apache-2.0
#include "core/detection/space_time_cloud.h"

#include <algorithm>
#include <cmath>

#include "core/base/yield_point.h"
#include "core/numerics/sampling.h"

namespace evpose {
namespace {

// A cell is packed into 3 x 21 bits for t, v and u. The offset makes its coordinates positive.
constexpr int64_t kCellOffset = 1 << 20;

uint64_t CellKey(const Eigen::Vector3f& point, double cell_px) {
  uint64_t key = 0;
  for (const int axis : {2, 1, 0}) {
    const auto cell = static_cast<int64_t>(std::floor(point[axis] / cell_px)) + kCellOffset;
    key = (key << 21) | static_cast<uint64_t>(std::clamp<int64_t>(cell, 0, 2 * kCellOffset - 1));
  }
  return key;
}

}  // namespace

std::vector<Eigen::Vector3f> SpaceTimePoints(const EventStretch& stretch, uint8_t polarity, double px_per_s,
                                             double cell_px, int max_points) {
  std::vector<std::pair<uint64_t, Eigen::Vector3f>> keyed;
  for (size_t k = 0; k < stretch.events.size(); ++k) {
    YieldPoint(k);
    const StretchEvent& event = stretch.events[k];
    if (event.polarity != polarity) continue;
    const Eigen::Vector3f point(event.u_px, event.v_px, static_cast<float>(px_per_s) * event.tau_s);
    keyed.emplace_back(CellKey(point, cell_px), point);
  }
  YieldPoint();
  std::stable_sort(keyed.begin(), keyed.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  YieldPoint();
  std::vector<Eigen::Vector3f> means;
  for (size_t i = 0; i < keyed.size();) {
    Eigen::Vector3f sum = Eigen::Vector3f::Zero();
    size_t end = i;
    for (; end < keyed.size() && keyed[end].first == keyed[i].first; ++end) sum += keyed[end].second;
    means.push_back(sum / static_cast<float>(end - i));
    i = end;
  }
  SelectionSampler sample(means.size(), max_points);
  std::vector<Eigen::Vector3f> points;
  for (const Eigen::Vector3f& mean : means) {
    if (sample.TakesNext()) points.push_back(mean);
  }
  return points;
}

NeighbourTable::NeighbourTable(const std::vector<Eigen::Vector3f>& points, double radius, int max_neighbours) {
  begin_.assign(points.size() + 1, 0);
  if (points.empty()) return;
  // Points are sorted into squares of the image with the side `radius`. The stretch is short in time (a few pixels in
  // c t), so that a square has few points.
  Eigen::Vector2f low = points[0].head<2>(), high = low;
  for (const Eigen::Vector3f& point : points) {
    low = low.cwiseMin(point.head<2>());
    high = high.cwiseMax(point.head<2>());
  }
  const auto side = static_cast<float>(radius);
  const int columns = static_cast<int>((high.x() - low.x()) / side) + 3;  // with an empty border
  const int rows = static_cast<int>((high.y() - low.y()) / side) + 3;
  const auto square = [&](const Eigen::Vector3f& point) {
    return (static_cast<int>((point.y() - low.y()) / side) + 1) * columns +
           static_cast<int>((point.x() - low.x()) / side) + 1;
  };
  std::vector<int32_t> square_begin(static_cast<size_t>(columns) * rows + 1, 0);
  for (const Eigen::Vector3f& point : points) ++square_begin[square(point) + 1];
  for (size_t i = 1; i < square_begin.size(); ++i) {
    YieldPoint(i);
    square_begin[i] += square_begin[i - 1];
  }
  std::vector<std::pair<Eigen::Vector3f, int32_t>> sorted(points.size());
  std::vector<int32_t> next(square_begin.begin(), square_begin.end() - 1);
  for (size_t i = 0; i < points.size(); ++i) sorted[next[square(points[i])]++] = {points[i], static_cast<int32_t>(i)};

  std::vector<std::pair<float, int32_t>> found;  // squared distance and point
  neighbours_.reserve(points.size() * max_neighbours);
  for (size_t i = 0; i < points.size(); ++i) {
    YieldPoint(i);
    found.clear();
    for (int row = -1; row <= 1; ++row) {
      const int centre = square(points[i]) + row * columns;
      for (int32_t k = square_begin[centre - 1]; k < square_begin[centre + 2]; ++k) {
        const float squared_distance = (sorted[k].first - points[i]).squaredNorm();
        if (squared_distance <= side * side) found.emplace_back(squared_distance, sorted[k].second);
      }
    }
    const size_t kept = std::min(found.size(), static_cast<size_t>(max_neighbours));
    if (kept < found.size()) std::nth_element(found.begin(), found.begin() + kept, found.end());
    for (size_t k = 0; k < kept; ++k) neighbours_.push_back(found[k].second);
    begin_[i + 1] = neighbours_.size();
  }
}

NeighbourTable NeighbourTable::Restricted(const std::vector<bool>& is_kept) const {
  std::vector<int32_t> new_index(is_kept.size(), -1);
  int32_t count = 0;
  for (size_t i = 0; i < is_kept.size(); ++i) {
    if (is_kept[i]) new_index[i] = count++;
  }
  NeighbourTable table;
  table.begin_.push_back(0);
  for (size_t i = 0; i < is_kept.size(); ++i) {
    if (!is_kept[i]) continue;
    for (const int32_t neighbour : Of(i)) {
      if (is_kept[neighbour]) table.neighbours_.push_back(new_index[neighbour]);
    }
    table.begin_.push_back(table.neighbours_.size());
  }
  return table;
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/templates/long_lines.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <optional>

#include "core/base/yield_point.h"
#include "core/numerics/math.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

using Eigen::Vector2d;

// A Hough transform with cells of 3 degrees and 3 px: the places of edges have errors below one pixel, the normals of
// single places errors of several degrees, so that a point votes for the directions within 9 degrees of its normal.
constexpr int kDirections = 60;
constexpr double kVoteCellPx = 3.0;
constexpr double kMaxTurn = 0.98768834059513772;  // cosine of 9 degrees
// Half width of the band of a line, px: the events of a moving edge spread by its motion between two polarities.
constexpr double kHalfBandPx = 5.0;
// Number of lines that are looked for: the sides of two bars and of one more thing. Each takes a pass over all points.
constexpr int kMaxLines = 6;
// Points of a line, and of what is left beside the lines: fewer determine no pose (edge_blobs.cc).
constexpr size_t kMinLinePoints = 40;
// Least number of points per pixel of a line's length. An edge with events has one point for each pixel and polarity.
constexpr double kMinDensity = 0.4;
// Least ratio of the length of a line to the extent of everything else in its direction. The longest straight edge of
// an object is at most as long as the object.
constexpr double kMinLengthRatio = 1.25;
// Share of the points outside an extent at each side, so that single points of noise do not enlarge it.
constexpr double kOutsideOfExtent = 0.02;

struct Line {
  Vector2d normal = Vector2d::Zero();
  double offset_px = 0.0;  // normal . p of its points
  double length_px = 0.0;
};

double ExtentAlong(absl::Span<const EventEdgePoint> points, const Vector2d& direction) {
  std::vector<double> along;
  along.reserve(points.size());
  for (const EventEdgePoint& point : points) along.push_back(direction.dot(point.at_px));
  const double low = UpperQuantile(along, kOutsideOfExtent);
  return UpperQuantile(along, 1.0 - kOutsideOfExtent) - low;
}

bool IsNear(const EventEdgePoint& point, const Line& line, double half_band_px) {
  return std::abs(line.normal.dot(point.at_px) - line.offset_px) <= half_band_px;
}

std::vector<EventEdgePoint> PointsOff(absl::Span<const EventEdgePoint> points, const Line& line) {
  std::vector<EventEdgePoint> off;
  for (const EventEdgePoint& point : points) {
    if (!IsNear(point, line, kHalfBandPx)) off.push_back(point);
  }
  return off;
}

class LineVotes {
 public:
  explicit LineVotes(SensorGeometry sensor)
      : reach_px_(std::sqrt(static_cast<double>(sensor.width_px) * sensor.width_px +
                            static_cast<double>(sensor.height_px) * sensor.height_px)),
        num_offsets_(1 + static_cast<size_t>(2.0 * reach_px_ / kVoteCellPx)) {
    for (int i = 0; i < kDirections; ++i) {
      const SinCos angle = DeterministicSinCos(std::numbers::pi / kDirections * i);
      normals_[static_cast<size_t>(i)] = {angle.cos, angle.sin};
    }
  }

  // The line with the most votes of points with its direction; nothing if no line has enough of them.
  std::optional<Line> Best(absl::Span<const EventEdgePoint> points) const {
    std::vector<uint32_t> votes(kDirections * num_offsets_, 0);
    for (size_t k = 0; k < points.size(); ++k) {
      YieldPoint(k);
      for (size_t i = 0; i < kDirections; ++i) {
        if (std::abs(normals_[i].dot(points[k].normal)) >= kMaxTurn) ++votes[i * num_offsets_ + OffsetOf(i, points[k])];
      }
    }
    // An edge between two cells has its votes in both.
    size_t best = 0;
    uint32_t most = 0;
    for (size_t i = 0; i < votes.size(); ++i) {
      const uint32_t sum = votes[i] + (i + 1 < votes.size() ? votes[i + 1] : 0);
      if (sum > most) most = sum, best = i;
    }
    if (most < kMinLinePoints) return std::nullopt;
    Line line;
    line.normal = normals_[best / num_offsets_];
    line.offset_px = kVoteCellPx * static_cast<double>(best % num_offsets_ + 1) - reach_px_;
    return Fit(points, line);
  }

 private:
  size_t OffsetOf(size_t direction, const EventEdgePoint& point) const {
    const double offset = (normals_[direction].dot(point.at_px) + reach_px_) / kVoteCellPx;
    return static_cast<size_t>(std::clamp(offset, 0.0, static_cast<double>(num_offsets_ - 1)));
  }

  // Fits the line to the points near it, in two steps, because the first one has the direction of a cell.
  std::optional<Line> Fit(absl::Span<const EventEdgePoint> points, Line line) const {
    std::vector<EventEdgePoint> near;
    for (const double half_band_px : {3.0 * kVoteCellPx, kHalfBandPx}) {
      near.clear();
      for (const EventEdgePoint& point : points) {
        if (IsNear(point, line, half_band_px) && std::abs(line.normal.dot(point.normal)) >= kMaxTurn) {
          near.push_back(point);
        }
      }
      if (near.size() < kMinLinePoints) return std::nullopt;
      Vector2d mean = Vector2d::Zero();
      for (const EventEdgePoint& point : near) mean += point.at_px;
      mean /= static_cast<double>(near.size());
      const Vector2d along(-line.normal.y(), line.normal.x());
      // Regression across the line on the position along it: the band is narrow.
      double sum_xx = 0.0, sum_xy = 0.0;
      for (const EventEdgePoint& point : near) {
        const Vector2d at = point.at_px - mean;
        const double x = along.dot(at);
        sum_xx += x * x;
        sum_xy += x * line.normal.dot(at);
      }
      if (!(sum_xx > 0.0)) return std::nullopt;
      line.normal = (line.normal - sum_xy / sum_xx * along).normalized();
      line.offset_px = line.normal.dot(mean);
    }
    line.length_px = ExtentAlong(near, {-line.normal.y(), line.normal.x()});
    if (static_cast<double>(near.size()) < kMinDensity * line.length_px) line.length_px = 0.0;
    return line;
  }

  const double reach_px_;
  const size_t num_offsets_;
  std::array<Vector2d, kDirections> normals_;
};

}  // namespace

std::vector<EventEdgePoint> WithoutLongLines(absl::Span<const EventEdgePoint> points, SensorGeometry sensor) {
  const LineVotes votes(sensor);
  std::vector<EventEdgePoint> rest(points.begin(), points.end());
  std::vector<Line> lines;
  while (lines.size() < kMaxLines) {
    YieldPoint();
    const std::optional<Line> line = votes.Best(rest);
    if (!line.has_value()) break;
    rest = PointsOff(rest, *line);
    lines.push_back(*line);
  }
  std::stable_sort(lines.begin(), lines.end(), [](const Line& a, const Line& b) { return a.length_px > b.length_px; });
  std::vector<EventEdgePoint> without;
  rest.assign(points.begin(), points.end());
  for (size_t count = 1; count <= lines.size(); ++count) {
    rest = PointsOff(rest, lines[count - 1]);
    if (rest.size() < kMinLinePoints) break;
    const bool are_long = std::all_of(lines.begin(), lines.begin() + count, [&](const Line& line) {
      return line.length_px > kMinLengthRatio * ExtentAlong(rest, {-line.normal.y(), line.normal.x()});
    });
    if (are_long) without = rest;
  }
  return without;
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/rasterizer.h"

#include <Eigen/Geometry>
#include <cmath>

#include "core/numerics/math.h"

namespace evpose {

PixelRect BoundingRect(absl::Span<const Eigen::Vector2d> points_px) {
  if (points_px.empty()) return {};
  Eigen::AlignedBox2d box;
  for (const Eigen::Vector2d& p : points_px) box.extend(p);
  // Coordinates far outside the image would not fit into an int.
  constexpr double kFar = 1e6;
  const auto pixel = [kFar](double v) { return static_cast<int>(std::floor(std::clamp(v, -kFar, kFar) + 0.5)); };
  return {pixel(box.min().x()), pixel(box.min().y()), pixel(box.max().x()) + 1, pixel(box.max().y()) + 1};
}

CoverageRasterizer::CoverageRasterizer(int width_px, int height_px)
    : width_px_(width_px),
      stride_(static_cast<size_t>(width_px) + 2),
      value_(stride_ * height_px),
      alpha_(stride_ * height_px) {}

void CoverageRasterizer::Begin(const PixelRect& rect) {
  rect_ = rect;
  if (rect.empty()) return;
  for (int y = rect.y0; y < rect.y1; ++y) {
    const size_t begin = y * stride_ + rect.x0;
    const size_t end = y * stride_ + rect.x1 + 2;
    std::fill(value_.begin() + begin, value_.begin() + end, 0.0f);
    std::fill(alpha_.begin() + begin, alpha_.begin() + end, 0.0f);
  }
}

void CoverageRasterizer::AddPolygon(absl::Span<const Eigen::Vector2d> points_px, double value, double alpha) {
  if (rect_.empty()) return;
  const Eigen::Vector2d half(0.5, 0.5);  // pixel (0, 0) becomes [0, 1] x [0, 1]
  for (size_t i = 0; i < points_px.size(); ++i) {
    const size_t next = i + 1 == points_px.size() ? 0 : i + 1;
    AddEdge(points_px[i] + half, points_px[next] + half, value, alpha);
  }
}

// Clips the edge at the borders of rect_. A part to the left of rect_ covers all pixels of its rows; a part to the
// right covers none.
void CoverageRasterizer::AddEdge(Eigen::Vector2d a, Eigen::Vector2d b, double value, double alpha) {
  if (a.y() == b.y()) return;
  // A downward edge has its polygon on the right when the winding is counter-clockwise on the screen.
  if (a.y() > b.y()) {
    std::swap(a, b);
    value = -value;
    alpha = -alpha;
  }
  const double top = rect_.y0;
  const double bottom = rect_.y1;
  if (b.y() <= top || a.y() >= bottom) return;
  const Eigen::Vector2d direction = (b - a) / (b.y() - a.y());
  const Eigen::Vector2d origin = a;
  if (a.y() < top) a = origin + direction * (top - origin.y());
  if (b.y() > bottom) b = origin + direction * (bottom - origin.y());

  const double left = rect_.x0;
  const double right = rect_.x1;
  const auto y_at = [&](double x) {
    return std::clamp(a.y() + (x - a.x()) / (b.x() - a.x()) * (b.y() - a.y()), a.y(), b.y());
  };
  double y0 = a.y();
  double x0 = a.x();
  // The crossings of the edge with the left and the right border, in order of y.
  double cuts[3];
  int num_cuts = 0;
  if ((a.x() < left) != (b.x() < left)) cuts[num_cuts++] = y_at(left);
  if ((a.x() > right) != (b.x() > right)) cuts[num_cuts++] = y_at(right);
  if (num_cuts == 2 && cuts[0] > cuts[1]) std::swap(cuts[0], cuts[1]);
  cuts[num_cuts++] = b.y();
  for (int i = 0; i < num_cuts; ++i) {
    const double y1 = cuts[i];
    const double x1 = i + 1 == num_cuts ? b.x() : a.x() + direction.x() * (y1 - a.y());
    const double middle = 0.5 * (x0 + x1);
    if (middle <= left) {
      AddEdgeInside(left, y0, left, y1, value, alpha);
    } else if (middle < right) {
      AddEdgeInside(std::clamp(x0, left, right), y0, std::clamp(x1, left, right), y1, value, alpha);
    }
    y0 = y1;
    x0 = x1;
  }
}

// Adds an edge inside rect_, with y0 <= y1.
void CoverageRasterizer::AddEdgeInside(double x0, double y0, double x1, double y1, double value, double alpha) {
  if (y1 <= y0) return;
  const double slope = (x1 - x0) / (y1 - y0);
  const double x_low = std::min(x0, x1);
  const double x_high = std::max(x0, x1);
  double y = y0;
  double x = x0;
  for (int row = static_cast<int>(y0); row < rect_.y1 && y < y1; ++row) {
    const double y_end = std::min<double>(row + 1, y1);
    const double x_end = std::clamp(x0 + (y_end - y0) * slope, x_low, x_high);
    const double height = y_end - y;
    AddRowPiece(row, x, x_end, value * height, alpha * height);
    y = y_end;
    x = x_end;
  }
}

// Adds a piece of an edge within one row, from xa to xb. `value` and `alpha` are already multiplied by its height.
void CoverageRasterizer::AddRowPiece(int row, double xa, double xb, double value, double alpha) {
  if (xa > xb) std::swap(xa, xb);
  float* values = value_.data() + row * stride_;
  float* alphas = alpha_.data() + row * stride_;
  const auto add = [&](int column, double share) {
    values[column] += static_cast<float>(value * share);
    alphas[column] += static_cast<float>(alpha * share);
  };
  const int first = static_cast<int>(xa);
  if (xb <= first + 1) {
    // Within one pixel: that pixel is covered from the mean position of the edge to its right border, and all later
    // pixels are covered entirely.
    const double uncovered = 0.5 * (xa + xb) - first;
    add(first, 1.0 - uncovered);
    add(first + 1, uncovered);
    return;
  }
  const int last = static_cast<int>(std::ceil(xb)) - 1;
  // The edge crosses several pixels: `covered` is the mean covered share of each pixel in turn; its differences are
  // stored.
  const double per_pixel = 1.0 / (xb - xa);
  double stored = 0.0;
  for (int column = first; column <= last; ++column) {
    const double from = std::max<double>(xa, column);
    const double to = std::min<double>(xb, column + 1);
    // The share of the piece's height that lies in this column, and in the columns before it.
    const double here = (to - from) * per_pixel;
    const double before = (from - xa) * per_pixel;
    const double covered = before + here * (column + 1 - 0.5 * (from + to));
    add(column, covered - stored);
    stored = covered;
  }
  add(last + 1, 1.0 - stored);
}

void CoverageRasterizer::CompositeOnto(std::vector<float>& picture) const {
  for (int y = rect_.y0; y < rect_.y1; ++y) {
    const float* values = value_.data() + y * stride_;
    const float* alphas = alpha_.data() + y * stride_;
    float* pixels = picture.data() + static_cast<size_t>(y) * width_px_;
    float value = 0.0f;
    float alpha = 0.0f;
    for (int x = rect_.x0; x < rect_.x1; ++x) {
      value += values[x];
      alpha += alphas[x];
      pixels[x] = pixels[x] * (1.0f - alpha) + value;
    }
  }
}

GaussianBlur::GaussianBlur(double sigma_px) {
  if (sigma_px <= 0.0) {
    taps_ = {1.0f};
    return;
  }
  const int radius = static_cast<int>(std::ceil(3.0 * sigma_px));  // 0.3 % of a normal distribution lies beyond
  std::vector<double> taps(radius + 1);
  double sum = 0.0;
  for (int i = 0; i <= radius; ++i) {
    taps[i] = DeterministicExp(-0.5 * i * i / (sigma_px * sigma_px));
    sum += i == 0 ? taps[i] : 2.0 * taps[i];
  }
  for (const double tap : taps) taps_.push_back(static_cast<float>(tap / sum));
}

void GaussianBlur::BlurRow(const float* source, int width_px, int x0, int x1, float* target) const {
  const int radius = radius_px();
  const auto at = [&](int x) { return source[std::clamp(x, 0, width_px - 1)]; };
  const auto slow = [&](int from, int to) {
    for (int x = from; x < to; ++x) {
      float sum = taps_[0] * source[x];
      for (int k = 1; k <= radius; ++k) sum += taps_[k] * (at(x - k) + at(x + k));
      target[x] = sum;
    }
  };
  const int inner0 = std::clamp(radius, x0, x1);
  const int inner1 = std::clamp(width_px - radius, inner0, x1);
  slow(x0, inner0);
  for (int x = inner0; x < inner1; ++x) target[x] = taps_[0] * source[x];
  for (int k = 1; k <= radius; ++k) {
    const float tap = taps_[k];
    for (int x = inner0; x < inner1; ++x) target[x] += tap * (source[x - k] + source[x + k]);
  }
  slow(inner1, x1);
}

void GaussianBlur::Apply(const std::vector<float>& source, int width_px, int height_px, const PixelRect& rect,
                         std::vector<float>& target) {
  if (rect.empty()) return;
  const int radius = radius_px();
  const size_t stride = width_px;
  const int y_low = std::max(0, rect.y0 - radius);
  const int y_high = std::min(height_px, rect.y1 + radius);
  rows_.resize(stride * height_px);
  for (int y = y_low; y < y_high; ++y) {
    BlurRow(source.data() + y * stride, width_px, rect.x0, rect.x1, rows_.data() + y * stride);
  }
  for (int y = rect.y0; y < rect.y1; ++y) {
    float* out = target.data() + y * stride;
    const float* centre = rows_.data() + y * stride;
    for (int x = rect.x0; x < rect.x1; ++x) out[x] = taps_[0] * centre[x];
    for (int k = 1; k <= radius; ++k) {
      const float* above = rows_.data() + std::max(0, y - k) * stride;
      const float* below = rows_.data() + std::min(height_px - 1, y + k) * stride;
      const float tap = taps_[k];
      for (int x = rect.x0; x < rect.x1; ++x) out[x] += tap * (above[x] + below[x]);
    }
  }
}

}  // namespace evpose

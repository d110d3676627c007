// SPDX-License-Identifier: Apache-2.0

// Polygons to pixels with exact area coverage: an edge that moves by any fraction of a pixel changes the picture by
// just that, so no quantisation of the anti-aliasing shows in the times of events.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <vector>

#include "absl/types/span.h"

namespace evpose {

// Pixels x0 <= x < x1, y0 <= y < y1.
struct PixelRect {
  int x0 = 0;
  int y0 = 0;
  int x1 = 0;
  int y1 = 0;

  bool empty() const { return x0 >= x1 || y0 >= y1; }
  PixelRect Union(const PixelRect& other) const {
    if (empty()) return other;
    if (other.empty()) return *this;
    return {std::min(x0, other.x0), std::min(y0, other.y0), std::max(x1, other.x1), std::max(y1, other.y1)};
  }
  PixelRect Grown(int margin) const { return {x0 - margin, y0 - margin, x1 + margin, y1 + margin}; }
  PixelRect Intersection(const PixelRect& other) const {
    return {std::max(x0, other.x0), std::max(y0, other.y0), std::min(x1, other.x1), std::min(y1, other.y1)};
  }

  friend bool operator==(const PixelRect&, const PixelRect&) = default;
};

// Pixels that a polygon may touch; pixel (0, 0) reaches from -0.5 to 0.5.
PixelRect BoundingRect(absl::Span<const Eigen::Vector2d> points_px);

// Sums of weight times covered area, over polygons that may have any shape. Each pixel's area is integrated exactly:
// the signed area to the right of every edge is accumulated as differences along the row, summed up at the end.
class CoverageRasterizer {
 public:
  CoverageRasterizer(int width_px, int height_px);

  // Forgets everything and clears the accumulators in `rect`, which must lie inside the image and hold all polygons
  // that follow, as far as they lie inside the image.
  void Begin(const PixelRect& rect);

  // Adds a polygon, vertices in pixels, wound counter-clockwise on the screen (x right, y down: a model's face seen
  // from outside). Wound the other way it subtracts.
  void AddPolygon(absl::Span<const Eigen::Vector2d> points_px, double value, double alpha);

  // Over `rect`: picture = picture (1 - sum of alpha) + sum of value. `picture` has the image's width as stride.
  void CompositeOnto(std::vector<float>& picture) const;

 private:
  void AddEdge(Eigen::Vector2d a, Eigen::Vector2d b, double value, double alpha);
  void AddEdgeInside(double x0, double y0, double x1, double y1, double value, double alpha);
  void AddRowPiece(int row, double xa, double xb, double value, double alpha);

  int width_px_;
  int height_px_;
  PixelRect rect_;
  size_t stride_;
  std::vector<float> value_;  // two columns more than the image
  std::vector<float> alpha_;
};

// Gaussian blur of `source` into `target` over `rect`, borders repeated. Both have `width_px` as stride. A sigma of 0
// copies.
class GaussianBlur {
 public:
  explicit GaussianBlur(double sigma_px);

  int radius_px() const { return static_cast<int>(taps_.size()) - 1; }
  void Apply(const std::vector<float>& source, int width_px, int height_px, const PixelRect& rect,
             std::vector<float>& target);

 private:
  void BlurRow(const float* source, int width_px, int x0, int x1, float* target) const;

  std::vector<float> taps_;  // centre first
  std::vector<float> rows_;  // blurred along x
};

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// Renders polygons with the exact area of their coverage of each pixel. The picture is a continuous function of the
// position of an edge, so that the times of events have no quantisation by anti-aliasing.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <vector>

#include "absl/types/span.h"

namespace evpose {

// A rectangle of pixels: x0 <= x < x1, y0 <= y < y1.
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

// Returns the pixels that a polygon may touch. Pixel (0, 0) extends from -0.5 to 0.5.
PixelRect BoundingRect(absl::Span<const Eigen::Vector2d> points_px);

// Accumulates, for each pixel, the sum of weight times covered area over polygons of any shape. Areas are exact: the
// signed area to the right of every edge is accumulated as differences along the row, which are summed at the end.
class CoverageRasterizer {
 public:
  CoverageRasterizer(int width_px, int height_px);

  // Begins a new sum over `rect`, which must lie inside the image and contain all later polygons, as far as they lie
  // inside the image.
  void Begin(const PixelRect& rect);

  // Adds a polygon with vertices in pixels, counter-clockwise on the screen (x right, y down; a model's face seen from
  // outside). A clockwise polygon is subtracted.
  void AddPolygon(absl::Span<const Eigen::Vector2d> points_px, double value, double alpha);

  // Computes picture = picture (1 - sum of alpha) + sum of value over `rect`. The stride of `picture` is the image's
  // width.
  void CompositeOnto(std::vector<float>& picture) const;

 private:
  void AddEdge(Eigen::Vector2d a, Eigen::Vector2d b, double value, double alpha);
  void AddEdgeInside(double x0, double y0, double x1, double y1, double value, double alpha);
  void AddRowPiece(int row, double xa, double xb, double value, double alpha);

  int width_px_;
  PixelRect rect_;
  size_t stride_;
  std::vector<float> value_;  // with two columns more than the image
  std::vector<float> alpha_;
};

// Gaussian blur with a standard deviation in pixels; 0 copies. Apply() writes the pixels of `rect` in `target`;
// `source` is extended beyond its borders by their values. The stride of both is `width_px`.
class GaussianBlur {
 public:
  explicit GaussianBlur(double sigma_px);

  int radius_px() const { return static_cast<int>(taps_.size()) - 1; }
  void Apply(const std::vector<float>& source, int width_px, int height_px, const PixelRect& rect,
             std::vector<float>& target);

 private:
  void BlurRow(const float* source, int width_px, int x0, int x1, float* target) const;

  std::vector<float> taps_;  // half of the symmetric filter, the centre first
  std::vector<float> rows_;  // the source blurred along x
};

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// Renders triangles that hide one another, with 16 samples in each pixel.
#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "core/simulation/rasterizer.h"

namespace evpose {

struct ScreenVertex {
  Eigen::Vector2d point_px;
  float inverse_depth = 0.0f;  // 1 / m; positive
  float light = 0.0f;          // 1 is white paint under full light
};

// The columns and the rows of the 16 samples of a pixel are all different (Hammersley's points): the covered area
// behind an edge along a column or row changes in steps of 1/16.
class MeshRasterizer {
 public:
  static constexpr int kSamples = 16;

  // Begins a new picture of `rect`, which must lie inside the image.
  void Begin(const PixelRect& rect);
  // Draws a triangle of either winding. Depth and light are linear between the corners. Parts outside `rect` are not
  // drawn.
  void AddTriangle(const std::array<const ScreenVertex*, 3>& corners);
  // Replaces the share of each pixel that triangles cover. The stride of `picture` is `width_px`.
  void CompositeOnto(int width_px, std::vector<float>& picture) const;

 private:
  using Samples = std::array<float, kSamples>;
  struct Plane;

  PixelRect rect_;
  // Of each pixel of rect_, row by row.
  std::vector<Samples> inverse_depth_;  // 0: no triangle
  std::vector<Samples> light_;
};

}  // namespace evpose

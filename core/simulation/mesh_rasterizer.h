// SPDX-License-Identifier: Apache-2.0

// Renders triangles that hide one another. Pixels at edges have 16 samples.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/simulation/rasterizer.h"

namespace evpose {

struct ScreenVertex {
  Eigen::Vector2d point_px;
  float inverse_depth = 0.0f;  // 1 / m; positive
  float light = 0.0f;          // 1 is white paint under full light
};

// The mesh that is rendered; the other members have indices of `vertices`.
struct ScreenMesh {
  absl::Span<const ScreenVertex> vertices;
  absl::Span<const std::array<uint32_t, 3>>
      triangles;  // triangles of either winding; depth and light are linear on each
  // The segments at which the light or the depth may be discontinuous: borders, creases and contours of the surface.
  absl::Span<const std::array<uint32_t, 2>> edges;
};

// A pixel is sampled 16 times if an edge touches it or if the light is not linear around it, as where two surfaces
// intersect. The columns and the rows of its samples are all different (Hammersley's points): the covered area behind
// an edge along a column or row changes in steps of 1/16. Any other pixel lies inside a smooth surface, so that its
// mean light is the light at its centre.
class MeshRasterizer {
 public:
  static constexpr int kSamples = 16;

  // Replaces the picture. Nothing is drawn outside `rect`, which must lie inside the image.
  void Render(const PixelRect& rect, const ScreenMesh& mesh);
  // Replaces the share of each pixel that triangles cover. The stride of `picture` is `width_px`.
  void CompositeOnto(int width_px, std::vector<float>& picture) const;

 private:
  struct Plane;
  struct Facet;
  struct FacetDifferences;
  struct Centre {
    float inverse_depth = 0.0f;  // 0: no triangle
    float light = 0.0f;
  };
  struct Samples {
    std::array<float, kSamples> inverse_depth = {};
    std::array<float, kSamples> light = {};
  };

  size_t width() const { return static_cast<size_t>(rect_.x1 - rect_.x0); }
  size_t IndexOf(int x, int y) const { return static_cast<size_t>(y - rect_.y0) * width() + (x - rect_.x0); }
  // Whether a pixel of `box`, which is empty or lies inside rect_, has a property of its index.
  bool IsAnyOf(const PixelRect& box, auto has_property) const;
  void DrawCentres(const std::array<const ScreenVertex*, 3>& corners);
  void MarkEdge(const Eigen::Vector2d& a_px, const Eigen::Vector2d& b_px);
  void MarkBends();
  void Mark(int x, int y);
  void DrawSamples(const std::array<const ScreenVertex*, 3>& corners);
  static void DrawPixel(const Facet& facet, const FacetDifferences& differences, int x, int y, Samples& samples);

  PixelRect rect_;
  // The centres of the pixels of rect_, row by row.
  std::vector<Centre> centres_;
  std::vector<uint32_t> samples_of_;  // index of samples_ plus 1; 0: only the centre is sampled
  std::vector<Samples> samples_;
};

}  // namespace evpose

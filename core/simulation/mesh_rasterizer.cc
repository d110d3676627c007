// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/mesh_rasterizer.h"

#include <algorithm>
#include <cmath>

namespace evpose {
namespace {

using Eigen::Vector2d;

constexpr int kNum = MeshRasterizer::kSamples;
// Pixels by which triangles are enlarged, so that the rounding of single precision leaves no gap between neighbours.
constexpr float kOverlapPx = 1e-4f;
// Twice the area in square pixels below which a triangle is not drawn: a needle that contains no sample.
constexpr double kMinArea = 1e-7;

// Samples relative to the pixel's centre: x = (k + 1/2) / 16 - 1/2, and y the same with the bits of k reversed.
constexpr std::array<float, kNum> MakeOffsets(bool is_reversed) {
  std::array<float, kNum> offsets = {};
  for (int k = 0; k < kNum; ++k) {
    const int reversed = ((k & 1) << 3) | ((k & 2) << 1) | ((k & 4) >> 1) | ((k & 8) >> 3);
    offsets[k] = (static_cast<float>(is_reversed ? reversed : k) + 0.5f) / kNum - 0.5f;
  }
  return offsets;
}
constexpr std::array<float, kNum> kOffsetX = MakeOffsets(false);
constexpr std::array<float, kNum> kOffsetY = MakeOffsets(true);

double Cross(const Vector2d& a, const Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

}  // namespace

// A linear function of the position in the image: its value at `origin`, its gradient, and its differences from a
// pixel's centre to the samples.
struct MeshRasterizer::Plane {
  Vector2d origin;
  double value;
  Vector2d gradient;
  Samples differences;

  Plane(const Vector2d& origin_px, double value_there, const Vector2d& gradient_per_px)
      : origin(origin_px), value(value_there), gradient(gradient_per_px) {
    for (int k = 0; k < kNum; ++k) {
      differences[k] = static_cast<float>(gradient.x() * kOffsetX[k] + gradient.y() * kOffsetY[k]);
    }
  }
  float At(int x, int y) const { return static_cast<float>(value + gradient.dot(Vector2d(x, y) - origin)); }

  // The distance from the line a b in pixels, positive on the side of the triangle.
  static Plane Edge(const Vector2d& a, const Vector2d& b, double orientation) {
    const Vector2d along = b - a;
    const double length = std::max(along.norm(), 1e-12);
    return {a, 0.0, Vector2d(-along.y(), along.x()) * (orientation / length)};
  }
  // The function with these values at the corners.
  static Plane Through(const std::array<Vector2d, 3>& p, double area, const std::array<float, 3>& values) {
    const double u = static_cast<double>(values[1]) - values[0];
    const double v = static_cast<double>(values[2]) - values[0];
    const Vector2d b = p[1] - p[0];
    const Vector2d c = p[2] - p[0];
    return {p[0], values[0], Vector2d(u * c.y() - v * b.y(), v * b.x() - u * c.x()) / area};
  }
};

void MeshRasterizer::Begin(const PixelRect& rect) {
  rect_ = rect;
  const size_t num_pixels = rect.empty() ? 0 : static_cast<size_t>(rect.x1 - rect.x0) * (rect.y1 - rect.y0);
  inverse_depth_.assign(num_pixels, {});
  light_.resize(num_pixels);
}

void MeshRasterizer::AddTriangle(const std::array<const ScreenVertex*, 3>& corners) {
  const std::array<Vector2d, 3> p = {corners[0]->point_px, corners[1]->point_px, corners[2]->point_px};
  const double area = Cross(p[1] - p[0], p[2] - p[0]);
  if (!(std::abs(area) > kMinArea)) return;
  const PixelRect box = BoundingRect(p).Intersection(rect_);
  if (box.empty()) return;
  const double orientation = area > 0.0 ? 1.0 : -1.0;
  const Plane edges[3] = {Plane::Edge(p[0], p[1], orientation), Plane::Edge(p[1], p[2], orientation),
                          Plane::Edge(p[2], p[0], orientation)};
  const std::array<float, 3> depths = {corners[0]->inverse_depth, corners[1]->inverse_depth, corners[2]->inverse_depth};
  const std::array<float, 3> lights = {corners[0]->light, corners[1]->light, corners[2]->light};
  const auto [depth_low, depth_high] = std::minmax_element(depths.begin(), depths.end());
  const auto [light_low, light_high] = std::minmax_element(lights.begin(), lights.end());
  const Plane depth_plane = Plane::Through(p, area, depths);
  const Plane light_plane = Plane::Through(p, area, lights);
  constexpr float kHalfDiagonalPx = 0.70711f;
  for (int y = box.y0; y < box.y1; ++y) {
    for (int x = box.x0; x < box.x1; ++x) {
      const float e0 = edges[0].At(x, y), e1 = edges[1].At(x, y), e2 = edges[2].At(x, y);
      if (std::min({e0, e1, e2}) < -kHalfDiagonalPx) continue;
      const float depth = depth_plane.At(x, y), light = light_plane.At(x, y);
      const size_t pixel = static_cast<size_t>(y - rect_.y0) * (rect_.x1 - rect_.x0) + (x - rect_.x0);
      float* depths_here = inverse_depth_[pixel].data();
      float* lights_here = light_[pixel].data();
      for (int k = 0; k < kNum; ++k) {
        const float inside = std::min(std::min(e0 + edges[0].differences[k], e1 + edges[1].differences[k]),
                                      e2 + edges[2].differences[k]);
        // A needle has steep gradients: values are limited to those of the corners.
        const float d = std::min(std::max(depth + depth_plane.differences[k], *depth_low), *depth_high);
        const float l = std::min(std::max(light + light_plane.differences[k], *light_low), *light_high);
        const bool is_seen = (inside >= -kOverlapPx) & (d > depths_here[k]);
        depths_here[k] = is_seen ? d : depths_here[k];
        lights_here[k] = is_seen ? l : lights_here[k];
      }
    }
  }
}

void MeshRasterizer::CompositeOnto(int width_px, std::vector<float>& picture) const {
  size_t pixel = 0;
  for (int y = rect_.y0; y < rect_.y1; ++y) {
    float* row = picture.data() + static_cast<size_t>(y) * width_px;
    for (int x = rect_.x0; x < rect_.x1; ++x, ++pixel) {
      float sum = 0.0f;
      int covered = 0;
      for (int k = 0; k < kNum; ++k) {
        const bool is_covered = inverse_depth_[pixel][k] > 0.0f;
        sum += is_covered ? light_[pixel][k] : 0.0f;
        covered += static_cast<int>(is_covered);
      }
      if (covered > 0) row[x] = (sum + static_cast<float>(kNum - covered) * row[x]) / kNum;
    }
  }
}

}  // namespace evpose

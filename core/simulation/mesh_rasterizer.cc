// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/mesh_rasterizer.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <tuple>
#include <utility>

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

// A linear function of the position in the image, by its value at `origin` and its gradient.
struct MeshRasterizer::Plane {
  Vector2d origin;
  double value;
  Vector2d gradient;

  float At(int x, int y) const { return static_cast<float>(value + gradient.dot(Vector2d(x, y) - origin)); }
  // Differences from a pixel's centre to its samples.
  std::array<float, kSamples> Differences() const {
    std::array<float, kSamples> differences;
    for (int k = 0; k < kNum; ++k) {
      differences[k] = static_cast<float>(gradient.x() * kOffsetX[k] + gradient.y() * kOffsetY[k]);
    }
    return differences;
  }

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

// A triangle in the image. A needle has steep gradients, so that depth and light are limited to the values of the
// corners.
struct MeshRasterizer::Facet {
  std::array<Plane, 3> edges;
  Plane depth;
  Plane light;
  float depth_low, depth_high, light_low, light_high;
  std::array<double, 3> inverse_step;  // reciprocals of the differences of `edges` between columns

  Facet(const std::array<const ScreenVertex*, 3>& corners, double area) : Facet(corners, PointsOf(corners), area) {}
  static std::array<Vector2d, 3> PointsOf(const std::array<const ScreenVertex*, 3>& corners) {
    return {corners[0]->point_px, corners[1]->point_px, corners[2]->point_px};
  }

  // The columns of row `y`, within `box`, whose centres are inside the triangle or up to `margin_px` outside its edges.
  std::pair<int, int> ColumnsOf(int y, const PixelRect& box, double margin_px) const {
    double low = box.x0, high = box.x1 - 1;
    for (int i = 0; i < 3; ++i) {
      // Signed distance of the centre of column 0, plus the margin.
      const Plane& edge = edges[i];
      const double at_0 = (y - edge.origin.y()) * edge.gradient.y() - edge.origin.x() * edge.gradient.x() + margin_px;
      const double column = -at_0 * inverse_step[i];
      if (edge.gradient.x() > 0.0) {
        low = std::max(low, column);
      } else if (edge.gradient.x() < 0.0) {
        high = std::min(high, column);
      } else if (at_0 < 0.0) {
        return {0, 0};
      }
    }
    if (low > high) return {0, 0};
    return {static_cast<int>(std::ceil(low)), static_cast<int>(std::floor(high)) + 1};
  }

 private:
  Facet(const std::array<const ScreenVertex*, 3>& corners, const std::array<Vector2d, 3>& p, double area)
      : edges{Plane::Edge(p[0], p[1], area > 0.0 ? 1.0 : -1.0), Plane::Edge(p[1], p[2], area > 0.0 ? 1.0 : -1.0),
              Plane::Edge(p[2], p[0], area > 0.0 ? 1.0 : -1.0)},
        depth(
            Plane::Through(p, area, {corners[0]->inverse_depth, corners[1]->inverse_depth, corners[2]->inverse_depth})),
        light(Plane::Through(p, area, {corners[0]->light, corners[1]->light, corners[2]->light})) {
    std::tie(depth_low, depth_high) =
        std::minmax({corners[0]->inverse_depth, corners[1]->inverse_depth, corners[2]->inverse_depth});
    std::tie(light_low, light_high) = std::minmax({corners[0]->light, corners[1]->light, corners[2]->light});
    for (int i = 0; i < 3; ++i) inverse_step[i] = edges[i].gradient.x() != 0.0 ? 1.0 / edges[i].gradient.x() : 0.0;
  }
};

// Differences of the functions of a facet from a pixel's centre to its samples.
struct MeshRasterizer::FacetDifferences {
  std::array<std::array<float, kSamples>, 3> edges;
  std::array<float, kSamples> depth;
  std::array<float, kSamples> light;

  explicit FacetDifferences(const Facet& facet)
      : edges{facet.edges[0].Differences(), facet.edges[1].Differences(), facet.edges[2].Differences()},
        depth(facet.depth.Differences()),
        light(facet.light.Differences()) {}
};

void MeshRasterizer::Render(const PixelRect& rect, const ScreenMesh& mesh) {
  rect_ = rect;
  const size_t num_pixels = rect.empty() ? 0 : width() * static_cast<size_t>(rect.y1 - rect.y0);
  centres_.assign(num_pixels, {});
  samples_of_.assign(num_pixels, 0);
  samples_.clear();
  if (num_pixels == 0) return;
  const auto corners = [&mesh](const std::array<uint32_t, 3>& triangle) -> std::array<const ScreenVertex*, 3> {
    return {&mesh.vertices[triangle[0]], &mesh.vertices[triangle[1]], &mesh.vertices[triangle[2]]};
  };
  for (const auto& triangle : mesh.triangles) DrawCentres(corners(triangle));
  for (const auto& [a, b] : mesh.edges) MarkEdge(mesh.vertices[a].point_px, mesh.vertices[b].point_px);
  MarkBends();
  for (const auto& triangle : mesh.triangles) DrawSamples(corners(triangle));
}

bool MeshRasterizer::IsAnyOf(const PixelRect& box, auto has_property) const {
  for (int y = box.y0; y < box.y1; ++y) {
    for (size_t pixel = IndexOf(box.x0, y), end = pixel + (box.x1 - box.x0); pixel < end; ++pixel) {
      if (has_property(pixel)) return true;
    }
  }
  return false;
}

void MeshRasterizer::DrawCentres(const std::array<const ScreenVertex*, 3>& corners) {
  const std::array<Vector2d, 3> p = Facet::PointsOf(corners);
  const double area = Cross(p[1] - p[0], p[2] - p[0]);
  if (!(std::abs(area) > kMinArea)) return;
  // The pixels whose centres may lie inside; most small triangles contain none.
  PixelRect box = BoundingRect(p).Intersection(rect_);
  const Vector2d low = p[0].cwiseMin(p[1]).cwiseMin(p[2]).array() - kOverlapPx;
  const Vector2d high = p[0].cwiseMax(p[1]).cwiseMax(p[2]).array() + kOverlapPx;
  while (box.x0 < box.x1 && box.x0 < low.x()) ++box.x0;
  while (box.y0 < box.y1 && box.y0 < low.y()) ++box.y0;
  while (box.x0 < box.x1 && box.x1 - 1 > high.x()) --box.x1;
  while (box.y0 < box.y1 && box.y1 - 1 > high.y()) --box.y1;
  // Half of the triangles are behind others, which hide them if they have been drawn before.
  const float depth_high = std::max({corners[0]->inverse_depth, corners[1]->inverse_depth, corners[2]->inverse_depth});
  if (!IsAnyOf(box, [&](size_t pixel) { return centres_[pixel].inverse_depth < depth_high; })) return;
  const Facet facet(corners, area);
  for (int y = box.y0; y < box.y1; ++y) {
    const auto [begin, end] = facet.ColumnsOf(y, box, kOverlapPx);
    for (int x = begin; x < end; ++x) {
      const float depth = std::clamp(facet.depth.At(x, y), facet.depth_low, facet.depth_high);
      Centre& centre = centres_[IndexOf(x, y)];
      if (depth <= centre.inverse_depth) continue;
      centre = {depth, std::clamp(facet.light.At(x, y), facet.light_low, facet.light_high)};
    }
  }
}

void MeshRasterizer::Mark(int x, int y) {
  if (x < rect_.x0 || x >= rect_.x1 || y < rect_.y0 || y >= rect_.y1) return;
  uint32_t& samples = samples_of_[IndexOf(x, y)];
  if (samples > 0) return;
  samples_.emplace_back();
  samples = static_cast<uint32_t>(samples_.size());
}

void MeshRasterizer::MarkEdge(const Vector2d& a_px, const Vector2d& b_px) {
  constexpr double kMarginPx = 0.01;  // for rounding
  // Steps along the axis in which the segment is longer.
  const int major = std::abs(b_px.x() - a_px.x()) >= std::abs(b_px.y() - a_px.y()) ? 0 : 1;
  const int minor = 1 - major;
  Vector2d a = a_px, b = b_px;
  if (a[major] > b[major]) std::swap(a, b);
  const Vector2d ends[] = {a, b};
  const PixelRect box = BoundingRect(ends).Grown(1).Intersection(rect_);
  const double length = b[major] - a[major];
  const double slope = length > 0.0 ? (b[minor] - a[minor]) / length : 0.0;
  const int from = major == 0 ? box.x0 : box.y0, to = major == 0 ? box.x1 : box.y1;
  for (int i = from; i < to; ++i) {
    // The part of the segment in this column or row.
    const double begin = std::max(a[major], i - 0.5 - kMarginPx), end = std::min(b[major], i + 0.5 + kMarginPx);
    if (begin > end) continue;
    const auto [low, high] = std::minmax({a[minor] + slope * (begin - a[major]), a[minor] + slope * (end - a[major])});
    const int first = static_cast<int>(std::floor(low - kMarginPx + 0.5));
    const int last = static_cast<int>(std::floor(high + kMarginPx + 0.5));
    for (int j = first; j <= last; ++j) major == 0 ? Mark(i, j) : Mark(j, i);
  }
}

void MeshRasterizer::MarkBends() {
  // The mean of a pixel differs from the light at its centre by up to a twelfth of the second difference: 0.2 %, a
  // hundredth of the contrast that causes an event.
  constexpr float kMaxBend = 0.02f;
  const auto light = [this](size_t pixel) {
    return centres_[pixel].inverse_depth > 0.0f ? centres_[pixel].light : -1.0f;
  };
  const size_t stride = width();
  for (int y = rect_.y0 + 1; y + 1 < rect_.y1; ++y) {
    for (int x = rect_.x0 + 1; x + 1 < rect_.x1; ++x) {
      const size_t pixel = IndexOf(x, y);
      const float twice = 2.0f * light(pixel);
      float bend = 0.0f;
      for (const size_t step : {size_t{1}, stride, stride + 1, stride - 1}) {
        bend = std::max(bend, std::abs(light(pixel - step) - twice + light(pixel + step)));
      }
      if (bend > kMaxBend * std::abs(light(pixel))) Mark(x, y);
    }
  }
}

void MeshRasterizer::DrawSamples(const std::array<const ScreenVertex*, 3>& corners) {
  const std::array<Vector2d, 3> p = Facet::PointsOf(corners);
  const double area = Cross(p[1] - p[0], p[2] - p[0]);
  if (!(std::abs(area) > kMinArea)) return;
  const PixelRect box = BoundingRect(p).Intersection(rect_);
  // Most triangles have no pixel with samples.
  if (!IsAnyOf(box, [&](size_t pixel) { return samples_of_[pixel] > 0; })) return;
  const Facet facet(corners, area);
  std::optional<FacetDifferences> differences;  // computed for the first pixel with samples inside the triangle
  constexpr double kHalfDiagonalPx = 0.70711;   // the samples of a pixel are at most so far from its centre
  for (int y = box.y0; y < box.y1; ++y) {
    const auto [begin, end] = facet.ColumnsOf(y, box, kHalfDiagonalPx);
    for (int x = begin; x < end; ++x) {
      const uint32_t index = samples_of_[IndexOf(x, y)];
      if (index == 0) continue;
      if (!differences) differences.emplace(facet);
      DrawPixel(facet, *differences, x, y, samples_[index - 1]);
    }
  }
}

void MeshRasterizer::DrawPixel(const Facet& facet, const FacetDifferences& differences, int x, int y,
                               Samples& samples) {
  const float e0 = facet.edges[0].At(x, y), e1 = facet.edges[1].At(x, y), e2 = facet.edges[2].At(x, y);
  const float depth = facet.depth.At(x, y), light = facet.light.At(x, y);
  for (int k = 0; k < kNum; ++k) {
    const float inside =
        std::min(std::min(e0 + differences.edges[0][k], e1 + differences.edges[1][k]), e2 + differences.edges[2][k]);
    const float d = std::min(std::max(depth + differences.depth[k], facet.depth_low), facet.depth_high);
    const float l = std::min(std::max(light + differences.light[k], facet.light_low), facet.light_high);
    const bool is_seen = (inside >= -kOverlapPx) & (d > samples.inverse_depth[k]);
    samples.inverse_depth[k] = is_seen ? d : samples.inverse_depth[k];
    samples.light[k] = is_seen ? l : samples.light[k];
  }
}

void MeshRasterizer::CompositeOnto(int width_px, std::vector<float>& picture) const {
  size_t pixel = 0;
  for (int y = rect_.y0; y < rect_.y1; ++y) {
    float* row = picture.data() + static_cast<size_t>(y) * width_px;
    for (int x = rect_.x0; x < rect_.x1; ++x, ++pixel) {
      if (samples_of_[pixel] == 0) {
        if (centres_[pixel].inverse_depth > 0.0f) row[x] = centres_[pixel].light;
        continue;
      }
      const Samples& samples = samples_[samples_of_[pixel] - 1];
      float sum = 0.0f;
      int covered = 0;
      for (int k = 0; k < kNum; ++k) {
        const bool is_covered = samples.inverse_depth[k] > 0.0f;
        sum += is_covered ? samples.light[k] : 0.0f;
        covered += static_cast<int>(is_covered);
      }
      if (covered > 0) row[x] = (sum + static_cast<float>(kNum - covered) * row[x]) / kNum;
    }
  }
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// Compares the elements with the discontinuities of a depth image that is rendered with 8 x 8 samples per pixel.
#include <gtest/gtest.h>

#include <limits>

#include "core/contours/contour_shapes_testing.h"
#include "core/contours/edge_elements.h"

namespace evpose {
namespace {

constexpr int kSamples = 8;      // per pixel along each axis
constexpr double kJumpM = 0.01;  // a difference of depth between neighbouring samples that is an edge

class DepthImage {
 public:
  explicit DepthImage(const CameraModel& camera)
      : width_(camera.width_px * kSamples),
        height_(camera.height_px * kSamples),
        inverse_(static_cast<size_t>(width_) * height_, 0.0f) {}

  void Draw(const CameraModel& camera, const RigidTransform& pose, const ObjectModel& model) {
    for (const auto& corners : model.triangles) {
      std::array<Eigen::Vector3d, 3> p;  // column, row, inverse depth
      for (int k = 0; k < 3; ++k) {
        const Eigen::Vector3d point = pose * model.vertices[corners[k]];
        const Eigen::Vector2d pixel = camera.Project(point);
        p[k] = {(pixel.x() + 0.5) * kSamples - 0.5, (pixel.y() + 0.5) * kSamples - 0.5, 1.0 / point.z()};
      }
      Fill(p);
    }
  }

  // Middles of the sides between samples where the depth jumps, pixels.
  std::vector<Eigen::Vector2d> Edges() const {
    std::vector<Eigen::Vector2d> edges;
    const auto jumps = [&](float a, float b) {
      if (a == 0.0f || b == 0.0f) return a != b;
      return std::abs(1.0f / a - 1.0f / b) > kJumpM;
    };
    const auto pixel = [](double sample) { return (sample + 0.5) / kSamples - 0.5; };
    for (int y = 0; y + 1 < height_; ++y) {
      for (int x = 0; x + 1 < width_; ++x) {
        const float depth = inverse_[y * width_ + x];
        if (jumps(depth, inverse_[y * width_ + x + 1])) edges.emplace_back(pixel(x + 0.5), pixel(y));
        if (jumps(depth, inverse_[(y + 1) * width_ + x])) edges.emplace_back(pixel(x), pixel(y + 0.5));
      }
    }
    return edges;
  }

 private:
  void Fill(const std::array<Eigen::Vector3d, 3>& p) {
    const auto cross = [](const Eigen::Vector3d& a, const Eigen::Vector3d& b, double x, double y) {
      return (b.x() - a.x()) * (y - a.y()) - (b.y() - a.y()) * (x - a.x());
    };
    const double area = cross(p[0], p[1], p[2].x(), p[2].y());
    if (area == 0.0) return;
    const auto [x1, x2] = std::minmax({p[0].x(), p[1].x(), p[2].x()});
    const auto [y1, y2] = std::minmax({p[0].y(), p[1].y(), p[2].y()});
    for (int y = std::max(0, static_cast<int>(std::ceil(y1))); y <= std::min<double>(y2, height_ - 1); ++y) {
      for (int x = std::max(0, static_cast<int>(std::ceil(x1))); x <= std::min<double>(x2, width_ - 1); ++x) {
        const double a = cross(p[1], p[2], x, y) / area, b = cross(p[2], p[0], x, y) / area, c = 1.0 - a - b;
        if (a < 0.0 || b < 0.0 || c < 0.0) continue;
        float& inverse = inverse_[y * width_ + x];
        inverse = std::max(inverse, static_cast<float>(a * p[0].z() + b * p[1].z() + c * p[2].z()));
      }
    }
  }

  int width_, height_;
  std::vector<float> inverse_;
};

// Points by pixel, to find the nearest one within a pixel.
class PointGrid {
 public:
  PointGrid(const CameraModel& camera, const std::vector<Eigen::Vector2d>& points)
      : width_(camera.width_px + 4), cells_(static_cast<size_t>(width_) * (camera.height_px + 4)) {
    for (const Eigen::Vector2d& point : points) cells_[CellOf(point)].push_back(point);
  }

  double Distance(const Eigen::Vector2d& point) const {
    double least = std::numeric_limits<double>::infinity();
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dx = -1; dx <= 1; ++dx) {
        for (const Eigen::Vector2d& other : cells_[CellOf(point + Eigen::Vector2d(dx, dy))]) {
          least = std::min(least, (other - point).norm());
        }
      }
    }
    return least;
  }

 private:
  size_t CellOf(const Eigen::Vector2d& point) const {
    return static_cast<size_t>(std::floor(point.y()) + 2.0) * width_ + static_cast<size_t>(std::floor(point.x()) + 2.0);
  }

  int width_;
  std::vector<std::vector<Eigen::Vector2d>> cells_;
};

ObjectModel Joined(ObjectModel a, const ObjectModel& b, const Eigen::Vector3d& shift) {
  const auto first = static_cast<uint32_t>(a.vertices.size());
  const auto first_region = static_cast<uint32_t>(a.surface.regions.size());
  for (const Eigen::Vector3d& vertex : b.vertices) a.vertices.push_back(vertex + shift);
  for (auto corners : b.triangles) {
    for (uint32_t& corner : corners) corner += first;
    a.triangles.push_back(corners);
  }
  for (const uint32_t region : b.surface.region_of) a.surface.region_of.push_back(region + first_region);
  a.surface.normals.insert(a.surface.normals.end(), b.surface.normals.begin(), b.surface.normals.end());
  for (SurfaceRegion region : b.surface.regions) {
    region.point += shift;
    a.surface.regions.push_back(region);
  }
  a.diameter_m = std::max(a.diameter_m, shift.norm() + 0.5 * (a.diameter_m + b.diameter_m));
  return a;
}

void CompareWithDepth(const ObjectModel& model, const Eigen::Vector3d& eye, const char* name) {
  const CameraModel camera = ContourCamera();
  const RigidTransform pose = ViewFrom(eye);
  DepthImage image(camera);
  image.Draw(camera, pose, model);
  const std::vector<Eigen::Vector2d> edges = image.Edges();
  ASSERT_GT(edges.size(), 1000u);
  std::vector<Eigen::Vector2d> samples;
  for (const EdgeElement& element : ElementsOf(model, eye)) {
    const Eigen::Vector2d p1 = camera.Project(pose * element.p1), p2 = camera.Project(pose * element.p2);
    const int count = static_cast<int>(std::ceil((p2 - p1).norm() / 0.25));
    for (int i = 0; i < count; ++i) samples.emplace_back(p1 + (i + 0.5) / count * (p2 - p1));
  }
  const PointGrid edge_grid(camera, edges), sample_grid(camera, samples);
  std::vector<double> distances_px;
  for (const Eigen::Vector2d& sample : samples) distances_px.push_back(edge_grid.Distance(sample));
  const auto is_false = [](double distance_px) { return distance_px > 1.0; };
  const auto num_false = std::count_if(distances_px.begin(), distances_px.end(), is_false);
  EXPECT_LT(static_cast<double>(num_false), 0.02 * static_cast<double>(samples.size())) << name;
  std::erase_if(distances_px, is_false);
  EXPECT_LT(Quantile(distances_px, 0.95), 0.15) << name;
  const auto num_found = std::count_if(edges.begin(), edges.end(),
                                       [&](const Eigen::Vector2d& edge) { return sample_grid.Distance(edge) <= 1.0; });
  EXPECT_GT(static_cast<double>(num_found), 0.95 * static_cast<double>(edges.size())) << name;
}

TEST(OutlineOracleTest, Torus) {
  const ObjectModel torus = TorusModel(0.1, 0.04, 320, 160);
  CompareWithDepth(torus, {0.0, 0.05, 0.6}, "from above");
  CompareWithDepth(torus, {0.45, 0.1, 0.35}, "oblique");
  CompareWithDepth(torus, {0.6, 0.1, 0.1}, "from the side");
}

TEST(OutlineOracleTest, Capsule) {
  const ObjectModel capsule = CapsuleModel(0.06, 0.05, 320, 199);
  CompareWithDepth(capsule, {0.4, 0.1, 0.1}, "from the side");
  CompareWithDepth(capsule, {0.2, 0.1, 0.4}, "oblique");
}

TEST(OutlineOracleTest, CylinderWithItsCreases) {
  CompareWithDepth(CylinderModel(0.08, 0.05, 720), {0.5, 0.1, 0.0}, "from the side");
}

TEST(OutlineOracleTest, SphereBehindATorus) {
  const ObjectModel scene = Joined(TorusModel(0.1, 0.04, 320, 160), SphereModel(0.08, 320, true), {0.03, 0.02, -0.2});
  CompareWithDepth(scene, {0.05, 0.1, 0.6}, "through the hole");
  CompareWithDepth(scene, {0.4, 0.1, 0.4}, "beside");
}

}  // namespace
}  // namespace evpose

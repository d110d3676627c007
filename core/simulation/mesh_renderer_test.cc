// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/mesh_renderer.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

namespace evpose {
namespace {

// A sphere of radius 0.1 m about (0.02, 0, 0) of `rows` x 2 `rows` quadrilaterals, with its exact normals.
ObjectModel SphereOf(int rows) {
  constexpr double kRadius = 0.1;
  ObjectModel model;
  std::vector<Eigen::Vector3d> normals;
  const auto add_point = [&](double polar, double azimuth) {
    normals.emplace_back(std::sin(polar) * std::cos(azimuth), std::sin(polar) * std::sin(azimuth), std::cos(polar));
    model.vertices.emplace_back(Eigen::Vector3d(0.02, 0.0, 0.0) + kRadius * normals.back());
  };
  const int columns = 2 * rows;
  add_point(0.0, 0.0);
  for (int i = 1; i < rows; ++i) {
    for (int k = 0; k < columns; ++k) add_point(std::numbers::pi * i / rows, 2.0 * std::numbers::pi * k / columns);
  }
  add_point(std::numbers::pi, 0.0);
  const auto at = [&](int row, int column) -> uint32_t {
    if (row == 0) return 0;
    if (row == rows) return static_cast<uint32_t>(model.vertices.size() - 1);
    return static_cast<uint32_t>(1 + (row - 1) * columns + column % columns);
  };
  for (int i = 0; i < rows; ++i) {
    for (int k = 0; k < columns; ++k) {
      if (i > 0) model.triangles.push_back({at(i, k), at(i + 1, k), at(i, k + 1)});
      if (i + 1 < rows) model.triangles.push_back({at(i, k + 1), at(i + 1, k), at(i + 1, k + 1)});
    }
  }
  for (const auto& triangle : model.triangles) {
    auto& of_corners = model.surface.normals.emplace_back();
    for (int k = 0; k < 3; ++k) of_corners[k] = normals[triangle[k]].cast<float>();
  }
  model.surface.region_of.assign(model.triangles.size(), 0);
  model.surface.regions.resize(1);
  model.diameter_m = 2.0 * kRadius;
  return model;
}

const CameraModel kPinhole = {640, 480, 500.0, 500.0, 319.5, 239.5, {}};

std::vector<float> PictureOf(const ObjectModel& model, const SceneOptions& options, double depth_m) {
  MeshRenderer renderer(model, options, kPinhole, depth_m - 0.1);
  renderer.Render({Eigen::Matrix3d::Identity(), {-0.02, 0.0, depth_m}}, 1.0);
  std::vector<float> picture(size_t{640} * 480, 0.0f);
  renderer.CompositeOnto(picture);
  return picture;
}

TEST(MeshRendererTest, OutlineOfCoarseSphereIsThatOfTheSphere) {
  SceneOptions options;
  options.light.diffuse_ratio = 0.0;
  options.finish = {1.0, 0.0};
  double covered = 0.0;
  for (const float light : PictureOf(SphereOf(12), options, 0.5)) covered += light;
  // The contour of a sphere at the depth z has the image radius f r / sqrt(z^2 - r^2).
  const double radius_px = 500.0 * 0.1 / std::sqrt(0.5 * 0.5 - 0.1 * 0.1);
  const double found_px = std::sqrt(covered / std::numbers::pi);
  EXPECT_NEAR(found_px, radius_px, 0.03);
  // The radius of the facets, a polygon of 24 sides, is 0.6 px smaller.
  ObjectModel facets = SphereOf(12);
  facets.surface = {};
  double of_facets = 0.0;
  for (const float light : PictureOf(facets, options, 0.5)) of_facets += light;
  EXPECT_LT(std::sqrt(of_facets / std::numbers::pi), radius_px - 0.4);
}

TEST(MeshRendererTest, ShadesSmoothlyFromTheSideOfTheLamp) {
  SceneOptions options;
  options.light.diffuse_ratio = 1.0;
  options.finish = {0.5, 0.0};
  const std::vector<float> picture = PictureOf(SphereOf(12), options, 0.5);
  const auto at = [&](double x, double y) {  // shares of the radius
    return picture[static_cast<size_t>(239.5 + 100.0 * y) * 640 + static_cast<size_t>(319.5 + 100.0 * x)];
  };
  EXPECT_GT(at(-0.4, -0.6), 0.45f);  // the lamp is above, to the left
  EXPECT_LT(at(0.6, 0.7), 0.05f);
  // No step at the borders of the facets: each is 15 degrees wide.
  float largest = 0.0f;
  for (int x = -70; x < 70; ++x) largest = std::max(largest, std::abs(at(0.01 * x, 0.1) - at(0.01 * (x + 1), 0.1)));
  EXPECT_LT(largest, 0.015f);
}

TEST(MeshRendererTest, PaintedLinesAreThinAndDark) {
  SceneOptions options;
  options.light.diffuse_ratio = 0.0;
  options.finish = {0.8, 0.0};
  // A sheet in the plane z = 0, whose outside faces the camera, with a line along x.
  ObjectModel sheet;
  sheet.vertices = {{-0.1, -0.1, 0}, {0.14, -0.1, 0}, {0.14, 0.1, 0}, {-0.1, 0.1, 0}};
  sheet.triangles = {{0, 2, 1}, {0, 3, 2}};
  sheet.diameter_m = 0.4;
  sheet.lines.push_back({{-0.05, 0.03, 0}, {0.05, 0.03, 0}, {{0, 0, -1}}, EdgeKind::kPainted});
  const auto row_sums = [&](const ObjectModel& model) {
    const std::vector<float> picture = PictureOf(model, options, 0.5);
    std::vector<double> missing;  // light, in pixels of the surface, in a column through the line
    for (int y = 200; y < 300; ++y)
      missing.push_back((0.8 - picture[static_cast<size_t>(y) * 640 + 310]) / (0.75 * 0.8));
    return missing;
  };
  const std::vector<double> line = row_sums(sheet);
  double width_px = 0.0, centre_px = 0.0;
  for (size_t i = 0; i < line.size(); ++i) {
    width_px += line[i];
    centre_px += (200.0 + static_cast<double>(i)) * line[i];
  }
  EXPECT_NEAR(width_px, 0.005 * 0.4 * 500.0 / 0.5, 0.1);
  EXPECT_NEAR(centre_px / width_px, 239.5 + 500.0 * 0.03 / 0.5, 0.1);
  // Not from behind, and no line that is away from all faces.
  sheet.lines[0].face_normals = {{0, 0, 1}};
  for (const double missing : row_sums(sheet)) EXPECT_NEAR(missing, 0.0, 1e-6);
  sheet.lines[0].face_normals.clear();
  for (const double missing : row_sums(sheet)) EXPECT_NEAR(missing, 0.0, 1e-6);
}

TEST(MeshRendererTest, HighlightIsOnTheSideOfTheLamp) {
  SceneOptions options;
  options.light.diffuse_ratio = 0.0;
  options.finish = {0.0, 0.4};
  const std::vector<float> picture = PictureOf(SphereOf(24), options, 0.5);
  const auto brightest = std::max_element(picture.begin(), picture.end()) - picture.begin();
  EXPECT_NEAR(picture[brightest], 0.4, 0.01);
  EXPECT_LT(brightest % 640, 310);
  EXPECT_LT(brightest / 640, 230);
}

}  // namespace
}  // namespace evpose

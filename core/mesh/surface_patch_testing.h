// SPDX-License-Identifier: Apache-2.0

// Tessellated patches of known surfaces, for tests.
#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <cstdint>
#include <functional>

#include "core/mesh/types/raw_mesh.h"
#include "core/mesh/types/smooth_surface.h"
#include "core/numerics/random.h"

namespace evpose {

struct SurfacePatch {
  RawMesh mesh;
  SmoothSurface surface;
};

// One kFree region with the mean normals of the facets at each vertex.
inline void SetMeanNormals(SurfacePatch& patch) {
  std::vector<Eigen::Vector3d> sums(patch.mesh.points.size(), Eigen::Vector3d::Zero());
  for (const auto& [i, j, k] : patch.mesh.triangles) {
    const std::vector<Eigen::Vector3d>& p = patch.mesh.points;
    for (const uint32_t vertex : {i, j, k}) sums[vertex] += (p[j] - p[i]).cross(p[k] - p[i]);
  }
  patch.surface = {std::vector<uint32_t>(patch.mesh.triangles.size(), 0), {}, {SurfaceRegion()}};
  for (const auto& [i, j, k] : patch.mesh.triangles) {
    patch.surface.normals.push_back(
        {sums[i].normalized().cast<float>(), sums[j].normalized().cast<float>(), sums[k].normalized().cast<float>()});
  }
}

struct GridSize {
  uint32_t u = 1, v = 1;  // cells
  bool wraps_u = false, wraps_v = false;
};
// The images of a grid; `position` has arguments in [0, 1]. Outward is the side of du x dv.
inline SurfacePatch GridPatch(const GridSize& size, const std::function<Eigen::Vector3d(double, double)>& position) {
  SurfacePatch patch;
  const uint32_t rows = size.v + (size.wraps_v ? 0 : 1), columns = size.u + (size.wraps_u ? 0 : 1);
  for (uint32_t v = 0; v < rows; ++v) {
    for (uint32_t u = 0; u < columns; ++u)
      patch.mesh.points.push_back(position(double(u) / size.u, double(v) / size.v));
  }
  const auto vertex = [&](uint32_t u, uint32_t v) { return v % rows * columns + u % columns; };
  for (uint32_t v = 0; v < size.v; ++v) {
    for (uint32_t u = 0; u < size.u; ++u) {
      patch.mesh.triangles.push_back({vertex(u, v), vertex(u + 1, v), vertex(u + 1, v + 1)});
      patch.mesh.triangles.push_back({vertex(u, v), vertex(u + 1, v + 1), vertex(u, v + 1)});
    }
  }
  SetMeanNormals(patch);
  return patch;
}

inline Eigen::Vector3d OnCircle(double turns) {
  return {std::cos(2.0 * M_PI * turns), std::sin(2.0 * M_PI * turns), 0.0};
}

// The placement of a test: an oblique rotation and a shift.
inline Eigen::Isometry3d ObliquePlacement() {
  Eigen::Isometry3d placement = Eigen::Isometry3d::Identity();
  placement.rotate(Eigen::AngleAxisd(0.7, Eigen::Vector3d(1.0, 2.0, -0.5).normalized()));
  placement.pretranslate(Eigen::Vector3d(0.3, -2.0, 1.5));
  return placement;
}

inline void Place(const Eigen::Isometry3d& placement, SurfacePatch& patch) {
  for (Eigen::Vector3d& point : patch.mesh.points) point = placement * point;
  SetMeanNormals(patch);
}

// Moves each point by up to `noise_m` per axis and rounds it to single precision, as files do.
inline void AddNoise(double noise_m, SurfacePatch& patch) {
  Random random(1);
  for (Eigen::Vector3d& point : patch.mesh.points) {
    for (int i = 0; i < 3; ++i) point[i] = static_cast<float>(point[i] + random.Uniform(-noise_m, noise_m));
  }
  SetMeanNormals(patch);
}

}  // namespace evpose

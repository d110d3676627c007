// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/templates/view_sphere.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <utility>

#include "core/numerics/math.h"

namespace evpose {
namespace {

using Eigen::Vector3d;

struct SphereMesh {
  std::vector<Vector3d> points;
  std::vector<std::array<int, 3>> triangles;
};

SphereMesh Icosahedron() {
  const double golden = 0.5 * (1.0 + std::sqrt(5.0));
  SphereMesh mesh;
  for (int axis = 0; axis < 3; ++axis) {
    for (const double a : {-1.0, 1.0}) {
      for (const double b : {-golden, golden}) {
        Vector3d point = Vector3d::Zero();
        point[(axis + 1) % 3] = a;
        point[(axis + 2) % 3] = b;
        mesh.points.push_back(point.normalized());
      }
    }
  }
  // Neighbours have the scalar product 1 / sqrt(5); other vertices less.
  const auto are_near = [&](int i, int j) { return mesh.points[i].dot(mesh.points[j]) > 0.4; };
  for (int i = 0; i < 12; ++i) {
    for (int j = i + 1; j < 12; ++j) {
      for (int k = j + 1; k < 12; ++k) {
        if (are_near(i, j) && are_near(j, k) && are_near(i, k)) mesh.triangles.push_back({i, j, k});
      }
    }
  }
  return mesh;
}

SphereMesh Divided(const SphereMesh& mesh) {
  SphereMesh fine;
  fine.points = mesh.points;
  std::map<std::pair<int, int>, int> middles;
  const auto middle = [&](int i, int j) {
    const auto [at, is_new] = middles.try_emplace(std::minmax(i, j), static_cast<int>(fine.points.size()));
    if (is_new) fine.points.push_back((mesh.points[i] + mesh.points[j]).normalized());
    return at->second;
  };
  for (const auto& [i, j, k] : mesh.triangles) {
    const int ij = middle(i, j), jk = middle(j, k), ik = middle(i, k);
    fine.triangles.push_back({i, ij, ik});
    fine.triangles.push_back({ij, j, jk});
    fine.triangles.push_back({ik, jk, k});
    fine.triangles.push_back({ij, jk, ik});
  }
  return fine;
}

// Appends those of `directions` that no symmetry, the identity included, maps to within half the distance of neighbours
// of one in `kept`.
void AppendDistinct(const std::vector<Vector3d>& directions, const ObjectModel& model, double spacing_rad,
                    std::vector<Vector3d>& kept) {
  const double near_cosine = DeterministicSinCos(0.5 * spacing_rad).cos;
  const auto is_kept = [&](const Vector3d& image) {
    return std::any_of(kept.begin(), kept.end(), [&](const Vector3d& k) { return k.dot(image) > near_cosine; });
  };
  for (const Vector3d& direction : directions) {
    const bool is_known = is_kept(direction) || std::any_of(model.symmetries.begin(), model.symmetries.end(),
                                                            [&](const RigidTransform& symmetry) {
                                                              return is_kept(symmetry.rotation * direction);
                                                            });
    if (!is_known) kept.push_back(direction);
  }
}

std::vector<Vector3d> Meridian(const ContinuousSymmetry& symmetry) {
  // Six degrees, finer than the 7 to 9 degrees between the views of a whole sphere: a meridian has few views in any
  // case.
  constexpr double kStepRad = 6.0 / kDegreesPerRadian;
  const int count = (symmetry.is_flippable ? 90 : 180) / 6 + 1;
  const Vector3d across = symmetry.axis.unitOrthogonal();
  std::vector<Vector3d> directions;
  for (int i = 0; i < count; ++i) {
    const auto [sin, cos] = DeterministicSinCos(kStepRad * i);
    directions.push_back(cos * symmetry.axis + sin * across);
  }
  return directions;
}

}  // namespace

ViewSphere MakeViewSphere(const ObjectModel& model, int subdivisions) {
  ViewSphere sphere;
  if (model.continuous_symmetry) {
    sphere.is_turn_free = model.continuous_symmetry->kind == ContinuousSymmetry::Kind::kSphere;
    sphere.directions =
        sphere.is_turn_free ? std::vector{Vector3d(Vector3d::UnitZ())} : Meridian(*model.continuous_symmetry);
    sphere.num_coarse = static_cast<int>(sphere.directions.size());
    return sphere;
  }
  SphereMesh mesh = Icosahedron();
  constexpr double kIcosahedronRad = 1.1;  // distance of neighbouring vertices
  double spacing_rad = kIcosahedronRad;
  for (int i = 0; i + 1 < subdivisions; ++i, spacing_rad *= 0.5) mesh = Divided(mesh);
  AppendDistinct(mesh.points, model, spacing_rad, sphere.directions);
  sphere.num_coarse = static_cast<int>(sphere.directions.size());
  AppendDistinct(Divided(mesh).points, model, 0.5 * spacing_rad, sphere.directions);
  return sphere;
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// Meshes for tests of repairs, and what these must keep.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/mesh/mesh_edges.h"
#include "core/mesh/types/raw_mesh.h"

namespace evpose {

// Appends a triangle with points of its own, as in an STL file.
inline void AddTriangle(const Eigen::Vector3d& a, const Eigen::Vector3d& b, const Eigen::Vector3d& c, RawMesh& mesh) {
  const uint32_t first = static_cast<uint32_t>(mesh.points.size());
  mesh.points.insert(mesh.points.end(), {a, b, c});
  mesh.triangles.push_back({first, first + 1, first + 2});
}

// A parallelogram with the normal u x v of columns times rows parts, each cut along one or the other diagonal.
inline void AddPlate(const Eigen::Vector3d& corner, const Eigen::Vector3d& u, const Eigen::Vector3d& v, RawMesh& mesh,
                     int columns = 1, int rows = 1, bool is_other_diagonal = false) {
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      const auto at = [&](int x, int y) -> Eigen::Vector3d {
        return corner + (1.0 * (column + x) / columns) * u + (1.0 * (row + y) / rows) * v;
      };
      if (is_other_diagonal) {
        AddTriangle(at(0, 0), at(1, 0), at(0, 1), mesh);
        AddTriangle(at(1, 0), at(1, 1), at(0, 1), mesh);
      } else {
        AddTriangle(at(0, 0), at(1, 0), at(1, 1), mesh);
        AddTriangle(at(0, 0), at(1, 1), at(0, 1), mesh);
      }
    }
  }
}

// The six sides of a box, 12 triangles with normals outward: -x, +x, -y, +y, -z, +z.
inline void AddBox(const Eigen::Vector3d& corner, const Eigen::Vector3d& size, RawMesh& mesh) {
  for (int axis = 0; axis < 3; ++axis) {
    const Eigen::Vector3d u = Eigen::Vector3d::Unit((axis + 1) % 3).cwiseProduct(size);
    const Eigen::Vector3d v = Eigen::Vector3d::Unit((axis + 2) % 3).cwiseProduct(size);
    AddPlate(corner, v, u, mesh);
    AddPlate(corner + Eigen::Vector3d::Unit(axis).cwiseProduct(size), u, v, mesh);
  }
}

inline Eigen::Vector3d AreaVector(const RawMesh& mesh, const std::array<uint32_t, 3>& triangle) {
  const auto& [i, j, k] = triangle;
  return 0.5 * (mesh.points[j] - mesh.points[i]).cross(mesh.points[k] - mesh.points[i]);
}

inline double SurfaceArea(const RawMesh& mesh) {
  double area = 0.0;
  for (const auto& triangle : mesh.triangles) area += AreaVector(mesh, triangle).norm();
  return area;
}

inline double EnclosedVolume(const RawMesh& mesh) {
  double volume = 0.0;
  for (const auto& triangle : mesh.triangles) {
    volume += AreaVector(mesh, triangle).dot(mesh.points[triangle[0]]) / 3.0;
  }
  return volume;
}

// Number of edges that another number of triangles than two has as a side.
inline size_t IrregularEdges(const RawMesh& mesh) {
  size_t count = 0;
  ForEachEdge(SortedEdgeUses(mesh.triangles), [&](absl::Span<const EdgeUse> uses) { count += uses.size() != 2; });
  return count;
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/models/display_geometry.h"

#include <meshoptimizer.h>

#include <algorithm>
#include <numeric>
#include <utility>

namespace evpose {
namespace {

// Above these, meshopt_simplify takes seconds: its cost per vertex is proportional to the square of the number of
// triangles at it.
constexpr size_t kMaxTrianglesAlongSurface = 500'000;
constexpr uint32_t kMaxTrianglesAtVertex = 256;
// A result with more triangles than this times the target is replaced by that of the grid.
constexpr double kNearTarget = 1.1;
// The error of a drawing is not limited, only its size.
constexpr float kAnyError = 1.0f;  // relative to the extent of the mesh

using Faces = std::vector<std::array<uint32_t, 3>>;

bool IsSimpleToReduce(const ObjectModel& model) {
  if (model.triangles.size() > kMaxTrianglesAlongSurface) return false;
  std::vector<uint32_t> triangles_at(model.vertices.size(), 0);
  for (const auto& triangle : model.triangles) {
    for (const uint32_t vertex : triangle) ++triangles_at[vertex];
  }
  return std::all_of(triangles_at.begin(), triangles_at.end(),
                     [](uint32_t count) { return count <= kMaxTrianglesAtVertex; });
}

// Reduces the triangles of a model.
class FaceReducer {
 public:
  explicit FaceReducer(const ObjectModel& model) : model_(model) {
    positions_.reserve(3 * model.vertices.size());
    for (const Eigen::Vector3d& vertex : model.vertices) {
      for (int axis = 0; axis < 3; ++axis) positions_.push_back(static_cast<float>(vertex[axis]));
    }
    for (const auto& triangle : model.triangles) indices_.insert(indices_.end(), triangle.begin(), triangle.end());
  }

  Faces AlongSurface(size_t target) const {
    std::vector<uint32_t> reduced(indices_.size());
    reduced.resize(meshopt_simplify(reduced.data(), indices_.data(), indices_.size(), positions_.data(),
                                    model_.vertices.size(), 3 * sizeof(float), 3 * target, kAnyError, 0, nullptr));
    return FacesOf(reduced);
  }

  Faces InGrid(size_t target) const {
    std::vector<uint32_t> reduced(indices_.size());
    reduced.resize(meshopt_simplifySloppy(reduced.data(), indices_.data(), indices_.size(), positions_.data(),
                                          model_.vertices.size(), 3 * sizeof(float), 3 * target, kAnyError, nullptr));
    Faces faces = FacesOf(reduced);
    if (faces.size() > target) faces.resize(target);
    return faces;
  }

 private:
  static Faces FacesOf(const std::vector<uint32_t>& indices) {
    Faces faces;
    faces.reserve(indices.size() / 3);
    for (size_t i = 0; i + 2 < indices.size(); i += 3) faces.push_back({indices[i], indices[i + 1], indices[i + 2]});
    return faces;
  }

  const ObjectModel& model_;
  std::vector<float> positions_;
  std::vector<uint32_t> indices_;
};

// Keeps the vertices of the faces alone.
void SetMesh(const ObjectModel& model, Faces faces, DisplayGeometry& geometry) {
  constexpr uint32_t kUnused = ~0u;
  std::vector<uint32_t> number(model.vertices.size(), kUnused);
  geometry.vertices.clear();
  for (auto& face : faces) {
    for (uint32_t& vertex : face) {
      uint32_t& its_number = number[vertex];
      if (its_number == kUnused) {
        its_number = static_cast<uint32_t>(geometry.vertices.size());
        geometry.vertices.push_back(model.vertices[vertex].cast<float>());
      }
      vertex = its_number;
    }
  }
  geometry.faces = std::move(faces);
}

size_t MeshBytes(const DisplayGeometry& geometry) {
  return sizeof(float) * 3 * geometry.vertices.size() + sizeof(uint32_t) * 3 * geometry.faces.size();
}

void SetEdges(const ObjectModel& model, size_t max_edges, DisplayGeometry& geometry) {
  const auto add = [&geometry](const Eigen::Vector3d& p1, const Eigen::Vector3d& p2) {
    geometry.edges.push_back({p1.cast<float>(), p2.cast<float>()});
  };
  for (const ModelLine& line : model.lines) add(line.p1, line.p2);
  for (const EdgeCurve& curve : model.curves) {
    for (size_t i = 1; i < curve.points.size(); ++i) add(curve.points[i - 1], curve.points[i]);
  }
  if (geometry.edges.size() <= max_edges) return;
  geometry.is_simplified = true;
  std::stable_sort(geometry.edges.begin(), geometry.edges.end(), [](const auto& a, const auto& b) {
    return (a[1] - a[0]).squaredNorm() > (b[1] - b[0]).squaredNorm();
  });
  geometry.edges.resize(max_edges);
}

}  // namespace

DisplayGeometry MakeDisplayGeometry(const ObjectModel& model, const DisplayLimits& limits) {
  DisplayGeometry geometry;
  SetEdges(model, limits.max_edges, geometry);
  if (model.triangles.size() <= limits.max_faces) {
    SetMesh(model, model.triangles, geometry);
    if (MeshBytes(geometry) <= limits.max_mesh_bytes) return geometry;
  }
  geometry.is_simplified = true;
  const FaceReducer reducer(model);
  size_t target = std::min(limits.max_faces, model.triangles.size());
  Faces faces;
  if (IsSimpleToReduce(model)) faces = reducer.AlongSurface(target);
  if (faces.empty() || static_cast<double>(faces.size()) > kNearTarget * static_cast<double>(target)) {
    faces = reducer.InGrid(target);
  }
  SetMesh(model, std::move(faces), geometry);
  // Faces that share few vertices take up to four times the bytes of a closed surface.
  while (MeshBytes(geometry) > limits.max_mesh_bytes) {
    target = target / 2;
    SetMesh(model, reducer.InGrid(target), geometry);
  }
  return geometry;
}

}  // namespace evpose

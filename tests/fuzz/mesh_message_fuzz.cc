// SPDX-License-Identifier: Apache-2.0

// Fuzz target for serialized meshes with arbitrary bytes: a mesh is refused with an error, or its indices and numbers
// are valid. A valid mesh is the same after it was written and read again, and a model can be made of it or is refused.
#include <cmath>

#include "core/base/byte_order.h"
#include "server/models/mesh_message.h"
#include "tests/fuzz/fuzz_input.h"
#include "tests/fuzz/require.h"

namespace evpose {
namespace {

constexpr size_t kMaxTriangles = 256;

bool IsUnit(const Eigen::Vector3f& normal) { return std::abs(normal.norm() - 1.0f) < 1e-3f; }

void CheckIndices(const RawMesh& mesh) {
  EVPOSE_FUZZ_REQUIRE(mesh.triangles.size() <= kMaxTriangles && mesh.lines.size() <= kMaxTriangles);
  for (const Eigen::Vector3d& point : mesh.points) EVPOSE_FUZZ_REQUIRE(point.allFinite());
  for (const auto& triangle : mesh.triangles) {
    for (const uint32_t index : triangle) EVPOSE_FUZZ_REQUIRE(index < mesh.points.size());
  }
  for (const auto& line : mesh.lines) {
    for (const uint32_t index : line) EVPOSE_FUZZ_REQUIRE(index < mesh.points.size());
  }
}

void CheckEdges(const RawMesh& mesh) {
  EVPOSE_FUZZ_REQUIRE(mesh.exact_edges.size() <= mesh.triangles.size());
  for (const ExactEdge& edge : mesh.exact_edges) {
    EVPOSE_FUZZ_REQUIRE(edge.points.size() >= 2);
    for (const uint32_t index : edge.points) EVPOSE_FUZZ_REQUIRE(index < mesh.points.size());
    if (edge.shape != ExactEdge::Shape::kCircle) continue;
    EVPOSE_FUZZ_REQUIRE(edge.circle.centre.allFinite() && std::abs(edge.circle.axis.norm() - 1.0) < 1e-9);
    EVPOSE_FUZZ_REQUIRE(edge.circle.radius_m > 0.0 && std::isfinite(edge.circle.radius_m));
  }
}

void CheckSurface(const RawMesh& mesh) {
  const SmoothSurface& surface = mesh.exact_surface;
  EVPOSE_FUZZ_REQUIRE(mesh.corner_normals.empty() || mesh.corner_normals.size() == mesh.triangles.size());
  for (const auto& corners : mesh.corner_normals) {
    for (const Eigen::Vector3f& normal : corners) EVPOSE_FUZZ_REQUIRE(normal.isZero(0.0f) || IsUnit(normal));
  }
  if (surface.empty()) return;
  EVPOSE_FUZZ_REQUIRE(surface.region_of.size() == mesh.triangles.size());
  EVPOSE_FUZZ_REQUIRE(surface.normals.size() == mesh.triangles.size());
  for (const uint32_t region : surface.region_of) EVPOSE_FUZZ_REQUIRE(region < surface.regions.size());
  for (const auto& corners : surface.normals) {
    for (const Eigen::Vector3f& normal : corners) EVPOSE_FUZZ_REQUIRE(IsUnit(normal));
  }
  for (const SurfaceRegion& region : surface.regions) {
    EVPOSE_FUZZ_REQUIRE(region.point.allFinite() && region.axis.allFinite() && std::isfinite(region.radius_m));
  }
}

}  // namespace
}  // namespace evpose

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace evpose;
  FuzzInput input(data, size);
  const absl::Span<const uint8_t> bytes = input.Rest();
  const absl::StatusOr<RawMesh> mesh = server::ParseMesh(bytes, kMaxTriangles);
  if (!mesh.ok()) {
    EVPOSE_FUZZ_REQUIRE(!mesh.status().message().empty());
    return 0;
  }
  CheckIndices(*mesh);
  CheckSurface(*mesh);
  CheckEdges(*mesh);
  const absl::StatusOr<RawMesh> again = server::ParseMesh(AsBytes(server::EncodeMesh(*mesh)), kMaxTriangles);
  EVPOSE_FUZZ_REQUIRE(again.ok() && again->points == mesh->points && again->triangles == mesh->triangles);
  ModelOptions options;
  options.max_triangles = kMaxTriangles;
  const absl::StatusOr<ObjectModel> model = server::ParseModelFile(bytes, ModelFormat::kMesh, options);
  EVPOSE_FUZZ_REQUIRE(model.ok() || !model.status().message().empty());
  return 0;
}

// SPDX-License-Identifier: Apache-2.0

// Fuzz target for model files with arbitrary bytes: a file is rejected with an error, or gives a model with valid
// indices and numbers.
#include <cmath>
#include <iterator>

#include "core/models/object_model.h"
#include "tests/fuzz/fuzz_input.h"
#include "tests/fuzz/require.h"

namespace evpose {
namespace {

constexpr ModelFormat kFormats[] = {ModelFormat::kObj, ModelFormat::kPly, ModelFormat::kStl};

void Check(const ObjectModel& model, const ModelOptions& options) {
  EVPOSE_FUZZ_REQUIRE(!model.lines.empty() || !model.curves.empty() || !model.surface.empty());
  EVPOSE_FUZZ_REQUIRE(model.triangles.size() <= options.max_triangles);
  EVPOSE_FUZZ_REQUIRE(std::isfinite(model.diameter_m) && model.diameter_m > 0.0);
  for (const Eigen::Vector3d& vertex : model.vertices) EVPOSE_FUZZ_REQUIRE(vertex.allFinite());
  for (const auto& triangle : model.triangles) {
    for (const uint32_t index : triangle) EVPOSE_FUZZ_REQUIRE(index < model.vertices.size());
  }
  for (const ModelLine& line : model.lines) {
    EVPOSE_FUZZ_REQUIRE(line.p1.allFinite() && line.p2.allFinite() && line.p1 != line.p2);
    for (const Eigen::Vector3d& normal : line.face_normals) EVPOSE_FUZZ_REQUIRE(normal.allFinite());
  }
  for (const EdgeCurve& curve : model.curves) {
    EVPOSE_FUZZ_REQUIRE(curve.points.size() >= 2 && curve.face_normals.size() + 1 == curve.points.size());
    for (const Eigen::Vector3d& point : curve.points) EVPOSE_FUZZ_REQUIRE(point.allFinite());
    for (const auto& normals : curve.face_normals) {
      for (const Eigen::Vector3d& normal : normals) EVPOSE_FUZZ_REQUIRE(normal.allFinite());
    }
  }
  if (model.surface.empty()) return;
  EVPOSE_FUZZ_REQUIRE(model.surface.region_of.size() == model.triangles.size());
  EVPOSE_FUZZ_REQUIRE(model.surface.normals.size() == model.triangles.size());
  for (const uint32_t region : model.surface.region_of) EVPOSE_FUZZ_REQUIRE(region < model.surface.regions.size());
  for (const auto& normals : model.surface.normals) {
    for (const Eigen::Vector3f& normal : normals) EVPOSE_FUZZ_REQUIRE(normal.allFinite());
  }
}

}  // namespace
}  // namespace evpose

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace evpose;
  FuzzInput input(data, size);
  const ModelFormat format = kFormats[input.Choice(std::size(kFormats))];
  ModelOptions options;
  options.max_triangles = 256;
  const auto model = ParseObjectModel(input.Rest(), format, options);
  if (model.ok()) {
    Check(*model, options);
  } else {
    EVPOSE_FUZZ_REQUIRE(!model.status().message().empty());
  }
  return 0;
}

// SPDX-License-Identifier: Apache-2.0

// Fuzz target for stored models with arbitrary bytes: a model is refused with an error, or its indices are valid and it
// is the same after it was written and read again. Its views are used by the searches or computed again, whatever they
// contain.
#include <memory>

#include "core/initialization/search_views.h"
#include "core/models/object_model.h"
#include "server/models/prepared_model.h"
#include "tests/fuzz/fuzz_input.h"
#include "tests/fuzz/require.h"

namespace evpose {
namespace {

// Larger inputs are the same in other places and take longer.
constexpr size_t kMaxBytes = 64u << 10;

void CheckIndices(const ObjectModel& model) {
  for (const auto& triangle : model.triangles) {
    for (const uint32_t index : triangle) EVPOSE_FUZZ_REQUIRE(index < model.vertices.size());
  }
  EVPOSE_FUZZ_REQUIRE(model.surface.empty() || model.surface.region_of.size() == model.triangles.size());
  for (const uint32_t region : model.surface.region_of) EVPOSE_FUZZ_REQUIRE(region < model.surface.regions.size());
  for (const auto& sides : model.facet_edges) {
    for (const uint32_t side : sides) EVPOSE_FUZZ_REQUIRE(side < 3 * model.triangles.size());
  }
}

// A tetrahedron, whose numbers are valid, with the views of the input.
void UseViews(const std::shared_ptr<const SearchViews>& views) {
  auto model = std::make_shared<ObjectModel>();
  model->vertices = {{0, 0, 0}, {0.1, 0, 0}, {0, 0.1, 0}, {0, 0, 0.1}};
  model->triangles = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3}};
  for (size_t i = 0; i < 4; ++i) {
    for (size_t j = 0; j < i; ++j) model->lines.push_back({model->vertices[i], model->vertices[j], {}, {}});
  }
  EdgeCurve curve = {EdgeKind::kPainted, {{0, 0, 0}, {0.02, 0.01, 0}, {0.03, 0.03, 0}}, {}, 0.0};
  curve.face_normals.resize(2, {Eigen::Vector3d::UnitZ(), Eigen::Vector3d::Zero()});
  model->curves = {curve};
  model->diameter_m = 0.15;
  // Not that of the tetrahedron. It has few views, so that an input takes milliseconds.
  model->continuous_symmetry = {ContinuousSymmetry::Kind::kAxis, Eigen::Vector3d::Zero(), Eigen::Vector3d::UnitZ(),
                                true};
  model->views = views;
  const SearchViews used = MakeSearchViews(model);
  for (const auto& lines : used.lines) {
    for (const ViewLine& line : lines) {
      EVPOSE_FUZZ_REQUIRE(line.line >= 0 && static_cast<size_t>(line.line) < model->lines.size());
      EVPOSE_FUZZ_REQUIRE(line.begin >= 0.0 && line.begin < line.end && line.end <= 1.0);
    }
  }
  for (const auto& samples : used.templates) {
    for (const EdgeSample& sample : samples)
      EVPOSE_FUZZ_REQUIRE(sample.point.norm() < 1.0 && sample.along.norm() < 1.0);
  }
}

}  // namespace
}  // namespace evpose

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace evpose;  // NOLINT(google-build-using-namespace)
  if (size > kMaxBytes) return 0;
  const auto model = server::DecodePreparedModel({reinterpret_cast<const char*>(data), size});
  if (!model.ok()) return 0;
  CheckIndices(*model);
  const std::string encoded = server::EncodePreparedModel(*model);
  EVPOSE_FUZZ_REQUIRE(server::EncodePreparedModel(server::DecodePreparedModel(encoded).value()) == encoded);
  if (model->views != nullptr) UseViews(model->views);
  return 0;
}

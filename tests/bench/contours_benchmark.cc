// SPDX-License-Identifier: Apache-2.0

// Benchmarks of the extraction of edge elements with visibility, for views all around the object, which is about 300
// pixels wide.
//   build/release/tests/bench/contours_benchmark --benchmark_filter=Extract
#include <benchmark/benchmark.h>

#include <cmath>
#include <vector>

#include "core/contours/contour_shapes_testing.h"
#include "core/contours/edge_elements.h"

namespace evpose::bench {
namespace {

constexpr int kNumViews = 64;

std::vector<RigidTransform> ViewsAround(double distance_m) {
  std::vector<RigidTransform> views;
  for (int i = 0; i < kNumViews; ++i) {
    const double z = 1.0 - (2.0 * i + 1.0) / kNumViews;
    const Eigen::Vector2d around = std::sqrt(1.0 - z * z) * OnCircle(0.618 * i);
    views.push_back(ViewFrom(distance_m * Eigen::Vector3d(around.x(), around.y(), z)));
  }
  return views;
}

void ExtractFrom(benchmark::State& state, const ObjectModel& model) {
  const CameraModel camera = ContourCamera();
  const std::vector<RigidTransform> views = ViewsAround(camera.fx_px * model.diameter_m / 300.0);
  const TriangleBvh faces(model.vertices, model.triangles);
  const EdgeElementExtractor extractor(model, faces, {});
  std::vector<EdgeElement> elements;
  size_t num_elements = 0, num_views = 0;
  for ([[maybe_unused]] auto _ : state) {
    const RigidTransform& view = views[num_views++ % views.size()];
    extractor.Extract(camera, view, DetailLevel(model, camera, view, -1), elements);
    num_elements += elements.size();
  }
  if (num_elements == 0) state.SkipWithError("no element is visible");
  state.counters["triangles"] = static_cast<double>(model.triangles.size());
  state.counters["elements"] = static_cast<double>(num_elements) / static_cast<double>(num_views);
}

void ExtractTorus(benchmark::State& state) {
  const int count_v = static_cast<int>(std::lround(0.5 * std::sqrt(static_cast<double>(state.range(0)))));
  ExtractFrom(state, TorusModel(0.1, 0.04, 2 * count_v, count_v));
}
void ExtractCylinder(benchmark::State& state) {
  ExtractFrom(state, CylinderModel(0.08, 0.05, static_cast<int>(state.range(0)) / 4));
}
void ExtractPlateWithHoles(benchmark::State& state) {
  std::vector<double> xs;
  for (int i = 0; i < 10; ++i) xs.push_back(0.03 * (i - 4.5));
  ExtractFrom(state, PlateWithHoles(0.015, 0.01, 0.01, static_cast<int>(state.range(0)) / 60, xs));
}

BENCHMARK(ExtractTorus)->Arg(5'000)->Arg(20'000)->Arg(70'000)->Unit(benchmark::kMicrosecond);
BENCHMARK(ExtractCylinder)->Arg(400)->Unit(benchmark::kMicrosecond);
BENCHMARK(ExtractPlateWithHoles)->Arg(20'000)->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace evpose::bench

BENCHMARK_MAIN();

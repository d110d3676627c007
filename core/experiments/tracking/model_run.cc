// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/model_run.h"

#include <array>
#include <filesystem>
#include <string>
#include <utility>

#include "absl/strings/str_format.h"
#include "core/base/find_named.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

struct NamedScene {
  ModelBenchScene scene;
  std::string_view name;
};

// In the order of the enumerators.
constexpr std::array<NamedScene, 3> kScenes = {{{ModelBenchScene::kStandard, "standard"},
                                                {ModelBenchScene::kOccluder, "occluder"},
                                                {ModelBenchScene::kMovingBackground, "moving-background"}}};
static_assert(kScenes.back().scene == ModelBenchScene::kMovingBackground);

void SetScene(ModelBenchScene scene, SimulationOptions& options) {
  BackgroundOptions& background = options.scene.background;
  OccluderOptions& occluder = options.scene.occluder;
  background.is_textured = options.seed % 2 == 0;
  if (scene == ModelBenchScene::kOccluder) {
    constexpr double kHiddenRatio = 0.35;  // share of the object's diameter
    occluder.is_present = occluder.follows_object = true;
    occluder.width_px =
        kHiddenRatio * options.camera.MaxFocalPx() * options.scene.model->diameter_m / options.scene.motion.depth_m;
    occluder.swing_ratio = kFollowingSwingRatio;
  }
  if (scene == ModelBenchScene::kMovingBackground) {
    background.is_textured = true;
    // About as fast as the object. The areas of the rectangles add up to a third of the image; in recordings of six
    // shapes of the benchmark, the background emitted 1.0 to 2.0 times as many events as the object.
    background.texture_speed_px_per_s = 300.0;
    background.texture_rectangles = 40;
  }
}

}  // namespace

std::string_view ModelBenchSceneName(ModelBenchScene scene) { return kScenes[static_cast<size_t>(scene)].name; }

std::vector<std::string> ModelBenchSceneNames() {
  std::vector<std::string> names;
  for (const NamedScene& scene : kScenes) names.emplace_back(scene.name);
  return names;
}

absl::StatusOr<ModelBenchScene> ParseModelBenchScene(std::string_view name) {
  EVPOSE_ASSIGN_OR_RETURN(const NamedScene found, FindNamed(kScenes, std::string(name), "no scene is called \"$0\""));
  return found.scene;
}

absl::StatusOr<std::shared_ptr<const ObjectModel>> LoadBenchModel(const ModelBenchOptions& options,
                                                                  const std::string& path, double metres_per_unit) {
  ModelOptions model_options;
  model_options.metres_per_unit = metres_per_unit;
  EVPOSE_ASSIGN_OR_RETURN(ObjectModel model, options.load_model(path, model_options));
  return std::make_shared<const ObjectModel>(std::move(model));
}

absl::StatusOr<std::shared_ptr<const ObjectModel>> LoadRenderedModel(const ModelBenchOptions& options,
                                                                     const BenchModel& bench_model,
                                                                     std::shared_ptr<const ObjectModel> tracked) {
  if (!bench_model.reference_path.empty()) return LoadBenchModel(options, bench_model.reference_path, 1.0);
  if (tracked != nullptr) return tracked;
  return LoadBenchModel(options, bench_model.path, bench_model.metres_per_unit);
}

absl::StatusOr<ModelRunInputs> MakeModelRun(const ModelBenchOptions& options, const BenchModel& bench_model,
                                            std::shared_ptr<const ObjectModel> tracked,
                                            std::shared_ptr<const ObjectModel> rendered, uint64_t seed) {
  ModelRunInputs inputs;
  inputs.model = std::move(tracked);
  EVPOSE_ASSIGN_OR_RETURN(inputs.simulation, ModelSimulationPreset(std::move(rendered), options.camera));
  inputs.simulation.seed = seed;
  inputs.simulation.duration_us = options.duration_us;
  inputs.simulation.sensor.noise_ratio = options.noise_ratio;
  SetScene(options.scene, inputs.simulation);
  EVPOSE_RETURN_IF_ERROR(inputs.simulation.Validate());
  inputs.truth = SimulatedTruth(inputs.simulation);
  if (!options.recordings.empty()) {
    const std::filesystem::path directory = options.recordings;
    const std::string name = bench_model.reference_path.empty() ? bench_model.path : bench_model.reference_path;
    const std::string scene =
        options.scene == ModelBenchScene::kStandard ? "" : "-" + std::string(ModelBenchSceneName(options.scene));
    inputs.directory =
        (directory / absl::StrFormat("%s%s-seed%d", std::filesystem::path(name).stem().string(), scene, seed)).string();
  }
  return inputs;
}

}  // namespace evpose

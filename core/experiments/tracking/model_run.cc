// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/model_run.h"

#include <filesystem>
#include <utility>

#include "absl/strings/str_format.h"
#include "core/base/status_macros.h"

namespace evpose {

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
  if (bench_model.reference_path.empty()) return tracked;
  return LoadBenchModel(options, bench_model.reference_path, 1.0);
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
  inputs.simulation.scene.background.is_textured = seed % 2 == 0;
  EVPOSE_RETURN_IF_ERROR(inputs.simulation.Validate());
  inputs.truth = SimulatedTruth(inputs.simulation);
  if (!options.recordings.empty()) {
    const std::filesystem::path directory = options.recordings;
    const std::string name = bench_model.reference_path.empty() ? bench_model.path : bench_model.reference_path;
    inputs.directory =
        (directory / absl::StrFormat("%s-seed%d", std::filesystem::path(name).stem().string(), seed)).string();
  }
  return inputs;
}

}  // namespace evpose

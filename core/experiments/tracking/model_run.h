// SPDX-License-Identifier: Apache-2.0

// A simulated recording of a model file: the inputs that the benchmarks of model files share.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "core/experiments/tracking/model_bench.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"
#include "core/simulation/simulator.h"

namespace evpose {

// The model that is tracked, and the simulated recording.
struct ModelRunInputs {
  std::shared_ptr<const ObjectModel> model;
  SimulationOptions simulation;
  Trajectory truth;
  std::string directory;  // directory of the recording (tracking_recordings.h); empty: it is not stored
};

// Errors: those of `options.load_model`.
absl::StatusOr<std::shared_ptr<const ObjectModel>> LoadBenchModel(const ModelBenchOptions& options,
                                                                  const std::string& path, double metres_per_unit);
// Returns the reference of `bench_model`, which is rendered. Without a reference, it is the model itself: `tracked`,
// which is loaded if it is null. Errors: those of `options.load_model`.
absl::StatusOr<std::shared_ptr<const ObjectModel>> LoadRenderedModel(const ModelBenchOptions& options,
                                                                     const BenchModel& bench_model,
                                                                     std::shared_ptr<const ObjectModel> tracked);

// `tracked` is the model of `bench_model`, `rendered` its reference. Errors: those of ModelSimulationPreset() and
// SimulationOptions::Validate().
absl::StatusOr<ModelRunInputs> MakeModelRun(const ModelBenchOptions& options, const BenchModel& bench_model,
                                            std::shared_ptr<const ObjectModel> tracked,
                                            std::shared_ptr<const ObjectModel> rendered, uint64_t seed);

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// Derives a model from its file: parses it, and finds its lines, symmetries and views. That takes seconds for the most
// expensive files, so a server does it in a process of its own, which can be bounded and killed.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/models/object_model.h"
#include "server/runtime/slow_executor.h"

namespace evpose::server {

// Thread-safe.
class ModelPreparer {
 public:
  virtual ~ModelPreparer() = default;
  // Returns the serialized model (prepared_model.h). Errors: those of ParseModelFile(); the status of `cancellation`.
  virtual absl::StatusOr<std::string> Prepare(const std::vector<uint8_t>& file, ModelFormat format,
                                              const ModelOptions& options, const Cancellation& cancellation) const = 0;
};

// Prepares models in the calling thread, without a bound, and is cancelled only before it begins: for a server inside
// its user's own process. Computes no views: the only session with the model does.
std::unique_ptr<ModelPreparer> MakeModelPreparer();

// The bounds of the preparation of one model.
struct PreparationBudget {
  // Processor time, seconds. For meshes of a million triangles, tests/bench/model_preparation.py printed 5 to 9 s on a
  // machine with other load, 0.5 to 2 s of it for the views. The views have a budget of the same size of their own.
  // Some meshes of 2 million triangles exceed the default.
  uint32_t cpu_seconds = 10;
  // Address space, bytes. Binary STL files of 64 MiB (1.34 million triangles) took up to 732 MB of resident memory
  // there.
  uint64_t memory_bytes = 1ull << 30;
};

// Prepares each model, with its views, in a process of `program`, evpose-prepare-model, which is killed when the call
// is cancelled. A session with the model computes again what the views are computed from: a model whose views exceed
// the budget is therefore refused, like one whose lines or symmetries do. Further errors: INVALID_ARGUMENT
// (MODEL_TOO_EXPENSIVE) naming the step in which the budget was exceeded; RESOURCE_EXHAUSTED (OUT_OF_MEMORY) when the
// kernel has killed the process, because the machine has no memory left; INTERNAL when the process cannot be started or
// crashes.
std::unique_ptr<ModelPreparer> MakeChildModelPreparer(const std::string& program, const PreparationBudget& budget);

// The protocol between the server and evpose-prepare-model. Arguments: format (a number of ModelFormat), metres per
// unit, crease angle in degrees, whether the surface is smooth (1 or 0), bytes of the largest file, processor seconds,
// bytes of memory. Standard input: the file. Standard output: a line "step NAME" before each step, then a line "error"
// and the message of INVALID_ARGUMENT, or a line "model SIZE", the serialized model of so many bytes, and the
// serialized views up to the end. After the model, the step is kPreparationViews.
inline constexpr char kPreparationStep[] = "step ";
inline constexpr char kPreparationViews[] = "computing views";
inline constexpr char kPreparationModel[] = "model ";
inline constexpr char kPreparationError[] = "error\n";
inline constexpr int kPreparationOutOfMemory = 3;  // exit status

}  // namespace evpose::server

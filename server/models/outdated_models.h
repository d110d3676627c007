// SPDX-License-Identifier: Apache-2.0

// The models that an earlier version stored.
#pragma once

#include <chrono>
#include <cstddef>
#include <functional>
#include <mutex>
#include <optional>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "server/models/model_registry.h"
#include "server/runtime/slow_executor.h"

namespace evpose::server {

// Decides when the progress of many preparations is reported. Thread-safe.
class PreparationProgress {
 public:
  using Clock = std::function<std::chrono::steady_clock::time_point()>;
  struct Report {
    size_t done = 0;
    size_t left = 0;
  };

  explicit PreparationProgress(size_t num_models, Clock now = std::chrono::steady_clock::now)
      : now_(std::move(now)), progress_{.left = num_models}, reported_at_(now_()) {}

  // Counts one more model as done. Returns what is to be reported: at most one report per kPeriod, and one at the end.
  std::optional<Report> RecordDone();

 private:
  // Time between two reports. A preparation takes seconds, so that a report counts several models, and an operator sees
  // within a short time that the work goes on.
  static constexpr std::chrono::seconds kPeriod{10};

  const Clock now_;
  std::mutex mutex_;
  Report progress_ ABSL_GUARDED_BY(mutex_);
  std::chrono::steady_clock::time_point reported_at_ ABSL_GUARDED_BY(mutex_);
};

// Prepares the outdated models of `models`, so that their first sessions need not wait for it. They are the server's
// own work on `executor`, so that an upload of their tenant does not wait for all of them. `models` must exist until
// the executor has stopped. Log: models_outdated {models} unless there are none, then models_prepared {done, left}, and
// model_not_loaded for each that can no longer be prepared.
void PrepareOutdatedModels(ModelRegistry& models, SlowExecutor& executor);

}  // namespace evpose::server

// SPDX-License-Identifier: Apache-2.0
#include "server/models/outdated_models.h"

#include <memory>
#include <string>
#include <utility>

#include "server/telemetry/log.h"

namespace evpose::server {

std::optional<PreparationProgress::Report> PreparationProgress::RecordDone() {
  const std::lock_guard lock(mutex_);
  ++progress_.done;
  --progress_.left;
  const auto now = now_();
  if (progress_.left > 0 && now - reported_at_ < kPeriod) return std::nullopt;
  reported_at_ = now;
  return progress_;
}

void PrepareOutdatedModels(ModelRegistry& models, SlowExecutor& executor) {
  const auto outdated = models.Outdated();
  if (outdated.empty()) return;
  Log(LogLevel::kInfo, "models_outdated", {{"models", outdated.size()}});
  const auto progress = std::make_shared<PreparationProgress>(outdated.size());
  for (const auto& [tenant, name] : outdated) {
    executor.PostOwn([&models, progress, model = name, owner = tenant] {
      const absl::Status status = models.UseStored(owner, model).status();
      // Shutdown, or the store does not respond: the first session prepares the model.
      if (absl::IsUnavailable(status)) return;
      if (!status.ok()) {
        Log(LogLevel::kError, "model_not_loaded", {{"model", model}, {"tenant", owner}, {"message", status.message()}});
      }
      if (const auto report = progress->RecordDone()) {
        Log(LogLevel::kInfo, "models_prepared", {{"done", report->done}, {"left", report->left}});
      }
    });
  }
}

}  // namespace evpose::server

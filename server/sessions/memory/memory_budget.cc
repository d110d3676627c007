// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/memory/memory_budget.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "core/base/status_macros.h"
#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

uint64_t Megabytes(uint64_t bytes) { return bytes / 1'000'000; }

absl::Status BeyondLimit(absl::string_view subject, absl::string_view whose, uint64_t bytes, uint64_t taken,
                         uint64_t limit) {
  const bool may_fit_later = bytes <= limit;
  return LimitReached(
      v1::SESSION_MEMORY, subject,
      absl::StrCat(
          "the session may need ", Megabytes(bytes), " MB of memory (", bytes, " bytes), and ", whose, " have ",
          Megabytes(taken), " of ", Megabytes(limit), " MB: ",
          may_fit_later ? "delete a session that is not needed, try again later, or use" : "use a larger limit, or",
          " a camera with fewer pixels, fewer objects or models with fewer lines and triangles"),
      may_fit_later ? kRetryDelay : absl::ZeroDuration());
}

}  // namespace

struct MemoryBudget::Part {
  ~Part() {
    if (bytes > 0) budget->Release(*this);
  }
  std::shared_ptr<MemoryBudget> budget;
  std::string tenant;
  uint64_t bytes = 0;
  std::shared_ptr<const ObjectModel> model;   // the model of a part that sessions share
  std::vector<std::shared_ptr<Part>> shared;  // those of a session
};

std::shared_ptr<MemoryBudget::Part> MemoryBudget::MakePart(const std::string& tenant) {
  auto part = std::make_shared<Part>();
  part->budget = shared_from_this();
  part->tenant = tenant;
  return part;
}

absl::StatusOr<MemoryCharge> MemoryBudget::Charge(const std::string& tenant, const SessionMemory& memory,
                                                  absl::Span<const ModelMemory> models, bool may_refuse) {
  // Everything is allocated before anything is counted. The parts are destroyed after the lock, which their destructor
  // takes.
  const std::shared_ptr<Part> tracking = MakePart(tenant), other = MakePart(tenant);
  for (const ModelMemory& model : models) {
    tracking->shared.push_back(MakePart(tenant));
    tracking->shared.back()->model = model.model;
  }
  const std::lock_guard lock(mutex_);
  uint64_t bytes = memory.total_bytes();
  for (size_t i = 0; i < models.size(); ++i) {
    const auto found = models_.find({tenant, models[i].model.get()});
    const std::shared_ptr<Part> charged = found == models_.end() ? nullptr : found->second.lock();
    if (charged != nullptr) tracking->shared[i] = charged;
    if (charged == nullptr) bytes += models[i].bytes;
  }
  if (may_refuse) {
    EVPOSE_RETURN_IF_ERROR(Check(tenant, bytes));
  }
  for (size_t i = 0; i < models.size(); ++i) {
    const std::shared_ptr<Part>& part = tracking->shared[i];
    if (part->bytes > 0 || models[i].bytes == 0) continue;
    Add(*part, models[i].bytes);
    models_[{tenant, models[i].model.get()}] = part;
  }
  Add(*tracking, memory.tracking_bytes);
  Add(*other, memory.other_bytes);
  return MemoryCharge{tracking, other};
}

void MemoryBudget::Add(Part& part, uint64_t bytes) {
  part.bytes = bytes;
  charged_bytes_ += bytes;
  if (bytes > 0) charged_by_tenant_[part.tenant] += bytes;
}

absl::Status MemoryBudget::Check(const std::string& tenant, uint64_t bytes) const {
  // Sessions that were charged beyond the limit may have taken more than that.
  const auto fits = [bytes](uint64_t taken, uint64_t limit) { return taken <= limit && bytes <= limit - taken; };
  if (!fits(charged_bytes_, options_.max_bytes)) {
    options_.metrics->quota_refusals[QuotaLimit::kSessionMemory].Add();
    return BeyondLimit("session_memory", "all sessions", bytes, charged_bytes_, options_.max_bytes);
  }
  const auto charged = charged_by_tenant_.find(tenant);
  const uint64_t taken = charged == charged_by_tenant_.end() ? 0 : charged->second;
  if (!fits(taken, options_.max_tenant_bytes)) {
    options_.metrics->quota_refusals[QuotaLimit::kTenantSessionMemory].Add();
    return BeyondLimit("tenant_session_memory", "the sessions of this tenant", bytes, taken, options_.max_tenant_bytes);
  }
  return absl::OkStatus();
}

void MemoryBudget::Release(const Part& part) {
  const std::lock_guard lock(mutex_);
  charged_bytes_ -= part.bytes;
  const auto charged = charged_by_tenant_.find(part.tenant);
  charged->second -= part.bytes;
  if (charged->second == 0) charged_by_tenant_.erase(charged);
  if (part.model == nullptr) return;
  // Another session may have charged the model again meanwhile.
  const auto model = models_.find({part.tenant, part.model.get()});
  if (model != models_.end() && model->second.expired()) models_.erase(model);
}

uint64_t MemoryBudget::charged_bytes() const {
  const std::lock_guard lock(mutex_);
  return charged_bytes_;
}

}  // namespace evpose::server

// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/store_check.h"

#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/runtime/out_of_memory.h"
#include "server/telemetry/log.h"

namespace evpose::server {

StoreCheck::StoreCheck(Store& store, WorkerPool& pool, absl::Duration period, Listener listener)
    : store_(store), pool_(pool), period_(period), listener_(std::move(listener)) {}

void StoreCheck::Start() {
  const std::optional<StoreUsage> usage = store_.Usage();
  const std::lock_guard lock(mutex_);
  usage_ = usage;
  if (is_stopped_) return;
  timer_ = pool_.MakeTimer([this] { OnTimer(); });
  timer_->Arm(period_);
}

void StoreCheck::Stop() {
  const std::lock_guard lock(mutex_);
  is_stopped_ = true;
  timer_.reset();
}

void StoreCheck::OnTimer() {
  const std::lock_guard lock(mutex_);
  if (is_stopped_) return;
  const absl::Status posted = OrOutOfMemory([this] {
    pool_.slow().PostOwn([this] { Check(); });
    return absl::OkStatus();
  });
  if (!posted.ok()) timer_->Arm(period_);
}

absl::Status StoreCheck::health() const {
  const std::lock_guard lock(mutex_);
  return health_;
}

std::optional<StoreUsage> StoreCheck::usage() const {
  const std::lock_guard lock(mutex_);
  return usage_;
}

void StoreCheck::LogChanges(const std::vector<StoreGroup>& groups) {
  for (const StoreGroup& group : groups) {
    const bool was_unavailable = unavailable_groups_.contains(group.name);
    if (group.health.ok() == !was_unavailable) continue;
    if (group.health.ok()) {
      unavailable_groups_.erase(group.name);
      Log(LogLevel::kInfo, "store_group_back", {{"group", group.name}});
    } else {
      unavailable_groups_.insert(group.name);
      Log(LogLevel::kWarning, "store_group_away",
          {{"group", group.name}, {"parts", group.parts}, {"message", group.health.message()}});
    }
  }
}

void StoreCheck::Check() {
  {
    const std::lock_guard lock(mutex_);
    if (is_stopped_) return;
  }
  std::optional<StoreUsage> usage;
  std::vector<StoreGroup> groups;
  const absl::Status health = OrOutOfMemory([&] {
    absl::Status status = store_.CheckHealth();
    if (status.ok()) usage = store_.Usage();
    groups = store_.Groups();
    return status;
  });
  const std::lock_guard lock(mutex_);
  if (is_stopped_) return;
  RunUnlessOutOfMemory([&]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
    LogChanges(groups);
    if (IsOutOfMemory(health)) return;
    if (usage.has_value()) usage_ = usage;
    SetHealth(health);
  });
  timer_->Arm(period_);
}

void StoreCheck::SetHealth(const absl::Status& health) {
  const bool has_changed = health.ok() != health_.ok();
  health_ = health;
  if (!has_changed) return;
  listener_(health.ok());
  if (health.ok()) {
    Log(LogLevel::kInfo, "store_back", {{"message", "the store responds again: health is SERVING"}});
  } else {
    Log(LogLevel::kWarning, "store_away",
        {{"message", absl::StrCat("health is NOT_SERVING until the store responds: ", health.message())}});
  }
}

}  // namespace evpose::server

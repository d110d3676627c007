// SPDX-License-Identifier: Apache-2.0

// The part of SessionManager that restores the sessions of its own store.
#include <utility>

#include "core/base/status_macros.h"
#include "server/sessions/session_manager.h"
#include "server/telemetry/log.h"

namespace evpose::server {
namespace {

// Number of sessions between two lines about the progress, which are then some seconds apart.
constexpr size_t kRestoreProgressSessions = 500;

}  // namespace

absl::Status SessionManager::FindStored() {
  for (const std::string& damage : store_.damage()) Log(LogLevel::kError, "store_damage", {{"message", damage}});
  if (options_.shares_store) return absl::OkStatus();
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<SessionRecord> records, store_.ListSessions());
  const std::lock_guard lock(mutex_);
  for (const SessionRecord& record : records) waiting_.emplace(record.name, record.tenant);
  num_found_ = waiting_.size();
  return absl::OkStatus();
}

bool SessionManager::RestoreNext() {
  std::pair<std::string, std::string> next;
  {
    const std::lock_guard lock(mutex_);
    const size_t num_done = num_found_ - waiting_.size();
    if (num_found_ > 0 && (waiting_.empty() || num_done % kRestoreProgressSessions == 0)) {
      Log(LogLevel::kInfo, "restore_progress", {{"done", num_done}, {"total", num_found_}});
    }
    if (waiting_.empty()) return false;
    next = *waiting_.begin();
  }
  RestoreIfWaiting(next.second, next.first);
  return true;
}

void SessionManager::RestoreIfWaiting(const std::string& tenant, const std::string& name) {
  const auto is_waiting = [&] {
    const std::lock_guard lock(mutex_);
    const auto found = waiting_.find(name);
    return found != waiting_.end() && found->second == tenant;
  };
  if (!is_waiting()) return;
  const std::shared_ptr<std::mutex> resume_mutex = ResumeMutexOf(tenant);
  const std::lock_guard one_at_a_time(*resume_mutex);
  if (!is_waiting()) return;
  const auto session = Resume(name);
  if (session.ok()) return;
  if (!absl::IsNotFound(session.status())) SessionLog(name, tenant).NotResumed(session.status());
  const std::lock_guard lock(mutex_);
  waiting_.erase(name);  // a client that attaches to it tries again
}

}  // namespace evpose::server

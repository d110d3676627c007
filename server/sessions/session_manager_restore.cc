// SPDX-License-Identifier: Apache-2.0

// The part of SessionManager that resumes sessions from the store.
#include <utility>

#include "core/base/status_macros.h"
#include "server/runtime/errors.h"
#include "server/runtime/out_of_memory.h"
#include "server/sessions/session_manager.h"
#include "server/telemetry/log.h"

namespace evpose::server {

absl::Status SessionManager::FindStored() {
  for (const std::string& damage : store_.damage()) Log(LogLevel::kError, "store_damage", {{"message", damage}});
  if (options_.shares_store) return absl::OkStatus();
  EVPOSE_ASSIGN_OR_RETURN(std::vector<SessionOwner> owners, store_.ListOwners());
  const std::lock_guard lock(mutex_);
  found_at_ = options_.now();
  for (SessionOwner& owner : owners) waiting_.Add(std::move(owner.name), owner.tenant);
  if (!waiting_.empty()) Log(LogLevel::kInfo, "sessions_found", {{"sessions", waiting_.size()}});
  return absl::OkStatus();
}

bool SessionManager::IsWaiting(const std::string& tenant, const std::string& name) const {
  const std::lock_guard lock(mutex_);
  return waiting_.Contains(tenant, name);
}

absl::Status SessionManager::RestoreRequest(const Request& request) {
  {
    const std::lock_guard lock(mutex_);
    if (is_draining_ || request.second.empty() || waiting_.empty()) return absl::OkStatus();
  }
  const auto record = store_.FindRequest(request.first, request.second);
  if (record.ok()) RestoreIfWaiting(request.first, record->name);
  if (absl::IsNotFound(record.status()) || absl::IsDataLoss(record.status())) return absl::OkStatus();
  return FromStore(record.status());
}

void SessionManager::StopWaiting(const std::string& name) {
  const std::lock_guard lock(mutex_);
  waiting_.Remove(name);
}

void SessionManager::RestoreIfWaiting(const std::string& tenant, const std::string& name) {
  if (!IsWaiting(tenant, name)) return;
  const SessionLock session_lock = session_mutexes_.LockKey(name);
  if (!IsWaiting(tenant, name)) return;
  const auto session = Resume(name);
  if (session.ok()) return;
  if (absl::IsCancelled(session.status())) return;
  if (!absl::IsNotFound(session.status())) SessionLog(name, tenant).NotResumed(session.status());
  // After another error, such as a lack of memory, the next call tries again.
  if (absl::IsNotFound(session.status()) || absl::IsDataLoss(session.status())) StopWaiting(name);
}

absl::StatusOr<std::shared_ptr<Session>> SessionManager::ResumeOrMake(const SessionConfig& config,
                                                                      const Request& request, SessionLock& lock) {
  EVPOSE_ASSIGN_OR_RETURN(std::shared_ptr<Session> resumed, ResumeRequest(config, request, lock));
  if (resumed != nullptr) return resumed;
  EVPOSE_RETURN_IF_ERROR(CheckLoad(request.first));
  auto made = factory_.MakeNew(request.first, config, request.second);
  if (!absl::IsAlreadyExists(made.status())) return made;
  // Another server has created a session for the same request since it was searched for.
  EVPOSE_ASSIGN_OR_RETURN(resumed, ResumeRequest(config, request, lock));
  if (resumed == nullptr) return FromStore(made.status());
  return resumed;
}

absl::StatusOr<std::shared_ptr<Session>> SessionManager::ResumeForAttach(const std::string& tenant,
                                                                         const std::string& name,
                                                                         absl::string_view resume_token) {
  EVPOSE_RETURN_IF_ERROR(CheckNotDraining());
  RestoreIfWaiting(tenant, name);
  const SessionLock session_lock = session_mutexes_.LockKey(name);
  // During the wait the server may have begun to shut down, or the call may have ended: nobody needs the session then.
  EVPOSE_RETURN_IF_ERROR(CheckNotDraining());
  EVPOSE_RETURN_IF_ERROR(SlowExecutor::Running().status());
  std::shared_ptr<Session> here = FindOpen(tenant, name);
  if (here != nullptr && here->IsTokenValid(resume_token)) return here;
  if (here != nullptr && !options_.shares_store) return WrongToken(name);
  EVPOSE_ASSIGN_OR_RETURN(const SessionFactory::Stored stored, ReadOwn(tenant, name));
  if (!IsDigestValid(TokenDigest(resume_token), stored.lifecycle)) return WrongToken(name);
  if (here == nullptr) {
    const std::lock_guard lock(mutex_);
    EVPOSE_RETURN_IF_ERROR(ReserveSlot(tenant));
  }
  auto resumed = Resume(name, here == nullptr ? &tenant : nullptr);
  if (resumed.ok() && here != nullptr) {
    here->Close(WithReason(absl::AbortedError(absl::StrCat("another stream has attached to ", name)), v1::FENCED));
  }
  return resumed;
}

absl::StatusOr<std::shared_ptr<Session>> SessionManager::Resume(const std::string& name, const std::string* slot_of) {
  auto resumed = OrOutOfMemory([&] { return factory_.Resume(name); });
  {
    const std::lock_guard lock(mutex_);
    if (slot_of != nullptr) ReleaseSlot(*slot_of);
    if (!resumed.ok()) return resumed.status();
    Insert(resumed->session, Request(resumed->record.tenant, resumed->record.request_id));
  }
  const WatchView view = resumed->session->Watch();
  resumed->session->log().Resumed(view.last_pose_seq, view.has_ended);
  return std::move(resumed->session);
}

}  // namespace evpose::server

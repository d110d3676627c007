// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/session_manager.h"

#include <algorithm>
#include <cmath>
#include <mutex>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "core/base/status_macros.h"
#include "server/runtime/client_text.h"
#include "server/runtime/errors.h"
#include "server/runtime/out_of_memory.h"
#include "server/sessions/durability/session_codec.h"
#include "server/sessions/watching/waiting_listener.h"
#include "server/telemetry/log.h"

namespace evpose::server {
namespace {

// A replica changes only with a checkpoint, and two checkpoints are at least 0.1 s of processing time apart.
constexpr absl::Duration kMirrorPeriod = absl::Milliseconds(100);
// The number of sessions that a list reads by one call of the store. Their checkpoints, usually 44 kB and at most
// several megabytes each, are in memory at the same time.
constexpr size_t kSessionsPerRead = 16;

absl::Status RequestIdReused(absl::string_view request_id, absl::string_view session) {
  return WithReason(absl::AlreadyExistsError(absl::StrCat("request_id \"", Shortened(request_id), "\" made ", session,
                                                          " with another configuration: choose a new one")),
                    v1::REQUEST_ID_REUSED, {{"session", std::string(session)}});
}

absl::Status DamagedRequest(absl::string_view request_id, const absl::Status& status) {
  return WithReason(absl::DataLossError(absl::StrCat("the session that request_id \"", Shortened(request_id),
                                                     "\" made is damaged in the store (", status.message(),
                                                     "): delete it, or choose another request_id")),
                    v1::SESSION_DAMAGED);
}

}  // namespace

SessionManager::SessionManager(const Options& options, Store& store, ModelRegistry& models, WorkerPool& pool)
    : options_(options),
      store_(store),
      pool_(pool),
      factory_(
          {options.limits, options.make_tracker, {options.now, options.steady_now}, options.metrics, options.memory},
          store, models, pool),
      orphans_(store, options.limits.expiry, options.shares_store) {
  // Threads of gRPC call this class: the lock, here and in the destructor, shows the order to race detectors.
  const std::lock_guard lock(mutex_);
}

SessionManager::~SessionManager() { const std::lock_guard lock(mutex_); }

absl::StatusOr<std::shared_ptr<Session>> SessionManager::Create(const std::string& tenant, const SessionConfig& config,
                                                                const std::string& request_id,
                                                                const std::string& peer) {
  EVPOSE_RETURN_IF_ERROR(config.Validate());
  // This check is not in SessionConfig::Validate(), so that stored sessions of earlier servers can still be read.
  if (const absl::Status view = config.camera.CheckView(); !view.ok()) {
    return InvalidField("config.camera", view.message());
  }
  DeleteExpired();
  const Request request(tenant, request_id);
  EVPOSE_RETURN_IF_ERROR(RestoreRequest(request));
  KeyedMutexes<Request>::Lock request_lock;  // the same request may arrive twice at the same time
  if (!request_id.empty()) request_lock = request_mutexes_.LockKey(request);
  EVPOSE_ASSIGN_OR_RETURN(std::shared_ptr<Session> known, FindOrReserveSlot(config, request));
  if (known != nullptr) return known;
  SessionLock session_lock;
  auto session = OrOutOfMemory([&] { return ResumeOrMake(config, request, session_lock); });
  const std::lock_guard lock(mutex_);
  ReleaseSlot(tenant);
  if (!session.ok()) return session.status();
  Insert(*session, request);
  (*session)->log().Created(peer, config);
  return session;
}

absl::StatusOr<std::shared_ptr<Session>> SessionManager::FindOrReserveSlot(const SessionConfig& config,
                                                                           const Request& request) {
  EVPOSE_RETURN_IF_ERROR(CheckNotDraining());
  const std::lock_guard lock(mutex_);
  EVPOSE_ASSIGN_OR_RETURN(std::shared_ptr<Session> known, FindRequest(config, request));
  if (known != nullptr) return known;
  EVPOSE_RETURN_IF_ERROR(ReserveSlot(request.first));
  return nullptr;
}

absl::Status SessionManager::CheckLoad(const std::string& tenant) const {
  const LoadMonitor* const load = options_.load;
  if (load == nullptr || !load->IsOverloaded() || num_sessions_of(tenant) == 0) return absl::OkStatus();
  options_.metrics->overload_refusals.Add();
  return LimitReached(v1::OVERLOADED, "max_load",
                      absl::StrCat("the workers of the server use ", std::lround(100.0 * load->ratio()),
                                   " % of their time, more than its bound of ", std::lround(100.0 * load->max_ratio()),
                                   " %; create the session at another server, or later"),
                      kRetryDelay);
}

absl::Status SessionManager::CheckSlotIsFree(const std::string& tenant) const {
  if (sessions_.size() + waiting_.size() + reserved_slots_ >= options_.max_sessions) {
    options_.metrics->quota_refusals[QuotaLimit::kMaxSessions].Add();
    return LimitReached(v1::TOO_MANY_SESSIONS, "max_sessions",
                        absl::StrCat("all ", options_.max_sessions,
                                     " sessions are taken: delete one that is not needed, or try again later"),
                        kRetryDelay);
  }
  const auto reserved = reserved_slots_by_.find(tenant);
  const uint32_t num_reserved = reserved == reserved_slots_by_.end() ? 0 : reserved->second;
  if (CountSessions(tenant) + num_reserved >= options_.max_tenant_sessions) {
    options_.metrics->quota_refusals[QuotaLimit::kTenantSessions].Add();
    return LimitReached(v1::TENANT_QUOTA, "tenant_sessions",
                        absl::StrCat("this tenant has its ", options_.max_tenant_sessions,
                                     " sessions: delete one that is not needed, or try again later"),
                        kRetryDelay);
  }
  return absl::OkStatus();
}

absl::StatusOr<std::shared_ptr<Session>> SessionManager::ResumeRequest(const SessionConfig& config,
                                                                       const Request& request, SessionLock& lock) {
  if (request.second.empty()) return nullptr;
  const auto record = store_.FindRequest(request.first, request.second);
  if (absl::IsNotFound(record.status())) return nullptr;
  if (absl::IsDataLoss(record.status())) return DamagedRequest(request.second, record.status());
  if (!record.ok()) return FromStore(record.status());
  if (record->config != EncodeConfig(config)) return RequestIdReused(request.second, record->name);
  lock = session_mutexes_.LockKey(record->name);
  // A stream may have attached to it since the request was searched for.
  if (auto here = FindOpen(request.first, record->name); here != nullptr) return here;
  EVPOSE_ASSIGN_OR_RETURN(SessionFactory::Resumed resumed, factory_.Resume(record->name));
  return std::move(resumed.session);
}

uint32_t SessionManager::CountSessions(const std::string& tenant) const {
  const auto here = std::count_if(sessions_.begin(), sessions_.end(),
                                  [&tenant](const auto& entry) { return entry.second.tenant() == tenant; });
  return static_cast<uint32_t>(here) + static_cast<uint32_t>(waiting_.size_of(tenant));
}

absl::Status SessionManager::ReserveSlot(const std::string& tenant) {
  EVPOSE_RETURN_IF_ERROR(CheckSlotIsFree(tenant));
  ++reserved_slots_by_[tenant];
  ++reserved_slots_;
  return absl::OkStatus();
}

void SessionManager::ReleaseSlot(const std::string& tenant) {
  --reserved_slots_;
  const auto filling = reserved_slots_by_.find(tenant);
  if (--filling->second == 0) reserved_slots_by_.erase(filling);
}

absl::StatusOr<std::shared_ptr<Session>> SessionManager::FindRequest(const SessionConfig& config,
                                                                     const Request& request) {
  const std::string& request_id = request.second;
  if (request_id.empty()) return nullptr;
  const auto name = name_of_request_.find(request);
  if (name == name_of_request_.end()) return nullptr;
  const std::shared_ptr<Session>& session = sessions_.find(name->second)->second.session;
  if (session->config() == config) return session;
  return RequestIdReused(request_id, session->name());
}

void SessionManager::Insert(const std::shared_ptr<Session>& session, const Request& request) {
  waiting_.Remove(session->name());
  sessions_[session->name()] = {session, request};
  if (!request.second.empty()) name_of_request_[request] = session->name();
}

SessionManager::Entry SessionManager::Remove(Entries::iterator entry) {
  name_of_request_.erase(entry->second.request);
  return std::move(sessions_.extract(entry).mapped());
}

std::shared_ptr<Session> SessionManager::FindOpen(const std::string& tenant, absl::string_view name) {
  std::shared_ptr<Session> closed;  // is destroyed after the lock has been released
  const std::lock_guard lock(mutex_);
  const auto found = sessions_.find(name);
  if (found == sessions_.end() || found->second.tenant() != tenant) return nullptr;
  if (found->second.session->Watch().status.ok()) return found->second.session;
  closed = Remove(found).session;
  return nullptr;
}

absl::StatusOr<std::shared_ptr<Session>> SessionManager::Get(const std::string& tenant, absl::string_view name) {
  DeleteExpired();
  std::shared_ptr<Session> session = FindOpen(tenant, name);
  if (session == nullptr) return SessionNotFound(name);
  return session;
}

std::shared_ptr<SessionMirror> SessionManager::FindMirror(const std::string& tenant, const std::string& name) {
  const std::lock_guard lock(mutex_);
  std::erase_if(mirrors_, [](const auto& entry) { return entry.second.expired(); });
  const auto found = mirrors_.find({tenant, name});
  return found == mirrors_.end() ? nullptr : found->second.lock();
}

absl::StatusOr<std::shared_ptr<WatchedSession>> SessionManager::Mirror(const std::string& tenant,
                                                                       const std::string& name) {
  RestoreIfWaiting(tenant, name);
  if (std::shared_ptr<Session> session = FindOpen(tenant, name); session != nullptr) return session;
  if (auto mirror = FindMirror(tenant, name); mirror != nullptr && mirror->Watch().status.ok()) return mirror;
  EVPOSE_ASSIGN_OR_RETURN(SessionFactory::Stored stored, ReadOwn(tenant, name, /*after_pose_seq=*/0));
  if (!options_.shares_store) return SessionNotFound(name);
  const auto read = [this, name](uint64_t after_pose_seq) { return factory_.Read(name, after_pose_seq); };
  auto mirror = SessionMirror::Start(std::move(stored), read, options_.limits.pose_log_capacity, kMirrorPeriod, pool_);
  const std::lock_guard lock(mutex_);
  mirrors_[{tenant, name}] = mirror;
  return mirror;
}

std::shared_ptr<Session> SessionManager::FindForAttach(const std::string& tenant, absl::string_view name,
                                                       absl::string_view resume_token) {
  DeleteExpired();
  std::shared_ptr<Session> session = FindOpen(tenant, name);
  if (session == nullptr || !session->IsTokenValid(resume_token)) return nullptr;
  return session;
}

absl::StatusOr<SessionInfo> SessionManager::Describe(const std::string& tenant, const std::string& name) {
  DeleteExpired();
  RestoreIfWaiting(tenant, name);
  if (const auto session = FindOpen(tenant, name); session != nullptr) return session->Describe();
  EVPOSE_ASSIGN_OR_RETURN(SessionFactory::Stored stored, ReadOwn(tenant, name));
  NoteWaiting(tenant, stored.info);
  return std::move(stored.info);
}

absl::StatusOr<std::map<std::string, SessionInfo>> SessionManager::DescribeAsStored(
    const std::string& tenant, const std::vector<std::string>& names) {
  std::map<std::string, SessionInfo> described;
  std::vector<std::string> elsewhere;
  for (const std::string& name : names) {
    if (const auto session = FindOpen(tenant, name); session != nullptr) {
      described.emplace(name, session->Describe());
    } else {
      elsewhere.push_back(name);
    }
  }
  if (elsewhere.empty()) return described;
  EVPOSE_ASSIGN_OR_RETURN(std::vector<SessionFactory::Stored> read,
                          OrOutOfMemory([&] { return factory_.ReadWithoutPoses(elsewhere); }));
  for (SessionFactory::Stored& stored : read) {
    if (stored.record.tenant != tenant) continue;
    NoteWaiting(tenant, stored.info);
    described.emplace(stored.record.name, std::move(stored.info));
  }
  return described;
}

void SessionManager::NoteWaiting(const std::string& tenant, SessionInfo& info) const {
  const std::lock_guard lock(mutex_);
  if (!waiting_.Contains(tenant, info.name)) return;
  // The process that had its stream has ended.
  SessionSnapshot& snapshot = info.snapshot;
  if (snapshot.state == SessionState::kAttached) snapshot.state = SessionState::kDetached;
  snapshot.expire_time = found_at_ + options_.limits.expiry;
}

absl::StatusOr<SessionFactory::Stored> SessionManager::ReadOwn(const std::string& tenant, const std::string& name,
                                                               uint64_t after_pose_seq) const {
  auto stored = OrOutOfMemory([&] { return factory_.Read(name, after_pose_seq); });
  if (stored.ok() && stored->record.tenant != tenant) return SessionNotFound(name);
  if (!absl::IsDataLoss(stored.status())) return stored;
  // If the tenant is not known either, a caller with the name is the owner: names cannot be guessed.
  const auto owner = store_.ReadTenant(name);
  const bool is_unknown = absl::IsNotFound(owner.status()) || (owner.ok() && owner->empty());
  if (is_unknown) return stored;
  if (!owner.ok()) return FromStore(owner.status());
  if (*owner != tenant) return SessionNotFound(name);
  return stored;
}

absl::StatusOr<std::vector<SessionInfo>> SessionManager::List(const std::string& tenant, absl::string_view after_name,
                                                              size_t max_sessions) {
  DeleteExpired();
  std::vector<SessionInfo> sessions;
  std::string place(after_name);
  do {
    const auto page = store_.ListSessions(tenant, place, max_sessions);
    if (!page.ok()) return FromStore(page.status());
    std::set<std::string> names = NamesHere(tenant, place, page->last_name);
    for (const SessionRecord& record : page->records) names.insert(record.name);
    for (auto name = names.begin(); name != names.end() && sessions.size() < max_sessions;) {
      const size_t num_wanted = std::min(kSessionsPerRead, max_sessions - sessions.size());
      std::vector<std::string> some;
      while (name != names.end() && some.size() < num_wanted) some.push_back(*name++);
      EVPOSE_ASSIGN_OR_RETURN(auto described, DescribeAsStored(tenant, some));
      for (auto& [described_name, info] : described) sessions.push_back(std::move(info));
    }
    place = page->last_name;
  } while (!place.empty() && sessions.size() < max_sessions);
  return sessions;
}

std::set<std::string> SessionManager::NamesHere(const std::string& tenant, absl::string_view after_name,
                                                absl::string_view last_name) const {
  std::set<std::string> names;
  const std::lock_guard lock(mutex_);
  for (auto entry = sessions_.upper_bound(after_name); entry != sessions_.end(); ++entry) {
    if (!last_name.empty() && entry->first > last_name) break;
    if (entry->second.tenant() == tenant) names.insert(entry->first);
  }
  return names;
}

absl::Status SessionManager::Delete(const std::string& tenant, const std::string& name, const std::string& peer) {
  // Until the store has deleted the session, a stream that attaches would resume it from there.
  const SessionLock session_lock = session_mutexes_.LockKey(name);
  Entry removed;
  {
    const std::lock_guard lock(mutex_);
    const auto found = sessions_.find(name);
    if (found != sessions_.end() && found->second.tenant() == tenant) removed = Remove(found);
  }
  if (removed.session == nullptr) return DeleteStored(tenant, name, peer);
  removed.session->log().Deleted(peer, "request", CloseRemoved(removed, "was deleted"));
  return FromStore(store_.DeleteSession(name));
}

absl::Status SessionManager::DeleteStored(const std::string& tenant, const std::string& name, const std::string& peer) {
  const auto stored = ReadOwn(tenant, name);
  if (!stored.ok() && !absl::IsDataLoss(stored.status())) return stored.status();
  const absl::Status deleted = FromStore(store_.DeleteSession(name));
  if (deleted.ok()) {
    StopWaiting(name);
    if (stored.ok()) {
      SessionLog(name, tenant).Deleted(peer, "request", stored->Sums(options_.now()));
    } else {
      SessionLog(name, tenant).DeletedUnread(peer, "request; it was damaged");
    }
  }
  return deleted;
}

void SessionManager::DeleteExpired() {
  std::vector<Entry> expired;
  std::vector<Entry> closed;  // fenced, or without space in the store; they stay in the store
  {
    const std::lock_guard lock(mutex_);
    const absl::Time now = options_.now();
    for (auto it = sessions_.begin(); it != sessions_.end();) {
      const auto entry = it++;
      const std::optional<absl::Time> expire_time = entry->second.session->expire_time();
      const bool is_closed = !entry->second.session->Watch().status.ok();
      if (!is_closed && expire_time.value_or(absl::InfiniteFuture()) > now) continue;
      (is_closed ? closed : expired).push_back(Remove(entry));
    }
  }
  for (const Entry& entry : expired) {
    entry.session->log().Expired(CloseRemoved(entry, "expired"));
    // The deletion runs on another thread, because callers must not wait for the store. The client may use the session
    // at another server, which this server detects only when it writes: the session then continues there.
    pool_.slow().PostOwn([this, name = entry.session->name(), tenant = entry.tenant(), token = entry.session->token()] {
      const absl::Status status = store_.DeleteHeldSession(name, token);
      if (absl::IsAborted(status)) {
        SessionLog(name, tenant).HeldByOtherServer();
      } else if (!status.ok()) {
        SessionLog(name, tenant).NotDeleted(status);
      }
    });
  }
}

void SessionManager::DeleteEnded() {
  pool_.slow().PostOwn([this] {
    // Sessions of this server are deleted when they expire. This deletes sessions that no server has, and ended
    // sessions that must make room.
    // Other servers may have written the times of the ends, and the clock of this one may be ahead of the wall clock.
    const absl::Time now = std::min(options_.now(), absl::Now());
    const auto names = store_.DeleteEnded(now - 2 * options_.limits.expiry);
    if (!names.ok()) {
      Log(LogLevel::kWarning, "ended_sessions_not_deleted", {{"message", names.status().message()}});
      return;
    }
    for (const std::string& name : *names) {
      Entry removed;
      {
        const std::lock_guard lock(mutex_);
        waiting_.Remove(name);
        const auto found = sessions_.find(name);
        if (found == sessions_.end()) continue;
        removed = Remove(found);
      }
      removed.session->log().Deleted("", "room", CloseRemoved(removed, "was deleted to make room"));
    }
  });
}

void SessionManager::MaintainStore() {
  if (options_.shares_store) {
    for (const auto& session : Sessions()) session->RenewOwnership();
  }
  pool_.slow().PostOwn([this] {
    orphans_.Collect(
        options_.now(), Sessions().size(), [this](const std::string& name) { return IsHere(name); },
        [this](const std::string& name) { StopWaiting(name); });
  });
}

bool SessionManager::IsHere(const std::string& name) const {
  const std::lock_guard lock(mutex_);
  return sessions_.contains(name);
}

SessionSums SessionManager::CloseRemoved(const Entry& entry, const char* reason) {
  const std::string& name = entry.session->name();
  entry.session->Close(
      WithReason(absl::NotFoundError(absl::StrCat(name, " ", reason)), v1::SESSION_DELETED, {{"session", name}}));
  return entry.session->Sums();
}

void SessionManager::Drain() {
  const std::lock_guard lock(mutex_);
  is_draining_ = true;
}

absl::Status SessionManager::CheckNotDraining() const {
  const std::lock_guard lock(mutex_);
  if (!is_draining_) return absl::OkStatus();
  return WithReason(absl::UnavailableError("the server is shutting down: no new sessions and streams"), v1::DRAINING);
}

std::vector<std::shared_ptr<Session>> SessionManager::Sessions() const {
  const std::lock_guard lock(mutex_);
  std::vector<std::shared_ptr<Session>> sessions;
  for (const auto& [name, entry] : sessions_) sessions.push_back(entry.session);
  return sessions;
}

bool SessionManager::FlushAll(absl::Time deadline) {
  const auto listener = std::make_shared<WaitingListener>();
  const std::vector<std::shared_ptr<Session>> sessions = Sessions();
  for (const auto& session : sessions) {
    session->AddWatcher(listener);
    session->Flush();
  }
  return listener->WaitUntil(deadline, [&sessions] {
    return std::all_of(sessions.begin(), sessions.end(), [](const auto& session) { return session->IsFlushed(); });
  });
}

void SessionManager::CloseAll(const absl::Status& status) {
  for (const auto& session : Sessions()) {
    session->log().Drained(session->Watch().last_pose_seq, session->IsFlushed());
    session->Close(status);
  }
}

uint32_t SessionManager::num_sessions() const {
  const std::lock_guard lock(mutex_);
  return static_cast<uint32_t>(sessions_.size() + waiting_.size());
}

uint32_t SessionManager::num_sessions_of(const std::string& tenant) const {
  const std::lock_guard lock(mutex_);
  return CountSessions(tenant);
}

SessionTotals SessionManager::totals() const {
  SessionTotals totals;
  for (const auto& session : Sessions()) session->AddTo(totals);
  const std::lock_guard lock(mutex_);
  totals.detached += static_cast<uint32_t>(waiting_.size());
  return totals;
}

uint32_t SessionManager::num_attached() const {
  const std::lock_guard lock(mutex_);
  return static_cast<uint32_t>(std::count_if(sessions_.begin(), sessions_.end(), [](const auto& entry) {
    return !entry.second.session->expire_time().has_value();
  }));
}

}  // namespace evpose::server

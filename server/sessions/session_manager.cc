#include "server/sessions/session_manager.h"

#include <mutex>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "core/initialization/pose_search.h"
#include "server/sessions/errors.h"
#include "server/sessions/log.h"
#include "server/sessions/random_name.h"

namespace evpose::server {
namespace {

// When a slot may be free again is not known; clients ask again after this.
constexpr absl::Duration kRetryDelay = absl::Seconds(5);

}  // namespace

SessionManager::SessionManager(const Options& options, Store& store, ModelRegistry& models, WorkerPool& pool)
    : options_(options), store_(store), models_(models), pool_(pool) {
  // The calls come on threads of gRPC: the lock, here and in the destructor, orders them in a way that tools can see.
  const std::lock_guard lock(mutex_);
}

SessionManager::~SessionManager() { const std::lock_guard lock(mutex_); }

absl::StatusOr<std::shared_ptr<Session>> SessionManager::Create(const SessionConfig& config,
                                                                const std::string& request_id) {
  EVPOSE_RETURN_IF_ERROR(config.Validate());
  DeleteExpired();
  EVPOSE_ASSIGN_OR_RETURN(std::shared_ptr<Session> known, FindOrTakeSlot(config, request_id));
  if (known != nullptr) return known;
  auto session = Build(config);
  if (!session.ok()) {
    const std::lock_guard lock(mutex_);
    --slots_being_filled_;
    return session.status();
  }
  return Insert(*std::move(session), request_id);
}

absl::StatusOr<std::shared_ptr<Session>> SessionManager::FindOrTakeSlot(const SessionConfig& config,
                                                                        const std::string& request_id) {
  EVPOSE_RETURN_IF_ERROR(CheckNotDraining());
  const std::lock_guard lock(mutex_);
  EVPOSE_ASSIGN_OR_RETURN(std::shared_ptr<Session> known, FindRequest(config, request_id));
  if (known != nullptr) return known;
  const size_t taken = sessions_.size() + slots_being_filled_;
  if (taken >= options_.max_sessions) {
    return LimitReached("TOO_MANY_SESSIONS", "max_sessions",
                        absl::StrCat("all ", options_.max_sessions,
                                     " sessions are taken: delete one that is not needed, or try again later"),
                        kRetryDelay);
  }
  ++slots_being_filled_;
  return nullptr;
}

absl::StatusOr<std::shared_ptr<Session>> SessionManager::FindRequest(const SessionConfig& config,
                                                                     const std::string& request_id) {
  if (request_id.empty()) return nullptr;
  const auto name = name_of_request_.find(request_id);
  if (name == name_of_request_.end()) return nullptr;
  const std::shared_ptr<Session>& session = sessions_.find(name->second)->second.session;
  if (session->config() == config) return session;
  return WithReason(absl::AlreadyExistsError(absl::StrCat("request_id \"", request_id, "\" made ", session->name(),
                                                          " with another configuration: choose a new one")),
                    "REQUEST_ID_REUSED", {{"session", session->name()}});
}

absl::StatusOr<std::shared_ptr<Session>> SessionManager::Build(const SessionConfig& config) {
  std::vector<std::shared_ptr<const ObjectModel>> models;
  Session::Parts parts;
  for (const ObjectConfig& object : config.objects) {
    EVPOSE_ASSIGN_OR_RETURN(ModelUse use, models_.Use(object.model));
    if (const absl::Status status = CheckLinesDeterminePose(*use.model); !status.ok()) {
      return InvalidField(absl::StrCat("config.objects[", models.size(), "].model"), status.message());
    }
    models.push_back(std::move(use.model));
    parts.model_uses.push_back(std::move(use.use));
  }
  EVPOSE_ASSIGN_OR_RETURN(parts.pipeline, SessionPipeline::Create(config, models, options_.make_tracker));
  EVPOSE_ASSIGN_OR_RETURN(const std::string id, RandomHex128());
  EVPOSE_ASSIGN_OR_RETURN(parts.resume_token, RandomHex128());
  parts.name = absl::StrCat("sessions/", id);
  EVPOSE_ASSIGN_OR_RETURN(parts.pose_log, store_.CreatePoseLog(parts.name));
  parts.config = config;
  parts.limits = options_.limits;
  parts.now = options_.now;
  return std::make_shared<Session>(std::move(parts), pool_);
}

absl::StatusOr<std::shared_ptr<Session>> SessionManager::Insert(std::shared_ptr<Session> session,
                                                                const std::string& request_id) {
  absl::StatusOr<std::shared_ptr<Session>> known;
  {
    const std::lock_guard lock(mutex_);
    --slots_being_filled_;
    // The same request may have come twice at once.
    known = FindRequest(session->config(), request_id);
    if (known.ok() && *known == nullptr) {
      sessions_[session->name()] = {session, request_id};
      if (!request_id.empty()) name_of_request_[request_id] = session->name();
    }
  }
  if (known.ok() && *known == nullptr) {
    ServerLog().info("{} created: {}, {}x{}, {} object(s)", session->name(), EncodingName(session->config().encoding),
                     session->config().camera.width_px, session->config().camera.height_px,
                     session->config().objects.size());
    return session;
  }
  Remove({{std::move(session), ""}}, "was made twice");
  return known;
}

absl::StatusOr<std::shared_ptr<Session>> SessionManager::Get(absl::string_view name) {
  DeleteExpired();
  const std::lock_guard lock(mutex_);
  const auto found = sessions_.find(name);
  if (found != sessions_.end()) return found->second.session;
  return WithReason(absl::NotFoundError(absl::StrCat("there is no session \"", name,
                                                     "\": it never was, was deleted, or expired; create a new one")),
                    "SESSION_NOT_FOUND", {{"session", std::string(name)}});
}

std::vector<std::shared_ptr<Session>> SessionManager::List(absl::string_view after_name, size_t max_sessions) {
  DeleteExpired();
  const std::lock_guard lock(mutex_);
  std::vector<std::shared_ptr<Session>> sessions;
  for (auto it = sessions_.upper_bound(after_name); it != sessions_.end() && sessions.size() < max_sessions; ++it) {
    sessions.push_back(it->second.session);
  }
  return sessions;
}

void SessionManager::Delete(absl::string_view name) {
  std::vector<Entry> removed;
  {
    const std::lock_guard lock(mutex_);
    const auto found = sessions_.find(name);
    if (found == sessions_.end()) return;
    name_of_request_.erase(found->second.request_id);
    removed.push_back(std::move(found->second));
    sessions_.erase(found);
  }
  Remove(std::move(removed), "was deleted");
}

void SessionManager::DeleteExpired() {
  std::vector<Entry> removed;
  {
    const std::lock_guard lock(mutex_);
    const absl::Time now = options_.now();
    for (auto it = sessions_.begin(); it != sessions_.end();) {
      const std::optional<absl::Time> expire_time = it->second.session->expire_time();
      if (!expire_time.has_value() || *expire_time > now) {
        ++it;
        continue;
      }
      name_of_request_.erase(it->second.request_id);
      removed.push_back(std::move(it->second));
      it = sessions_.erase(it);
    }
  }
  Remove(std::move(removed), "expired");
}

void SessionManager::Remove(std::vector<Entry> entries, const char* reason) {
  for (const Entry& entry : entries) {
    const std::string& name = entry.session->name();
    entry.session->Close(
        WithReason(absl::NotFoundError(absl::StrCat(name, " ", reason)), "SESSION_DELETED", {{"session", name}}));
    if (const absl::Status status = store_.DeletePoseLog(name); !status.ok()) {
      ServerLog().warn("{}: its poses cannot be deleted: {}", name, std::string(status.message()));
    }
    ServerLog().info("{} {}: {} poses", name, reason, entry.session->Watch().last_pose_seq);
  }
}

void SessionManager::Drain() {
  const std::lock_guard lock(mutex_);
  draining_ = true;
}

absl::Status SessionManager::CheckNotDraining() const {
  const std::lock_guard lock(mutex_);
  if (!draining_) return absl::OkStatus();
  return WithReason(absl::UnavailableError("the server is leaving: no new sessions and streams"), "DRAINING");
}

void SessionManager::CloseAll(const absl::Status& status) {
  std::vector<std::shared_ptr<Session>> sessions;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [name, entry] : sessions_) sessions.push_back(entry.session);
  }
  for (const auto& session : sessions) session->Close(status);
}

uint32_t SessionManager::num_sessions() const {
  const std::lock_guard lock(mutex_);
  return static_cast<uint32_t>(sessions_.size());
}

}  // namespace evpose::server

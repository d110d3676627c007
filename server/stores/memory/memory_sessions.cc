// SPDX-License-Identifier: Apache-2.0
#include "server/stores/memory/memory_sessions.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/stores/common/checked_lease.h"

namespace evpose::server {
namespace {

uint64_t SizeBytes(const StoredSession& session) {
  return session.record.config.size() + session.lifecycle.size() + session.checkpoint.size() + SizeBytes(session.poses);
}

void Apply(SessionCommit commit, uint64_t next_pose_seq, MemorySession& session) {
  std::vector<PoseSegment>& poses = session.stored.poses;
  if (commit.checkpoint.has_value()) session.stored.checkpoint = *commit.checkpoint;
  if (commit.lifecycle.has_value()) session.stored.lifecycle = *std::move(commit.lifecycle);
  if (commit.ended_at.has_value()) session.ended_at = commit.ended_at;
  if (!commit.poses.empty()) {
    std::erase_if(poses, [&](const PoseSegment& segment) { return segment.first_pose_seq >= next_pose_seq; });
    session.next_pose_seq = commit.poses.back().last_pose_seq + 1;
    std::move(commit.poses.begin(), commit.poses.end(), std::back_inserter(poses));
  }
  session.first_pose_seq_kept = std::max(session.first_pose_seq_kept, commit.first_pose_seq_kept);
  std::erase_if(poses, [&](const PoseSegment& segment) { return segment.last_pose_seq < session.first_pose_seq_kept; });
}

}  // namespace

absl::StatusOr<FencingToken> MemorySessions::Create(const SessionRecord& record, const std::string& lifecycle,
                                                    std::string holder) {
  const std::lock_guard lock(mutex_);
  const std::pair<std::string, std::string> request = {record.tenant, record.request_id};
  if (contents_.sessions.contains(record.name) || contents_.names_of_requests.contains(request)) {
    return SessionExistsError(record.name);
  }
  const FencingToken token = {contents_.last_fencing_number + 1, std::move(holder)};
  MemorySession session = {.stored = {.record = record, .lifecycle = lifecycle}, .token = token};
  const uint64_t size_bytes = SizeBytes(session.stored);
  EVPOSE_RETURN_IF_ERROR(MakeRoom(size_bytes, record.name));
  contents_.size_bytes += size_bytes;
  NoteLifecycleWrite(contents_.sessions.emplace(record.name, std::move(session)).first->second);
  contents_.names_of_tenants.emplace(record.tenant, record.name);
  if (!record.request_id.empty()) contents_.names_of_requests.emplace(request, record.name);
  ++contents_.last_fencing_number;
  return token;
}

absl::StatusOr<MemorySession> MemorySessions::Acquire(absl::string_view name, std::string holder) {
  const std::lock_guard lock(mutex_);
  const auto found = contents_.sessions.find(name);
  if (found == contents_.sessions.end()) return SessionNotFoundError(name);
  found->second.token = {++contents_.last_fencing_number, std::move(holder)};
  found->second.last_commit = 0;
  return found->second;
}

absl::StatusOr<StoredSession> MemorySessions::Read(absl::string_view name, uint64_t after_pose_seq) const {
  const std::lock_guard lock(mutex_);
  const auto found = contents_.sessions.find(name);
  if (found == contents_.sessions.end()) return SessionNotFoundError(name);
  const StoredSession& all = found->second.stored;
  StoredSession read = {.record = all.record, .lifecycle = all.lifecycle, .checkpoint = all.checkpoint};
  std::copy_if(all.poses.begin(), all.poses.end(), std::back_inserter(read.poses),
               [&](const PoseSegment& segment) { return segment.last_pose_seq > after_pose_seq; });
  return read;
}

std::vector<StoredSession> MemorySessions::ReadWithoutPoses(const std::vector<std::string>& names) const {
  std::vector<StoredSession> sessions;
  for (const std::string& name : names) {
    if (auto session = Read(name, kAfterAllPoses); session.ok()) sessions.push_back(*std::move(session));
  }
  return sessions;
}

absl::StatusOr<std::string> MemorySessions::ReadTenant(absl::string_view name) const {
  const std::lock_guard lock(mutex_);
  const auto found = contents_.sessions.find(name);
  if (found == contents_.sessions.end()) return SessionNotFoundError(name);
  return found->second.stored.record.tenant;
}

SessionPage MemorySessions::List(absl::string_view tenant, absl::string_view after_name, size_t max_sessions) const {
  const std::lock_guard lock(mutex_);
  const auto& names = contents_.names_of_tenants;
  const auto is_of_tenant = [&](const auto& place) { return place != names.end() && place->first == tenant; };
  SessionPage page;
  auto place = names.upper_bound({std::string(tenant), std::string(after_name)});
  for (; is_of_tenant(place) && page.records.size() < max_sessions; ++place) {
    page.records.push_back(contents_.sessions.find(place->second)->second.stored.record);
  }
  if (is_of_tenant(place) && !page.records.empty()) page.last_name = page.records.back().name;
  return page;
}

absl::StatusOr<SessionRecord> MemorySessions::FindRequest(absl::string_view tenant,
                                                          absl::string_view request_id) const {
  const std::lock_guard lock(mutex_);
  const auto found = contents_.names_of_requests.find({std::string(tenant), std::string(request_id)});
  if (found == contents_.names_of_requests.end()) return RequestNotFoundError(request_id);
  return contents_.sessions.find(found->second)->second.stored.record;
}

std::vector<SessionOwner> MemorySessions::ListOwners() const {
  const std::lock_guard lock(mutex_);
  std::vector<SessionOwner> owners;
  owners.reserve(contents_.sessions.size());
  for (const auto& [name, session] : contents_.sessions) owners.push_back({name, session.stored.record.tenant});
  return owners;
}

std::vector<StoredLifecycle> MemorySessions::ReadOldestLifecycles(size_t max_sessions) const {
  const std::lock_guard lock(mutex_);
  std::vector<StoredLifecycle> lifecycles;
  for (const auto& [write, name] : contents_.names_by_lifecycle_write) {
    if (lifecycles.size() == max_sessions) break;
    lifecycles.push_back({.name = name, .lifecycle = contents_.sessions.find(name)->second.stored.lifecycle});
  }
  return lifecycles;
}

void MemorySessions::Delete(absl::string_view name) {
  const std::lock_guard lock(mutex_);
  if (const auto found = contents_.sessions.find(name); found != contents_.sessions.end()) Erase(found);
}

absl::Status MemorySessions::DeleteHeld(absl::string_view name, const FencingToken& token) {
  const std::lock_guard lock(mutex_);
  const auto found = contents_.sessions.find(name);
  if (found == contents_.sessions.end()) return absl::OkStatus();
  EVPOSE_RETURN_IF_ERROR(CheckHolder(name, found->second.token, token));
  Erase(found);
  return absl::OkStatus();
}

std::vector<std::string> MemorySessions::DeleteEnded(absl::Time ended_before) {
  const std::lock_guard lock(mutex_);
  std::vector<std::string> names = std::exchange(deleted_for_room_, {});
  for (auto session = contents_.sessions.begin(); session != contents_.sessions.end();) {
    const bool is_deleted = session->second.ended_at.has_value() && *session->second.ended_at < ended_before;
    if (is_deleted) names.push_back(session->first);
    session = is_deleted ? Erase(session) : std::next(session);
  }
  return names;
}

absl::Status MemorySessions::Commit(absl::string_view name, const FencingToken& token, const CommitPlace& place,
                                    SessionCommit commit) {
  const std::lock_guard lock(mutex_);
  const auto found = contents_.sessions.find(name);
  if (found == contents_.sessions.end()) return SessionNotFoundError(name);
  EVPOSE_RETURN_IF_ERROR(CheckHolder(name, found->second.token, token));
  if (found->second.last_commit < place.last_ok) return RolledBackError(name, token.number);
  EVPOSE_RETURN_IF_ERROR(MakeRoom(SizeBytes(commit), name));
  contents_.size_bytes -= SizeBytes(found->second.stored);
  if (commit.lifecycle.has_value()) NoteLifecycleWrite(found->second);
  Apply(std::move(commit), place.next_pose_seq, found->second);
  found->second.last_commit = place.number;
  contents_.size_bytes += SizeBytes(found->second.stored);
  return absl::OkStatus();
}

MemorySessions::Contents MemorySessions::Copy() const {
  const std::lock_guard lock(mutex_);
  return contents_;
}

void MemorySessions::Replace(Contents contents) {
  const std::lock_guard lock(mutex_);
  contents_ = std::move(contents);
}

StoreUsage MemorySessions::Usage() const {
  const std::lock_guard lock(mutex_);
  return {.bytes = contents_.size_bytes, .max_bytes = max_bytes_};
}

absl::Status MemorySessions::MakeRoom(uint64_t more_bytes, absl::string_view keep) {
  while (contents_.size_bytes + more_bytes > max_bytes_) {
    auto oldest = contents_.sessions.end();
    for (auto session = contents_.sessions.begin(); session != contents_.sessions.end(); ++session) {
      if (session->first == keep || !session->second.ended_at.has_value()) continue;
      if (oldest == contents_.sessions.end() || *session->second.ended_at < *oldest->second.ended_at) oldest = session;
    }
    if (oldest == contents_.sessions.end()) {
      return absl::ResourceExhaustedError(absl::StrCat("the sessions in memory are full: ", more_bytes,
                                                       " bytes do not fit beside ", contents_.size_bytes,
                                                       " of at most ", max_bytes_, "; delete sessions, or allow more"));
    }
    deleted_for_room_.push_back(oldest->first);
    Erase(oldest);
  }
  return absl::OkStatus();
}

void MemorySessions::NoteLifecycleWrite(MemorySession& session) {
  contents_.names_by_lifecycle_write.erase(session.lifecycle_write);
  session.lifecycle_write = ++contents_.last_lifecycle_write;
  contents_.names_by_lifecycle_write.emplace(session.lifecycle_write, session.stored.record.name);
}

MemorySessions::Sessions::iterator MemorySessions::Erase(Sessions::iterator session) {
  const SessionRecord& record = session->second.stored.record;
  contents_.names_of_tenants.erase({record.tenant, record.name});
  if (!record.request_id.empty()) contents_.names_of_requests.erase({record.tenant, record.request_id});
  contents_.names_by_lifecycle_write.erase(session->second.lifecycle_write);
  contents_.size_bytes -= SizeBytes(session->second.stored);
  return contents_.sessions.erase(session);
}

}  // namespace evpose::server

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

uint64_t SizeBytes(const std::vector<PoseSegment>& poses) {
  uint64_t bytes = 0;
  for (const PoseSegment& segment : poses) bytes += segment.bytes.size();
  return bytes;
}

uint64_t SizeBytes(const StoredSession& session) {
  return session.record.config.size() + session.lifecycle.size() + session.checkpoint.size() + SizeBytes(session.poses);
}

uint64_t SizeBytes(const SessionCommit& commit) {
  return (commit.checkpoint.has_value() ? commit.checkpoint->size() : 0) +
         (commit.lifecycle.has_value() ? commit.lifecycle->size() : 0) + SizeBytes(commit.poses);
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

absl::StatusOr<uint64_t> MemorySessions::Create(const SessionRecord& record, const std::string& lifecycle) {
  const std::lock_guard lock(mutex_);
  if (sessions_.contains(record.name)) return SessionExistsError(record.name);
  MemorySession session = {.stored = {.record = record, .lifecycle = lifecycle},
                           .fencing_number = last_fencing_number_ + 1};
  const uint64_t size_bytes = SizeBytes(session.stored);
  EVPOSE_RETURN_IF_ERROR(MakeRoom(size_bytes, record.name));
  size_bytes_ += size_bytes;
  sessions_.emplace(record.name, std::move(session));
  return ++last_fencing_number_;
}

absl::StatusOr<MemorySession> MemorySessions::Take(absl::string_view name) {
  const std::lock_guard lock(mutex_);
  const auto found = sessions_.find(name);
  if (found == sessions_.end()) return SessionNotFoundError(name);
  found->second.fencing_number = ++last_fencing_number_;
  return found->second;
}

absl::StatusOr<StoredSession> MemorySessions::Read(absl::string_view name, uint64_t after_pose_seq) const {
  const std::lock_guard lock(mutex_);
  const auto found = sessions_.find(name);
  if (found == sessions_.end()) return SessionNotFoundError(name);
  const StoredSession& all = found->second.stored;
  StoredSession read = {.record = all.record, .lifecycle = all.lifecycle, .checkpoint = all.checkpoint};
  std::copy_if(all.poses.begin(), all.poses.end(), std::back_inserter(read.poses),
               [&](const PoseSegment& segment) { return segment.last_pose_seq > after_pose_seq; });
  return read;
}

std::vector<SessionRecord> MemorySessions::List() const {
  const std::lock_guard lock(mutex_);
  std::vector<SessionRecord> records;
  records.reserve(sessions_.size());
  for (const auto& [name, session] : sessions_) records.push_back(session.stored.record);
  return records;
}

std::vector<StoredLifecycle> MemorySessions::ReadLifecycles() const {
  const std::lock_guard lock(mutex_);
  std::vector<StoredLifecycle> lifecycles;
  lifecycles.reserve(sessions_.size());
  for (const auto& [name, session] : sessions_) {
    lifecycles.push_back({.name = name, .lifecycle = session.stored.lifecycle});
  }
  return lifecycles;
}

void MemorySessions::Delete(absl::string_view name) {
  const std::lock_guard lock(mutex_);
  if (const auto found = sessions_.find(name); found != sessions_.end()) Erase(found);
}

absl::Status MemorySessions::DeleteHeld(absl::string_view name, uint64_t fencing_number) {
  const std::lock_guard lock(mutex_);
  const auto found = sessions_.find(name);
  if (found == sessions_.end()) return absl::OkStatus();
  if (found->second.fencing_number != fencing_number) return FencedError(name, fencing_number);
  Erase(found);
  return absl::OkStatus();
}

std::vector<std::string> MemorySessions::DeleteEnded(absl::Time ended_before) {
  const std::lock_guard lock(mutex_);
  std::vector<std::string> names = std::exchange(deleted_for_room_, {});
  for (auto session = sessions_.begin(); session != sessions_.end();) {
    const bool goes = session->second.ended_at.has_value() && *session->second.ended_at < ended_before;
    if (goes) names.push_back(session->first);
    session = goes ? Erase(session) : std::next(session);
  }
  return names;
}

absl::Status MemorySessions::Commit(absl::string_view name, uint64_t fencing_number, uint64_t next_pose_seq,
                                    SessionCommit commit) {
  const std::lock_guard lock(mutex_);
  const auto found = sessions_.find(name);
  if (found == sessions_.end()) return SessionNotFoundError(name);
  if (found->second.fencing_number != fencing_number) return FencedError(name, fencing_number);
  EVPOSE_RETURN_IF_ERROR(MakeRoom(SizeBytes(commit), name));
  size_bytes_ -= SizeBytes(found->second.stored);
  Apply(std::move(commit), next_pose_seq, found->second);
  size_bytes_ += SizeBytes(found->second.stored);
  return absl::OkStatus();
}

StoreUsage MemorySessions::Usage() const {
  const std::lock_guard lock(mutex_);
  return {.bytes = size_bytes_, .max_bytes = max_bytes_};
}

absl::Status MemorySessions::MakeRoom(uint64_t more_bytes, absl::string_view keep) {
  while (size_bytes_ + more_bytes > max_bytes_) {
    auto oldest = sessions_.end();
    for (auto session = sessions_.begin(); session != sessions_.end(); ++session) {
      if (session->first == keep || !session->second.ended_at.has_value()) continue;
      if (oldest == sessions_.end() || *session->second.ended_at < *oldest->second.ended_at) oldest = session;
    }
    if (oldest == sessions_.end()) {
      return absl::ResourceExhaustedError(absl::StrCat("the sessions in memory are full: ", more_bytes,
                                                       " bytes do not fit beside ", size_bytes_, " of at most ",
                                                       max_bytes_, "; delete sessions, or allow more"));
    }
    deleted_for_room_.push_back(oldest->first);
    Erase(oldest);
  }
  return absl::OkStatus();
}

MemorySessions::Sessions::iterator MemorySessions::Erase(Sessions::iterator session) {
  size_bytes_ -= SizeBytes(session->second.stored);
  return sessions_.erase(session);
}

}  // namespace evpose::server

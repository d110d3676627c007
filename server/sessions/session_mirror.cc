// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/session_mirror.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "server/runtime/errors.h"
#include "server/runtime/out_of_memory.h"
#include "server/sessions/stream/stream_gate.h"

namespace evpose::server {

std::shared_ptr<SessionMirror> SessionMirror::Start(SessionFactory::Stored stored, ReadStored read, size_t capacity,
                                                    absl::Duration period, WorkerPool& pool) {
  std::shared_ptr<SessionMirror> mirror(new SessionMirror(stored, std::move(read), capacity, period, pool));
  const std::lock_guard lock(mirror->mutex_);
  mirror->Update(std::move(stored));
  mirror->timer_ = pool.MakeTimer([weak = mirror->weak_from_this()] {
    if (const auto self = weak.lock()) self->OnTimer();
  });
  mirror->Schedule();
  return mirror;
}

SessionMirror::SessionMirror(const SessionFactory::Stored& stored, ReadStored read, size_t capacity,
                             absl::Duration period, WorkerPool& pool)
    : name_(stored.record.name),
      config_(stored.info.config),
      read_(std::move(read)),
      capacity_(capacity),
      period_(period),
      pool_(pool),
      watchers_(std::make_shared<Watchers>(pool)),
      pose_log_(std::make_unique<PoseLog>(capacity, stored.info.snapshot.health.poses + 1)) {}

// The last reference may be released on a thread of gRPC: the lock shows to race detectors that all calls have ended.
SessionMirror::~SessionMirror() {
  const std::lock_guard lock(mutex_);
  timer_.reset();
}

WatchView SessionMirror::Watch() const {
  const std::lock_guard lock(mutex_);
  return {.status = status_, .has_ended = has_ended_, .last_pose_seq = pose_log_->last_pose_seq()};
}

std::vector<StoredPose> SessionMirror::ReadPoses(uint64_t after_pose_seq, size_t max_poses) const {
  const std::lock_guard lock(mutex_);
  return pose_log_->Read(after_pose_seq, max_poses);
}

SessionHealth SessionMirror::health() const {
  const std::lock_guard lock(mutex_);
  return health_;
}

void SessionMirror::Schedule() {
  if (status_.ok() && !has_ended_) timer_->Arm(period_);
}

void SessionMirror::OnTimer() {
  const absl::Status posted = OrOutOfMemory([this] {
    pool_.slow().PostOwn([weak = weak_from_this()] {
      if (const auto self = weak.lock()) self->Refresh();
    });
    return absl::OkStatus();
  });
  if (posted.ok()) return;
  const std::lock_guard lock(mutex_);
  Schedule();
}

void SessionMirror::Refresh() {
  auto stored = OrOutOfMemory([this] { return read_(Watch().last_pose_seq); });
  bool has_changed = false;
  {
    const std::lock_guard lock(mutex_);
    RunUnlessOutOfMemory([&]() ABSL_NO_THREAD_SAFETY_ANALYSIS { has_changed = Update(std::move(stored)); });
    Schedule();
  }
  if (has_changed) watchers_->Notify();
}

bool SessionMirror::Update(absl::StatusOr<SessionFactory::Stored> stored) {
  if (absl::IsNotFound(stored.status())) {
    status_ = WithReason(absl::NotFoundError(absl::StrCat(name_, " was deleted, or has expired")), v1::SESSION_DELETED,
                         {{"session", name_}});
  } else if (absl::IsDataLoss(stored.status())) {
    status_ = stored.status();
  }
  if (!stored.ok()) return !status_.ok();
  health_ = std::move(stored->info.snapshot.health);
  has_ended_ = stored->info.snapshot.state == SessionState::kEnded;
  const uint64_t lost_from_seq = stored->lifecycle.lost_from_seq;
  if (lost_from_seq > 0) status_ = ItemsLost(name_, lost_from_seq);
  if (stored->poses.empty()) return has_ended_ || !status_.ok();
  const uint64_t first = stored->poses.front().pose_seq;
  const bool is_first = pose_log_->first_pose_seq() > pose_log_->last_pose_seq();
  if (is_first || first > pose_log_->last_pose_seq() + 1) pose_log_ = std::make_unique<PoseLog>(capacity_, first);
  pose_log_->Append(stored->poses);
  return true;
}

}  // namespace evpose::server

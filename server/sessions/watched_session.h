// SPDX-License-Identifier: Apache-2.0

// A session as those see it who look on: one of this server (Session), or one that another server holds
// (SessionMirror).
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/status.h"
#include "server/sessions/types/pose_log.h"
#include "server/sessions/types/session_config.h"
#include "server/sessions/types/session_state.h"
#include "server/sessions/watchers.h"

namespace evpose::server {

// What a reader must know to go on.
struct WatchView {
  absl::Status status;  // not OK: the session is no more
  bool ended = false;   // no more poses will come
  uint64_t last_pose_seq = 0;
};

// Thread-safe.
class WatchedSession {
 public:
  virtual ~WatchedSession() = default;

  virtual const SessionConfig& config() const = 0;
  virtual WatchView Watch() const = 0;
  // As PoseLog::Read.
  virtual std::vector<StoredPose> ReadPoses(uint64_t after_pose_seq, size_t max_poses) const = 0;
  // A reader of what is new that is further behind loses the oldest.
  virtual uint64_t max_poses_behind() const = 0;
  virtual SessionHealth health() const = 0;
  virtual void AddWatcher(std::weak_ptr<SessionListener> watcher) = 0;
};

}  // namespace evpose::server

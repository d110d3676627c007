// SPDX-License-Identifier: Apache-2.0

// Interface of a session for watchers: a session of this server (Session), or a read-only replica of a session of
// another server (SessionMirror).
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/status.h"
#include "server/sessions/types/pose_log.h"
#include "server/sessions/types/session_config.h"
#include "server/sessions/types/session_state.h"
#include "server/sessions/watching/event_images.h"
#include "server/sessions/watching/watchers.h"

namespace evpose::server {

// State of the session from which a watcher decides its next action.
struct WatchView {
  absl::Status status;     // not OK: the session no longer exists; DATA_LOSS: the poses until then can still be read
  bool has_ended = false;  // there will be no more poses
  uint64_t last_pose_seq = 0;
};

// Thread-safe.
class WatchedSession {
 public:
  virtual ~WatchedSession() = default;

  virtual const SessionConfig& config() const = 0;
  virtual WatchView Watch() const = 0;
  // Does the same as PoseLog::Read().
  virtual std::vector<StoredPose> ReadPoses(uint64_t after_pose_seq, size_t max_poses) const = 0;
  // Returns the number of poses by which a live watcher may lag. A watcher that lags by more loses the oldest ones.
  virtual uint64_t max_poses_behind() const = 0;
  virtual SessionHealth health() const = 0;
  // Returns the images of the events; null if this server does not track them.
  virtual std::shared_ptr<EventImages> event_images() const { return nullptr; }
  virtual void AddWatcher(std::weak_ptr<SessionListener> watcher) = 0;
};

}  // namespace evpose::server

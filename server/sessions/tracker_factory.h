#pragma once

#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "core/geometry/camera.h"
#include "core/tracking/camera_tables.h"
#include "server/sessions/session_config.h"

namespace evpose::server {

// The tables of each camera that a tracker uses, for all trackers of that camera. They go with the last of them.
// Thread-safe.
class SharedCameraTables {
 public:
  // Errors: those of MakeCameraTables.
  absl::StatusOr<std::shared_ptr<const CameraTables>> Get(const CameraModel& camera);

 private:
  std::shared_ptr<const CameraTables> Find(const CameraModel& camera);

  std::mutex mutex_;
  std::vector<std::pair<CameraModel, std::weak_ptr<const CameraTables>>> in_use_;
};

// Trackers as a session's config asks for them; those of one camera share what they look up of it. Errors:
// INVALID_ARGUMENT with the field of the config.
TrackerFactory MakeTrackerFactory();

}  // namespace evpose::server

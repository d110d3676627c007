#include "server/sessions/tracker_factory.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/tracking/tracker.h"
#include "core/tracking/tracker_options.h"
#include "server/sessions/errors.h"

namespace evpose::server {
namespace {

absl::StatusOr<std::unique_ptr<Tracker>> MakeTracker(const SessionConfig& config,
                                                     const std::vector<std::shared_ptr<const ObjectModel>>& models,
                                                     SharedCameraTables& shared_tables) {
  std::vector<ObjectToTrack> objects;
  for (size_t i = 0; i < models.size(); ++i) {
    const ObjectConfig& object = config.objects[i];
    objects.push_back({models[i], object.initial_camera_from_object, object.reference_rotation});
    const absl::Status status = objects.back().Validate();
    if (!status.ok()) return InvalidField(absl::StrCat("config.objects[", i, "]"), status.message());
  }
  auto tables = shared_tables.Get(config.camera);
  if (!tables.ok()) return InvalidField("config", tables.status().message());
  TrackerOptions options;
  options.estimator = config.estimator;
  options.sensor = config.sensor;
  auto tracker = Tracker::Create(std::move(objects), config.camera, options, *std::move(tables));
  if (!tracker.ok()) return InvalidField("config", tracker.status().message());
  return tracker;
}

}  // namespace

absl::StatusOr<std::shared_ptr<const CameraTables>> SharedCameraTables::Get(const CameraModel& camera) {
  {
    const std::lock_guard lock(mutex_);
    if (auto tables = Find(camera); tables != nullptr) return tables;
  }
  // Without the lock: others need not wait. Who makes the same at the same time uses what was there first.
  auto made = MakeCameraTables(camera);
  if (!made.ok()) return made.status();
  const std::lock_guard lock(mutex_);
  if (auto tables = Find(camera); tables != nullptr) return tables;
  in_use_.emplace_back(camera, *made);
  return *std::move(made);
}

std::shared_ptr<const CameraTables> SharedCameraTables::Find(const CameraModel& camera) {
  in_use_.erase(
      std::remove_if(in_use_.begin(), in_use_.end(), [](const auto& entry) { return entry.second.expired(); }),
      in_use_.end());
  const auto found =
      std::find_if(in_use_.begin(), in_use_.end(), [&camera](const auto& entry) { return entry.first == camera; });
  return found == in_use_.end() ? nullptr : found->second.lock();
}

TrackerFactory MakeTrackerFactory() {
  return [tables = std::make_shared<SharedCameraTables>()](
             const SessionConfig& config, const std::vector<std::shared_ptr<const ObjectModel>>& models) {
    return MakeTracker(config, models, *tables);
  };
}

}  // namespace evpose::server

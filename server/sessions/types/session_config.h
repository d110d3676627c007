// SPDX-License-Identifier: Apache-2.0

// What a session is told at its creation, and what may be wrong with it.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "core/baselines/estimators/estimator_kind.h"
#include "core/estimation/sensor_profile.h"
#include "core/events/decoder.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"
#include "core/tracking/tracker.h"

namespace evpose::server {

struct ObjectConfig {
  std::string object_id;
  std::string model;  // "models/{id}"
  std::optional<RigidTransform> initial_camera_from_object;
  Eigen::Matrix3d reference_rotation = Eigen::Matrix3d::Identity();
};

// As the API's.
enum class OverloadPolicy { kBlock, kLatest };
// The API promises it to whoever gives none.
inline constexpr absl::Duration kDefaultMaxLag = absl::Milliseconds(20);

struct SessionConfig {
  Encoding encoding = Encoding::kEvt3;
  CameraModel camera;
  std::vector<ObjectConfig> objects;
  Estimator estimator = Estimator::kMixture;
  SensorProfile sensor;
  OverloadPolicy overload_policy = OverloadPolicy::kBlock;
  std::optional<absl::Duration> max_lag;  // with kLatest, and only then

  // Everything that needs no model and no decoder. Errors: INVALID_ARGUMENT with the field (sessions/errors.h), as a
  // path that begins with "config".
  absl::Status Validate() const;
};

bool operator==(const SessionConfig& a, const SessionConfig& b);

// Makes the tracker of a session's objects; tests put their own in the place of the real one. `models` are those of
// config.objects, in their order. Errors: INVALID_ARGUMENT with the field of `config` (sessions/errors.h).
using TrackerFactory = std::function<absl::StatusOr<std::unique_ptr<Tracker>>(
    const SessionConfig& config, const std::vector<std::shared_ptr<const ObjectModel>>& models)>;

}  // namespace evpose::server

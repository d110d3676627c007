// SPDX-License-Identifier: Apache-2.0

// Configuration of a session, and its validation.
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

  friend bool operator==(const ObjectConfig&, const ObjectConfig&) = default;
};

// The policies of the API.
enum class OverloadPolicy { kBlock, kLatest };
// Default of SessionConfig::max_lag, documented in the API.
inline constexpr absl::Duration kDefaultMaxLag = absl::Milliseconds(20);
// TrackerConfig::pose_rate_hz: the default and the limits of the API.
inline constexpr double kDefaultPoseRateHz = 1000.0;
inline constexpr double kMinPoseRateHz = 1000.0;
inline constexpr double kMaxPoseRateHz = 10'000.0;

struct SessionConfig {
  Encoding encoding = Encoding::kEvt3;
  CameraModel camera;
  std::vector<ObjectConfig> objects;
  Estimator estimator = Estimator::kMixture;
  SensorProfile sensor;
  double pose_rate_hz = kDefaultPoseRateHz;
  OverloadPolicy overload_policy = OverloadPolicy::kBlock;
  std::optional<absl::Duration> max_lag;  // required with kLatest, forbidden with kBlock

  // Checks everything that needs no model and no decoder. Errors: INVALID_ARGUMENT with the field
  // (server/runtime/errors.h), as a path that begins with "config".
  absl::Status Validate() const;

  friend bool operator==(const SessionConfig&, const SessionConfig&) = default;
};

// Creates the tracker of a session's objects; tests replace it. `models`: one for each of config.objects, in the same
// order. Errors: INVALID_ARGUMENT with the field of `config` (server/runtime/errors.h).
using TrackerFactory = std::function<absl::StatusOr<std::unique_ptr<Tracker>>(
    const SessionConfig& config, const std::vector<std::shared_ptr<const ObjectModel>>& models)>;

}  // namespace evpose::server

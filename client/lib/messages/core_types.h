// SPDX-License-Identifier: Apache-2.0

// Converts between the types of the public headers and those of core/. Internal; the only place that does so.
#pragma once

#include <optional>

#include "core/baselines/estimators/estimator_kind.h"
#include "core/estimation/sensor_profile.h"
#include "core/events/decoder.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/recordings/chunker.h"
#include "evpose/track.h"
#include "evpose/types.h"

namespace evpose::client {

Transform FromCore(const RigidTransform& transform);
RigidTransform ToCore(const Transform& transform);

Camera FromCore(const CameraModel& camera);
CameraModel ToCore(const Camera& camera);

SensorParameters FromCore(const SensorProfile& profile);  // without the name
SensorProfile ToCore(const SensorParameters& sensor);     // with an empty name

EventEncoding FromCore(Encoding encoding);
Encoding ToCore(EventEncoding encoding);

// nullopt for an estimator that servers do not offer.
std::optional<PoseEstimator> FromCore(Estimator estimator);

// Converts the results of sources that return chunks of core/.
absl::StatusOr<EventChunk> FromCore(absl::StatusOr<EventChunkBytes> chunk);

}  // namespace evpose::client

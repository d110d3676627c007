// SPDX-License-Identifier: Apache-2.0
#include "evpose/types.h"

#include <Eigen/LU>

#include "client/lib/core_types.h"

namespace evpose::client {

Eigen::Quaterniond Transform::Quaternion() const { return ToCore(*this).Quaternion(); }

absl::Status PoseReset::Validate() const {
  if (object_id.empty()) return absl::InvalidArgumentError("object_id is empty");
  if (!camera_from_object.translation_m.allFinite() || !camera_from_object.rotation.allFinite()) {
    return absl::InvalidArgumentError("camera_from_object: every number must be finite");
  }
  constexpr double kTolerance = 1e-3;  // that of a quaternion's norm in the API
  if (!camera_from_object.rotation.isUnitary(kTolerance) || camera_from_object.rotation.determinant() < 0.0) {
    return absl::InvalidArgumentError("camera_from_object: the matrix is not a rotation");
  }
  return absl::OkStatus();
}

std::string_view EventEncodingName(EventEncoding encoding) { return EncodingName(ToCore(encoding)); }

std::string_view TrackStateName(TrackState state) {
  switch (state) {
    case TrackState::kUnknown:
      break;
    case TrackState::kInitializing:
      return "INITIALIZING";
    case TrackState::kTracking:
      return "TRACKING";
    case TrackState::kDegraded:
      return "DEGRADED";
    case TrackState::kLost:
      return "LOST";
  }
  return "UNKNOWN";
}

std::string_view InitializationStatusName(InitializationStatus status) {
  switch (status) {
    case InitializationStatus::kNotNeeded:
      return "NOT_NEEDED";
    case InitializationStatus::kWaitingForEvents:
      return "WAITING_FOR_EVENTS";
    case InitializationStatus::kTooFewLines:
      return "TOO_FEW_LINES";
    case InitializationStatus::kNoPoseFits:
      return "NO_POSE_FITS";
    case InitializationStatus::kVerifying:
      return "VERIFYING";
    case InitializationStatus::kAmbiguous:
      return "AMBIGUOUS";
  }
  return "UNKNOWN";
}

}  // namespace evpose::client

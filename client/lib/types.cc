// SPDX-License-Identifier: Apache-2.0
#include "evpose/types.h"

#include <Eigen/LU>

#include "client/lib/messages/conversion.h"
#include "client/lib/messages/core_types.h"
#include "evpose/v1/session.pb.h"

namespace evpose::client {

Eigen::Quaterniond Transform::Quaternion() const { return ToCore(*this).Quaternion(); }

Transform Pose::At(int64_t at_us) const {
  return FromCore(Perturb(ToCore(camera_from_object), 1e-6 * static_cast<double>(at_us - t_us) * twist));
}

absl::Status PoseReset::Validate() const {
  if (object_id.empty()) return absl::InvalidArgumentError("object_id is empty");
  if (!camera_from_object.translation_m.allFinite() || !camera_from_object.rotation.allFinite()) {
    return absl::InvalidArgumentError("camera_from_object: every number must be finite");
  }
  constexpr double kTolerance = 1e-3;  // difference of a quaternion's norm from 1 that the API accepts
  if (!camera_from_object.rotation.isUnitary(kTolerance) || camera_from_object.rotation.determinant() < 0.0) {
    return absl::InvalidArgumentError("camera_from_object: the matrix is not a rotation");
  }
  return absl::OkStatus();
}

std::string_view EventEncodingName(EventEncoding encoding) { return EncodingName(ToCore(encoding)); }

std::string_view TrackStateName(TrackState state) {
  return ApiName(v1::TrackState_Name(static_cast<int>(state)), "TRACK_STATE_");
}

std::string_view LossCauseName(LossCause cause) {
  return ApiName(v1::LossCause_Name(static_cast<int>(cause)), "LOSS_CAUSE_");
}

std::string_view InitializationStatusName(InitializationStatus status) {
  return ApiName(v1::InitializationStatus_Name(static_cast<int>(status)), "INITIALIZATION_STATUS_");
}

std::string_view SessionStateName(SessionState state) {
  return ApiName(v1::SessionState_Name(static_cast<int>(state)), "SESSION_STATE_");
}

int EventImage::CellAt(int x, int y) const {
  const size_t index = static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x);
  return (cells[index / 4] >> (2 * (index % 4))) & 3;
}

}  // namespace evpose::client

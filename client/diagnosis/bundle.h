// SPDX-License-Identifier: Apache-2.0

// A bundle: an archive with all that poses were computed from, and the poses, so that they can be computed again
// elsewhere (README.md).
#pragma once

#include <cstdint>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/base/version.h"
#include "core/estimation/sensor_profile.h"
#include "core/geometry/camera.h"
#include "evpose/client.h"

namespace evpose::client {

struct Bundle {
  BuildVersion version;   // of the program that computed the poses
  std::string recording;  // a RAW or DAT file (RecordingSlice::file)
  std::string model;      // a file in the format of `upload`
  UploadOptions upload;   // without a file name
  CameraModel camera;
  SensorProfile sensor;
  std::string initial_pose;  // "tx ty tz qx qy qz qw", as --init-pose; empty: the object is searched for
  std::string poses;         // JSON lines
  std::string report;        // JSON, of evpose doctor; for people
};

// Errors: those of TarWriter. The archive appears when it is complete.
absl::Status WriteBundle(const std::string& path, const Bundle& bundle);

// Errors have the path: those of ReadTar() and of reading the parts; INVALID_ARGUMENT for a missing or wrong part,
// naming it, and for a bundle of a later format; DATA_LOSS for a part that differs from its SHA-256.
absl::StatusOr<Bundle> ReadBundle(const std::string& path);

}  // namespace evpose::client

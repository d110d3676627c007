// SPDX-License-Identifier: Apache-2.0

// A bundle: an archive with everything that poses were computed from, and the poses themselves, so that another machine
// can compute them again and compare them (README.md).
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

// Writes the archive, which appears under its name when it is complete. Errors: those of TarWriter; INVALID_ARGUMENT
// with the path for a bundle of more than 256 MiB, which ReadBundle() would refuse.
absl::Status WriteBundle(const std::string& path, const Bundle& bundle);

// Errors name the path: those of ReadTar() and of reading the parts; INVALID_ARGUMENT with the name of a missing or
// invalid part, and for a bundle of a later format; DATA_LOSS for a part that differs from its SHA-256.
absl::StatusOr<Bundle> ReadBundle(const std::string& path);

}  // namespace evpose::client

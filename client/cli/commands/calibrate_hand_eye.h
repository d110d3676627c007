// SPDX-License-Identifier: Apache-2.0

// evpose calibrate --hand-eye: the pose of the camera on a robot, or beside it.
#pragma once

#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/cli/common/command.h"
#include "core/geometry/rigid_transform.h"

namespace evpose::client {

struct HandEyeArguments {
  std::string reference;  // --hand-eye; empty: another kind of calibration
  std::string mount = "auto";
  std::string time_offset = "auto";

  // Adds the options after those of the calibrations by recordings, which are refused together with --hand-eye.
  void AddTo(CLI::App& app);
};

// {"translation_m": [x, y, z], "quaternion_xyzw": [x, y, z, w]}
Json TransformJson(const RigidTransform& transform);

// Parses "auto" (nullopt) or a number of seconds. Error: wrong usage.
absl::StatusOr<std::optional<double>> ParseTimeOffset(const std::string& text);

// Reads evpose's poses from the file `poses` and writes the transform of the camera to `out`.
absl::Status RunHandEye(const HandEyeArguments& arguments, const std::string& poses, const std::string& out,
                        bool is_json, CliContext& context);

}  // namespace evpose::client

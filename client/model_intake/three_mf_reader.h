// SPDX-License-Identifier: Apache-2.0

// 3MF files (3D Manufacturing Format, Core Specification 1.3). Assimp 5.2.5 does not check their indices and corrupts
// memory when it reads files with colours.
#pragma once

#include <cstddef>
#include <string>

#include "absl/status/statusor.h"
#include "client/model_intake/scene_reader.h"

namespace evpose::client {

// Reads the objects that the file builds, in metres, without supports. Errors: INVALID_ARGUMENT for a file that is no
// archive with a model, malformed, too large, without a triangle, with an unknown unit, or with a required extension
// that is not read.
absl::StatusOr<Scene> Read3mf(const std::string& path, size_t max_triangles);

}  // namespace evpose::client

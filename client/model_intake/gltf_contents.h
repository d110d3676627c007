// SPDX-License-Identifier: Apache-2.0

// What a glTF file needs of its reader.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace evpose::client {

struct GltfContents {
  // False: the places of the images on the surface are stored as whole numbers, which Assimp 5.2.5 does not convert.
  bool are_images_read = true;
  // True: a primitive is compressed by KHR_draco_mesh_compression, which Assimp decodes.
  bool has_draco = false;
  std::vector<std::string> notices;
};

// Checks a file of glTF 2.0, text or binary (GLB). Assimp 5.2.5 ignores which extensions a file requires and the types
// of its numbers, and would return another surface without an error. Errors, INVALID_ARGUMENT: malformed, another
// version, a required extension that is not read, data that only such an extension could read, coordinates or normals
// that are not floating-point numbers, a primitive of an unknown mode.
absl::StatusOr<GltfContents> CheckGltf(absl::string_view contents);

}  // namespace evpose::client

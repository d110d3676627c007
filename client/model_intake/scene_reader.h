// SPDX-License-Identifier: Apache-2.0

// Files of scenes (glTF, COLLADA, OFF, 3MF, OBJ with materials), read by Assimp.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <opencv2/core/mat.hpp>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/mesh/types/raw_mesh.h"

namespace evpose::client {

// Larger than what a server accepts, because images, animations, XML and text take space that a mesh does not need.
inline constexpr size_t kMaxModelFileBytes = size_t{512} << 20;

enum class SceneFormat { kObj, kGltf, kGlb, kDae, kOff, k3mf };

struct Scene {
  // All meshes of the scene, moved by the transformations of its nodes, in metres; OFF and OBJ, which state no unit, in
  // their own. The axes are those of the file.
  RawMesh mesh;
  // For each triangle the image on it, an index into `images` or -1, and the positions of its corners in the image: u
  // to the right and v upwards, from 0 to 1; the image repeats beyond.
  std::vector<int> image_of;
  std::vector<std::array<Eigen::Vector2d, 3>> image_positions;
  std::vector<cv::Mat> images;  // grey, 8 bits
  std::vector<std::string> notices;
};

// Errors: those of ReadFile(); INVALID_ARGUMENT for a file that is empty, malformed, of another format, too large,
// without a triangle or line, or with an unknown unit.
absl::StatusOr<Scene> ReadScene(const std::string& path, SceneFormat format, size_t max_triangles);

}  // namespace evpose::client

// SPDX-License-Identifier: Apache-2.0

// Strict checks of model files before Assimp reads them.
//
// Assimp 5.2 never ends on a PLY header that is cut off, reads cut vertices as zeros, writes past its buffers for some
// hostile PLY files, accepts indices out of range in PLY, opens the material files that an OBJ names, and says of none
// of its errors where they are. Model files come from users over the network, so it only ever sees what has passed
// here.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"

namespace evpose {

struct ModelFileLimits {
  size_t max_lines = 0;
  size_t max_triangles = 0;  // polygons count as the triangles that they become
};

struct CheckedModelFile {
  std::string content;  // what Assimp may read; empty: the bytes as they were
  size_t faces = 0;     // polygons, as Assimp must find them
  size_t lines = 0;     // pairs of points
};

// Each: INVALID_ARGUMENT naming line (text) or place (binary) for what is malformed, cut off, not finite, out of range,
// or more than the limits allow.

// Keeps only `v`, `f` and `l`: comments, materials, groups, normals and texture coordinates are left out, continued
// lines are joined, and indices are made absolute. Unknown statements are skipped, as OBJ readers do.
absl::StatusOr<CheckedModelFile> CheckObj(absl::Span<const uint8_t> bytes, const ModelFileLimits& limits);
// ASCII, little and big endian; elements `vertex` (with x, y, z) and `face` (with vertex_indices).
absl::StatusOr<CheckedModelFile> CheckPly(absl::Span<const uint8_t> bytes, const ModelFileLimits& limits);
// ASCII and binary.
absl::StatusOr<CheckedModelFile> CheckStl(absl::Span<const uint8_t> bytes, const ModelFileLimits& limits);

// Counts what a model file adds up to, against the limits. Errors: INVALID_ARGUMENT, without the place.
class ModelFileCounter {
 public:
  explicit ModelFileCounter(const ModelFileLimits& limits) : limits_(limits) {}

  absl::Status AddFace(size_t corners);
  absl::Status AddLines(size_t count);

  size_t faces() const { return faces_; }
  size_t lines() const { return lines_; }

 private:
  ModelFileLimits limits_;
  size_t faces_ = 0;
  size_t lines_ = 0;
  size_t triangles_ = 0;
};

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// What is tracked: a mesh that hides, and the lines that show.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

enum class ModelFormat { kObj, kPly, kStl };

struct ModelLine {
  Eigen::Vector3d p1;  // object frame, metres
  Eigen::Vector3d p2;
  // Outward unit normals of the adjacent faces: 0 (a wire, or painted on nothing), 1 (boundary) or 2 (crease); more
  // where more faces meet in one edge. A line painted on a face has that face's normal, once.
  std::vector<Eigen::Vector3d> face_normals;
};

struct ObjectModel {
  std::vector<Eigen::Vector3d> vertices;           // object frame, metres
  std::vector<std::array<uint32_t, 3>> triangles;  // counter-clockwise seen from outside
  std::vector<ModelLine> lines;
  double diameter_m = 0.0;  // largest distance between two points of the model
  // object_from_object motions that map the object onto itself (symmetry.h), the identity first; empty stands for the
  // identity alone.
  std::vector<RigidTransform> symmetries;
  std::vector<std::string> notices;  // what was merged or dropped at loading: duplicate or zero-length lines
};

struct ModelOptions {
  double metres_per_unit = 1.0;    // scale of the file's numbers
  double crease_angle_deg = 30.0;  // an edge whose faces' normals differ by more is a line; coplanar ones are not
  size_t max_bytes = 64u << 20;    // larger files are refused: bounds memory for uploads
  size_t max_lines = 4096;
  size_t max_triangles = 2'000'000;

  absl::Status Validate() const;
};

// OBJ line elements (`l`) are the lines when there are any, as they are drawn; else crease and boundary edges: coplanar
// neighbours' edges are not lines, and collinear edges that continue each other are joined. Lines of length zero and
// duplicates are dropped, and lines that overlap are made one, with a notice. The symmetries are FindSymmetries()'s.
// Triangles are given one winding, outward where a surface is closed. No other file is opened, whatever the bytes name.
// Errors, INVALID_ARGUMENT: unreadable (with the loader's words), no line and no face, no line at all, a number that is
// not finite, an index out of range, more than the options allow.
absl::StatusOr<ObjectModel> ParseObjectModel(absl::Span<const uint8_t> bytes, ModelFormat format,
                                             const ModelOptions& options);
// The format from the file's ending. Errors name the path: NOT_FOUND, INVALID_ARGUMENT (also for an unknown ending).
absl::StatusOr<ObjectModel> LoadObjectModel(const std::string& path, const ModelOptions& options = {});
absl::StatusOr<ModelFormat> ModelFormatFromPath(const std::string& path);

// OBJ text with `v`, `f` and `l` elements.
std::string ObjectModelToObj(const ObjectModel& model);

}  // namespace evpose

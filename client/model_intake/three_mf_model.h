// SPDX-License-Identifier: Apache-2.0

// The model parts of a 3MF file: objects and what is built of them.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace evpose::client {

struct ThreeMfComponent {
  std::string part;  // that has the object; empty: the part of the component itself
  int object = 0;
  Eigen::Affine3d placed = Eigen::Affine3d::Identity();
};

struct ThreeMfObject {
  bool is_model = true;  // false: a support, or of the type "other"
  bool has_beams = false;
  std::vector<Eigen::Vector3d> points;
  std::vector<std::array<uint32_t, 3>> triangles;
  std::vector<ThreeMfComponent> components;
};

struct ThreeMfPart {
  std::string unit;  // as stated; empty if it is not
  std::map<int, ThreeMfObject> objects;
  std::vector<ThreeMfComponent> build;
};

// Errors, INVALID_ARGUMENT with the place: malformed, an index out of range, an extension that the part requires and
// that is not read.
absl::StatusOr<ThreeMfPart> ParseThreeMfPart(const std::string& text);

}  // namespace evpose::client

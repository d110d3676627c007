// SPDX-License-Identifier: Apache-2.0

// The unit cube in every format, prisms, and functions that read them for tests.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/models/object_model.h"

namespace evpose {

inline constexpr char kCubeVertices[] =
    "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
    "v 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\n";
inline constexpr char kCubeFaces[] = "f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";

inline std::string Cube() { return absl::StrCat(kCubeVertices, kCubeFaces); }

// OBJ text of a prism of height 1 on a regular polygon of circumradius 1.
inline std::string Prism(int sides) {
  std::string obj, low, high, walls;
  for (int i = 0; i < sides; ++i) {
    const double angle = 2 * M_PI * i / sides;
    absl::StrAppendFormat(&obj, "v %.9g %.9g 0\nv %.9g %.9g 1\n", std::cos(angle), std::sin(angle), std::cos(angle),
                          std::sin(angle));
    const int a = 2 * i + 1, b = 2 * ((i + 1) % sides) + 1;
    low = absl::StrCat(" ", a, low);
    absl::StrAppend(&high, " ", a + 1);
    absl::StrAppendFormat(&walls, "f %d %d %d %d\n", a, b, b + 1, a + 1);
  }
  return absl::StrCat(obj, "f", low, "\nf", high, "\n", walls);
}

// Returns the options for a mesh whose facets are the surface itself.
inline ModelOptions AsIs() {
  ModelOptions options;
  options.is_smooth = false;
  return options;
}

inline absl::StatusOr<ObjectModel> Parse(const std::string& text, ModelFormat format = ModelFormat::kObj,
                                         const ModelOptions& options = {}) {
  return ParseObjectModel({reinterpret_cast<const uint8_t*>(text.data()), text.size()}, format, options);
}

inline ObjectModel MustParse(const std::string& text, ModelFormat format = ModelFormat::kObj,
                             const ModelOptions& options = {}) {
  absl::StatusOr<ObjectModel> model = Parse(text, format, options);
  EXPECT_TRUE(model.ok()) << model.status();
  return model.ok() ? *std::move(model) : ObjectModel();
}

inline std::string ErrorOf(const std::string& text, ModelFormat format = ModelFormat::kObj,
                           const ModelOptions& options = {}) {
  const absl::StatusOr<ObjectModel> model = Parse(text, format, options);
  EXPECT_EQ(model.status().code(), absl::StatusCode::kInvalidArgument);
  return std::string(model.status().message());
}

inline std::string AsciiPly() {
  return "ply\nformat ascii 1.0\ncomment a cube\nelement vertex 8\nproperty float x\nproperty float y\n"
         "property double z\nproperty uchar red\nelement face 6\nproperty list uchar int vertex_indices\nend_header\n"
         "0 0 0 1\n1 0 0 1\n1 1 0 1\n0 1 0 1\n0 0 1 1\n1 0 1 1\n1 1 1 1\n0 1 1 1\n"
         "4 0 3 2 1\n4 4 5 6 7\n4 0 1 5 4\n4 1 2 6 5\n4 2 3 7 6\n4 3 0 4 7\n";
}

template <typename T>
void AppendBinary(T value, bool big_endian, std::string& out) {
  char raw[sizeof(T)];
  std::memcpy(raw, &value, sizeof(T));
  if (big_endian) std::reverse(raw, raw + sizeof(T));
  out.append(raw, sizeof(T));
}

inline std::string BinaryPly(bool big_endian) {
  const ObjectModel cube = MustParse(Cube());
  std::string ply = absl::StrCat("ply\nformat binary_", big_endian ? "big" : "little",
                                 "_endian 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
                                 "property float z\nelement face 12\nproperty list uchar uint vertex_index\n"
                                 "end_header\n");
  for (const Eigen::Vector3d& v : cube.vertices) {
    for (int i = 0; i < 3; ++i) AppendBinary(static_cast<float>(v[i]), big_endian, ply);
  }
  for (const auto& triangle : cube.triangles) {
    ply += '\3';
    for (const uint32_t vertex : triangle) AppendBinary(vertex, big_endian, ply);
  }
  return ply;
}

inline std::string AsciiStl(const ObjectModel& model) {
  std::string stl = "solid a cube\n";
  for (const auto& triangle : model.triangles) {
    stl += "  facet normal 0 0 0\n    outer loop\n";
    for (const uint32_t vertex : triangle) {
      const Eigen::Vector3d& v = model.vertices[vertex];
      absl::StrAppendFormat(&stl, "      vertex %g %g %g\n", v.x(), v.y(), v.z());
    }
    stl += "    endloop\n  endfacet\n";
  }
  return stl + "endsolid a cube\n";
}

inline std::string BinaryStl(const ObjectModel& model) {
  std::string stl(80, ' ');
  AppendBinary(static_cast<uint32_t>(model.triangles.size()), false, stl);
  for (const auto& triangle : model.triangles) {
    stl.append(12, '\0');
    for (const uint32_t vertex : triangle) {
      for (int i = 0; i < 3; ++i) AppendBinary(static_cast<float>(model.vertices[vertex][i]), false, stl);
    }
    stl.append(2, '\0');
  }
  return stl;
}

}  // namespace evpose

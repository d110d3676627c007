// SPDX-License-Identifier: Apache-2.0
#include "core/models/model_file_check.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace evpose {
namespace {

// Triangulation cuts ears, whose time grows at least with the square of the corners.
constexpr size_t kMaxCorners = 512;

}  // namespace

absl::Status ModelFileCounter::AddFace(size_t corners) {
  if (corners < 3) return absl::InvalidArgumentError(absl::StrCat("a face has ", corners, " corners, but needs 3"));
  if (corners > kMaxCorners) {
    return absl::InvalidArgumentError(
        absl::StrFormat("a face has %d corners, but at most %d are read; triangulate the model", corners, kMaxCorners));
  }
  ++faces_;
  triangles_ += corners - 2;
  if (triangles_ <= limits_.max_triangles) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrFormat("more than %d triangles; simplify the model", limits_.max_triangles));
}

absl::Status ModelFileCounter::AddLines(size_t count) {
  lines_ += count;
  if (lines_ <= limits_.max_lines) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrFormat("more than %d lines; leave out the small ones", limits_.max_lines));
}

}  // namespace evpose

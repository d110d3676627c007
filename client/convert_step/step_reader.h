// SPDX-License-Identifier: Apache-2.0

// STEP and IGES files, read and triangulated by OpenCASCADE (client/convert_step/README.md).
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/mesh/types/raw_mesh.h"

namespace evpose::client {

struct StepOptions {
  // Largest distance between a facet and the surface, relative to the diagonal of the model: 0.15 px at a size of 300
  // px.
  double deflection_ratio = 5e-4;
  // Largest angle by which the surface turns along a facet, radians: circles, however small, have at least 21 sides.
  double turn_rad = 0.3;
  // Largest distance between a segment of a curved edge and the curve, relative to the diagonal: that of the segments
  // of a model's curves (core/models/README.md, section 5).
  double edge_deflection_ratio = 2e-5;
  size_t max_triangles = 2'000'000;  // what a server accepts

  absl::Status Validate() const;
};

struct StepModel {
  RawMesh mesh;
  std::vector<std::string> notices;  // what is missing, and what was repaired
};

// Returns the faces and edges of a file in metres, with their exact normals, shapes and curves. Errors: those of
// CheckIsFile(); INVALID_ARGUMENT for a file that cannot be read or has no face, for more triangles than the options
// allow, and for invalid options.
absl::StatusOr<StepModel> ReadStep(const std::string& path, const StepOptions& options = {});

}  // namespace evpose::client

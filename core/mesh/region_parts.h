// SPDX-License-Identifier: Apache-2.0

// Cuts a smooth region into parts of one shape each (core/mesh/README.md, section 13).
#pragma once

#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/mesh/types/raw_mesh.h"
#include "core/mesh/types/smooth_surface.h"

namespace evpose {

struct RegionPart {
  std::vector<uint32_t> triangles;  // ascending
  SurfaceRegion region;
};

// The parts of a connected set of triangles to which no single shape fits (FitShape). Each is connected; those without
// a shape (kFree) are the last. The borders between them are smooth edges. Its steps are proportional to the number of
// triangles, also for meshes that are made to be slow; it has yield points.
std::vector<RegionPart> FindRegionParts(const RawMesh& mesh, absl::Span<const uint32_t> triangles, double diameter_m);

}  // namespace evpose

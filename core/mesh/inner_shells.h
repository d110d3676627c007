// SPDX-License-Identifier: Apache-2.0

// Removes the surfaces that no camera outside the object can see (core/mesh/README.md, section 6).
#pragma once

#include <cstddef>
#include <cstdint>

#include "absl/types/span.h"
#include "core/mesh/types/raw_mesh.h"

namespace evpose {

struct InnerShells {
  size_t shells = 0;     // removed surfaces
  size_t triangles = 0;  // their triangles
};

// Removes each shell that lies inside a closed one and is farther than `tolerance_m` from it. `shell_of` has one of
// `num_shells` numbers for each triangle (OrientTriangles()). Only the 64 closed shells with the largest boxes are
// compared, and the time is bounded: shells that were not compared stay.
InnerShells RemoveInnerShells(double tolerance_m, absl::Span<const uint32_t> shell_of, size_t num_shells,
                              RawMesh& mesh);

}  // namespace evpose

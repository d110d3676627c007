// SPDX-License-Identifier: Apache-2.0

// Readers of model files. They accept any bytes: model files come from users over the network.
// Errors of all, INVALID_ARGUMENT naming the line, or the facet or byte of binary data: malformed, cut off, a
// coordinate that is not finite, an index out of range, more elements than the limits allow, text in UTF-16 or UTF-32.
// A byte order mark of UTF-8 is skipped. No other file is opened.
#pragma once

#include <cstdint>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/mesh/types/raw_mesh.h"

namespace evpose {

// Wavefront OBJ: the statements `v` (its first three numbers), `vn`, `f` and `l`. All other statements are skipped;
// groups and objects become one mesh. The mesh has the vertices that a face or line uses, in the order of first use. A
// normal that is not three finite numbers or that does not exist counts as none.
absl::StatusOr<RawMesh> ReadObj(absl::Span<const uint8_t> bytes, const MeshLimits& limits);

// PLY: ASCII with one line per instance, or binary of either byte order. An element `vertex` with x, y and z, then at
// most one element `face` with a list vertex_indices (or vertex_index) of integers. The vertices may have normals nx,
// ny, nz; other properties of the two are skipped, and other elements, too, with a notice, except triangle strips. The
// mesh has all vertices of the file, in their order.
absl::StatusOr<RawMesh> ReadPly(absl::Span<const uint8_t> bytes, const MeshLimits& limits);

// STL: binary when the size is the one that the facet count demands, else ASCII. Each facet has three points of its
// own. Up to one in a hundred facets of a binary file may have coordinates that are not finite: they are dropped, with
// a notice. Normals, attributes and names are ignored; the solids of an ASCII file become one mesh.
absl::StatusOr<RawMesh> ReadStl(absl::Span<const uint8_t> bytes, const MeshLimits& limits);

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// The lines of a model, from the edges of its mesh or from its line elements (core/models/README.md, section 4).
#pragma once

#include <cstddef>
#include <vector>

#include "absl/status/statusor.h"
#include "core/mesh/mesh_topology.h"
#include "core/models/object_model.h"
#include "core/mesh/triangle_bvh.h"

namespace evpose {

// Boundary edges and edges at which the surface turns by more than the angle, with the normals of all their faces.
// Collinear edges that continue each other are joined. `model` must be welded. Errors: INVALID_ARGUMENT for more than
// `max_lines` lines.
absl::StatusOr<std::vector<ModelLine>> CreaseLines(const RawMesh& model, double crease_angle_deg, size_t max_lines);

// The line elements with the normals of the faces on which they lie: the normals of both faces along an edge (one if
// these are parallel), that of the face inside a face, none away from all faces. `faces` is the search tree of the same
// mesh, `diameter_m` the diameter of the model.
std::vector<ModelLine> PaintedLines(const RawMesh& model, const TriangleBvh& faces, double diameter_m);

}  // namespace evpose

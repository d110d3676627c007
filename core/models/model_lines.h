// SPDX-License-Identifier: Apache-2.0

// The lines of a model: from the edges of its mesh, or from its line elements.
#pragma once

#include <cstddef>
#include <vector>

#include "absl/status/statusor.h"
#include "core/models/mesh_topology.h"
#include "core/models/object_model.h"
#include "core/models/triangle_bvh.h"

namespace evpose {

// Boundary edges and edges whose faces turn by more than the angle, with their faces' normals; collinear ones that
// continue each other are joined. Where more than two faces meet in an edge, it has the normals of all of them.
// `model` must be welded. Errors: INVALID_ARGUMENT for more than `max_lines` lines.
absl::StatusOr<std::vector<ModelLine>> CreaseLines(const RawMesh& model, double crease_angle_deg, size_t max_lines);

// The line elements with the normals of the faces that they lie on or border on: along an edge both faces' (one, where
// they are parallel), on a face its own, none when the line lies on nothing. `faces` is the hierarchy of the same
// model.
std::vector<ModelLine> PaintedLines(const RawMesh& model, const TriangleBvh& faces, double diameter_m);

}  // namespace evpose

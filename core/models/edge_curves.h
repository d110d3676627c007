// SPDX-License-Identifier: Apache-2.0

// The straight and the curved edges of a model (core/models/README.md, section 1).
#pragma once

#include <string>
#include <vector>

#include "core/mesh/surface_regions.h"
#include "core/models/object_model.h"

namespace evpose {

// Appends the edges of the surface to `model.lines` and `model.curves`. `edges.surface` may be empty, as for a mesh
// whose facets are the surface: all edges are then lines.
void AddSurfaceEdges(const RawMesh& mesh, const SurfaceEdges& edges, ObjectModel& model);

// Appends the line elements of the mesh. With `has_curves` false, all are lines.
void AddPaintedEdges(const RawMesh& mesh, bool has_curves, ObjectModel& model);

}  // namespace evpose

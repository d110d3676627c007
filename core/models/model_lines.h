// SPDX-License-Identifier: Apache-2.0

// The lines of a model, from the edges of its mesh or from its line elements (core/models/README.md, section 1).
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/types/span.h"
#include "core/mesh/surface_regions.h"
#include "core/mesh/triangle_bvh.h"
#include "core/models/object_model.h"

namespace evpose {

// Edges of the surface as lines, with the normals of all their faces. Collinear edges that continue each other are
// joined. The points of `mesh` must be merged (MergePoints()).
std::vector<ModelLine> StraightLines(const RawMesh& mesh, absl::Span<const MeshEdge> edges);

// The line elements with the normals of the faces on which they lie: the normals of both faces along an edge (one if
// these are parallel), that of the face inside a face, none away from all faces. `faces` is the search tree of the same
// mesh, `diameter_m` the diameter of the model. After `max_faces` faces near lines, which take some seconds, the rest
// of the lines get none, and `notices` say so.
std::vector<ModelLine> PaintedLines(const RawMesh& mesh, const TriangleBvh& faces, double diameter_m,
                                    std::vector<std::string>& notices, int64_t max_faces = 20'000'000);

}  // namespace evpose

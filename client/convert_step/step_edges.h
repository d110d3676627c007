// SPDX-License-Identifier: Apache-2.0

// The edges between the faces of a triangulated CAD model.
#pragma once

#include <TopTools_DataMapOfShapeInteger.hxx>
#include <TopoDS_Shape.hxx>

#include "core/mesh/types/raw_mesh.h"

namespace evpose::client {

// Appends the edges of a shape to `mesh.exact_edges`, and points between those of the triangulation to `mesh.points`,
// so that segments of curves other than lines and circles are within `deflection` of them. `first_points` has for each
// face of the shape the index of the first point of its triangulation in `mesh`. `scale` is metres per unit of the
// shape; `deflection` is in its unit. The two ends of a closed surface, as of a cylinder, are no edge.
void AppendEdges(const TopoDS_Shape& shape, const TopTools_DataMapOfShapeInteger& first_points, double scale,
                 double deflection, RawMesh& mesh);

}  // namespace evpose::client

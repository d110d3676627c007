// SPDX-License-Identifier: Apache-2.0

// The shape in a STEP or IGES file, and the joining of its faces.
#pragma once

#include <TopTools_IndexedDataMapOfShapeListOfShape.hxx>
#include <TopoDS_Edge.hxx>
#include <TopoDS_Shape.hxx>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace evpose::client {

// Returns the shape of a file, in millimetres. Adds a notice for everything that is missing in it, and if the file
// states no unit. Errors: those of CheckIsFile(); INVALID_ARGUMENT for a file that cannot be read or has no shape.
absl::StatusOr<TopoDS_Shape> ReadShape(const std::string& path, std::vector<std::string>& notices);

// The faces at each edge of a shape.
TopTools_IndexedDataMapOfShapeListOfShape FacesOfEdges(const TopoDS_Shape& shape);
// Whether an edge joins two ends of a closed face, such as that of a cylinder. `faces` are those at the edge.
bool IsSeam(const TopoDS_Edge& edge, const TopTools_ListOfShape& faces);

// Joins the faces of surfaces that are not closed, such as those of an IGES file of trimmed surfaces, at edges that are
// within `tolerance` (in the unit of the shape) of each other. Closed shells stay as they are. Adds a notice if faces
// were joined.
TopoDS_Shape JoinFaces(const TopoDS_Shape& shape, double tolerance, std::vector<std::string>& notices);

}  // namespace evpose::client

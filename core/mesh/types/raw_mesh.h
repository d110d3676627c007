// SPDX-License-Identifier: Apache-2.0

// The mesh of a model file as its reader returns it, and the limits on its size.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "core/mesh/types/smooth_surface.h"

namespace evpose {

// The circle of an edge.
struct EdgeCircle {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Eigen::Vector3d axis = Eigen::Vector3d::Zero();  // unit, either sign
  double radius_m = 0.0;
};

// An edge between faces of a CAD model.
struct ExactEdge {
  enum class Shape : uint8_t { kLine, kCircle, kFree };
  Shape shape = Shape::kFree;
  bool is_smooth = false;  // the faces continue each other: nothing is seen of the edge
  EdgeCircle circle;       // the circle of a kCircle
  // Indices of points along the edge, at least two; the first one again at the end of a ring. Between those that are
  // vertices of triangles may be others, which only lie on the edge.
  std::vector<uint32_t> points;
};

struct RawMesh {
  // Readers return coordinates in the unit of the file, rounded to single precision, which is that of a binary STL.
  std::vector<Eigen::Vector3d> points;
  std::vector<std::array<uint32_t, 3>> triangles;  // indices of points
  std::vector<std::array<uint32_t, 2>> lines;      // indices of points
  // True: `lines`, if there are any, are all lines of the object, as the line elements of an OBJ are. False: they are
  // drawn on the surface beside the edges at which it turns or ends.
  bool lines_are_all = true;
  // The normals that the file states for the corners of the triangles, unit; zero for a corner without one. Empty if
  // the file states none.
  std::vector<std::array<Eigen::Vector3f, 3>> corner_normals;
  // The faces of the CAD model of which the mesh was made: exact normals and shapes. Empty if they are unknown.
  SmoothSurface exact_surface;
  // The edges between these faces, as far as they are known. Empty without `exact_surface`.
  std::vector<ExactEdge> exact_edges;
  // Sides of triangles across which other triangles continue the plane, in the face of another body: no edges. Lower
  // index first, sorted. RepairMesh() finds them.
  std::vector<std::array<uint32_t, 2>> covered_edges;
  // Polygons of which AppendPolygon() omitted parts.
  size_t cut_polygons = 0;
  // Notices for the user about parts of the file that are not used.
  std::vector<std::string> notices;
};

struct MeshLimits {
  // A polygon counts as the triangles into which it is cut, and a line element as a triangle.
  size_t max_triangles = 0;
};

// Counts the elements of a file while it is read, so that a file beyond the limits takes no further memory.
// Errors: INVALID_ARGUMENT, without the place in the file.
class ElementCounter {
 public:
  explicit ElementCounter(const MeshLimits& limits) : limits_(limits) {}

  // A face needs 1 to 512 corners.
  absl::Status AddFace(size_t corners);
  absl::Status AddLines(size_t count);

 private:
  absl::Status Add(size_t count);

  MeshLimits limits_;
  size_t elements_ = 0;
};

// Cuts a polygon of at least one corner, which are indices of `mesh.points`, into triangles with the winding of the
// polygon and appends them (core/mesh/README.md, section 2). One or two corners, which exporters write for points and
// lines, become a triangle without area. The polygon may be concave and should be nearly flat.
// Parts of a polygon that crosses itself may be omitted; it is then counted in `mesh.cut_polygons`. `normals` has the
// unit normal of each corner and is appended to `mesh.corner_normals`; it is empty for all polygons of a mesh or for
// none.
void AppendPolygon(absl::Span<const uint32_t> corners, RawMesh& mesh, absl::Span<const Eigen::Vector3f> normals = {});

// Moves `mesh.notices`, and one about `mesh.cut_polygons` if there are any, to the end of `notices`.
void TakeNotices(RawMesh& mesh, std::vector<std::string>& notices);

// The normal that a file states, as a unit vector; zero, which means none, unless its length is positive and finite:
// exporters write NaN or zeros for faces without area.
Eigen::Vector3f StatedNormal(const Eigen::Vector3d& vector);

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// Object models: the lines of an object, which produce events, and its surface, which hides lines
// (core/models/README.md).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/types/span.h"
#include "core/geometry/rigid_transform.h"
#include "core/mesh/types/edge_curve.h"
#include "core/mesh/types/raw_mesh.h"
#include "core/mesh/types/smooth_surface.h"
#include "core/models/search_views.h"

namespace evpose {

// kMesh is a message of the API, which ParseObjectModel() does not read (server/models/mesh_message.h).
enum class ModelFormat { kObj, kPly, kStl, kMesh };

struct ModelLine {
  Eigen::Vector3d p1;  // object frame, metres
  Eigen::Vector3d p2;
  // Outward unit normals of the adjacent faces, distinct: none for a wire, 1 for a boundary or a line drawn on a face,
  // 2 for a crease, more where more faces meet in one edge.
  std::vector<Eigen::Vector3d> face_normals;
  EdgeKind kind = EdgeKind::kCrease;
};

// A continuous group of motions that map the object onto itself.
struct ContinuousSymmetry {
  enum class Kind : uint8_t { kAxis, kSphere };
  Kind kind = Kind::kAxis;
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  // object frame, metres; a point of the axis, or the centre
  Eigen::Vector3d axis = Eigen::Vector3d::Zero();    // unit; zero for a sphere
  // The half turns about the axes through the centre that are perpendicular to `axis` map the object onto itself, too.
  bool is_flippable = false;
};

struct ObjectModel {
  std::vector<Eigen::Vector3d> vertices;           // object frame, metres
  std::vector<std::array<uint32_t, 3>> triangles;  // counter-clockwise seen from outside
  std::vector<ModelLine> lines;                    // straight edges
  std::vector<EdgeCurve> curves;                   // curved edges
  SmoothSurface surface;                           // surface of `triangles`; empty if no region is curved
  // The edges between two facets that are no lines and at which the surface turns outward, of a model whose facets are
  // those of the object; else empty. Where one of the facets faces the camera, the edge is an occluding contour. Side s
  // of triangle t, from its corner s to the next one, has the number 3 t + s; each edge is given by both of its sides.
  std::vector<std::array<uint32_t, 2>> facet_edges;
  double diameter_m = 0.0;  // largest distance between two points of the model
  // object_from_object motions that map the object onto itself (symmetry.h), the identity first. Empty means the
  // identity alone.
  std::vector<RigidTransform> symmetries;
  // If it is set, `symmetries` is empty.
  std::optional<ContinuousSymmetry> continuous_symmetry;
  std::vector<std::string> notices;  // elements merged, dropped or turned while loading, for the user
  // The views that MakeSearchViews() has computed for this model; null: each search computes those that it needs.
  std::shared_ptr<const SearchViews> views;
};

struct ModelOptions {
  double metres_per_unit = 1.0;  // scale of the file's numbers; 0.001 for millimetres
  // The surface has an edge where it turns by more, beyond what its curvature explains (core/mesh/README.md). A
  // cylinder of 16 sides turns by 22.5 at each edge and is round; the creases of machined parts turn by 45 or 90.
  // Validated by surface_regions_test, which has a cylinder of 16 sides (a lower bound) and chamfers of 45 degrees (an
  // upper bound), and by tests/bench/models/compare_tessellations.py, which compares the edges of 29 shapes at three
  // tessellations.
  // Where the file states normals or faces, their jump counts instead, from 10 degrees on (core/mesh/README.md, 8).
  double crease_angle_deg = 30.0;
  // Facets of curved regions approximate a smooth surface, as those of an exported CAD model do. False: the object has
  // these facets itself, as in a recording that was rendered from the mesh. Each edge of the mesh at which the surface
  // turns by more than the crease angle is then an edge, and the others are contours where one of their facets faces
  // the camera.
  bool is_smooth = true;
  size_t max_bytes = 64u << 20;  // larger files are refused: bounds the memory for uploads
  // Largest number of triangles and line elements together. It bounds the memory: the search tree takes some 150 bytes
  // for each.
  size_t max_triangles = 2'000'000;

  absl::Status Validate() const;
  // INVALID_ARGUMENT for a file that is empty or larger than `max_bytes`.
  absl::Status CheckSize(size_t file_bytes) const;
};

// The elements of an OBJ, PLY or STL file in its order and unit. Errors: those of the readers (model_readers.h).
absl::StatusOr<RawMesh> ReadMesh(absl::Span<const uint8_t> bytes, ModelFormat format, const ModelOptions& options);

// Reads a model file (formats: core/mesh/README.md, section 1). If an OBJ has line elements (`l`), they are the edges
// of the model; else its edges are the creases and boundaries of the surface. Straight ones become lines, collinear
// ones joined, others curves. The surface has contours besides where it is curved. Lines of length zero and duplicates
// are dropped and overlapping lines merged, with a notice. Triangles get one winding, outward where a surface is
// closed. Symmetries are found by FindSymmetries(). No other file is opened, even if the file names one. Errors,
// INVALID_ARGUMENT: malformed (with the place), no line and no face, neither an edge nor a curved surface, a number
// that is not finite, an index out of range, a size below 1e-6 m or above 1e4 m, more than the options allow. `on_step`
// is called before each step with its name, such as "finding lines".
using ModelStepListener = absl::FunctionRef<void(absl::string_view step)>;
absl::StatusOr<ObjectModel> ParseObjectModel(
    absl::Span<const uint8_t> bytes, ModelFormat format, const ModelOptions& options,
    ModelStepListener on_step = [](absl::string_view) {});
// Does so for a mesh in the unit of `options.metres_per_unit`.
absl::StatusOr<ObjectModel> BuildObjectModel(
    RawMesh mesh, const ModelOptions& options, ModelStepListener on_step = [](absl::string_view) {});
// The same for a file, whose format its extension determines. Errors name the path: those of ReadFile(),
// INVALID_ARGUMENT (also for an unknown extension).
absl::StatusOr<ObjectModel> LoadObjectModel(const std::string& path, const ModelOptions& options = {});
absl::StatusOr<ModelFormat> ModelFormatFromPath(const std::string& path);

// Writes OBJ text with `v`, `f` and `l` statements, where a curve is one `l` of all its points. Reading it back gives
// the same model up to single precision; its curves are then painted ones.
std::string ObjectModelToObj(const ObjectModel& model);

}  // namespace evpose

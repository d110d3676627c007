// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/objects.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <utility>

#include "core/models/symmetry.h"
#include "core/numerics/random.h"
#include "core/simulation/random_rotation.h"

namespace evpose {
namespace {

using Eigen::Vector3d;

// Reflectances of the faces towards -x, +x, -y, +y, -z, +z. Neighbours differ by a factor of 1.7 or more, about two
// contrast thresholds, and opposite faces differ too.
using BoxShades = std::array<double, 6>;
constexpr BoxShades kBoxShades = {0.25, 0.28, 0.48, 0.53, 0.95, 0.90};

// A rectangle on a surface; coordinates are shares of the surface's sides, in [0, 1].
struct Patch {
  double u0, v0, u1, v1;
};

class ObjectBuilder {
 public:
  int AddBody(const Vector3d& separator_normal, double separator_offset_m) {
    object_.bodies.push_back({{}, separator_normal, separator_offset_m});
    return static_cast<int>(object_.bodies.size()) - 1;
  }

  // A rectangle from `corner` along `u` and `v`; its outward normal is u x v. Returns the index of its surface.
  int AddRectangle(int body, const Vector3d& corner, const Vector3d& u, const Vector3d& v, double reflectance) {
    Surface surface;
    surface.outline = {corner, corner + u, corner + u + v, corner + v};
    surface.normal = u.cross(v).normalized();
    surface.reflectance = reflectance;
    const std::array<uint32_t, 4> i = {AddVertex(surface.outline[0]), AddVertex(surface.outline[1]),
                                       AddVertex(surface.outline[2]), AddVertex(surface.outline[3])};
    object_.model.triangles.push_back({i[0], i[1], i[2]});
    object_.model.triangles.push_back({i[0], i[2], i[3]});
    object_.bodies[body].surfaces.push_back(std::move(surface));
    return static_cast<int>(object_.bodies[body].surfaces.size()) - 1;
  }

  // Adds six faces, in the order of BoxShades, without lines.
  void AddBoxFaces(int body, const Vector3d& centre, const Vector3d& size, const BoxShades& shades) {
    for (int axis = 0; axis < 3; ++axis) {
      for (int side = 0; side < 2; ++side) {
        const Vector3d normal = Vector3d::Unit(axis) * (side == 0 ? -1.0 : 1.0);
        // u x v points along +axis, and v x u along -axis.
        Vector3d u = Vector3d::Unit((axis + 1) % 3).cwiseProduct(size);
        Vector3d v = Vector3d::Unit((axis + 2) % 3).cwiseProduct(size);
        const Vector3d corner = centre + 0.5 * normal.cwiseProduct(size) - 0.5 * (u + v);
        if (side == 0) std::swap(u, v);
        AddRectangle(body, corner, u, v, shades[2 * axis + side]);
      }
    }
  }

  // Adds the twelve edges as lines, except those in the plane of the face `without_face` (index as in BoxShades; -1:
  // adds all twelve).
  void AddBoxLines(const Vector3d& centre, const Vector3d& size, int without_face = -1) {
    for (int axis = 0; axis < 3; ++axis) {
      for (int corner = 0; corner < 4; ++corner) {
        const int b = (axis + 1) % 3;
        const int c = (axis + 2) % 3;
        const Vector3d normal_b = Vector3d::Unit(b) * ((corner & 1) != 0 ? 1.0 : -1.0);
        const Vector3d normal_c = Vector3d::Unit(c) * ((corner & 2) != 0 ? 1.0 : -1.0);
        const int face_b = 2 * b + (corner & 1);
        const int face_c = 2 * c + (corner >> 1);
        if (face_b == without_face || face_c == without_face) continue;
        const Vector3d middle = centre + 0.5 * (normal_b + normal_c).cwiseProduct(size);
        const Vector3d half = 0.5 * Vector3d::Unit(axis).cwiseProduct(size);
        AddLine(middle - half, middle + half, {normal_b, normal_c});
      }
    }
  }

  Vector3d PointOn(int body, int surface, double u, double v) const {
    const std::vector<Vector3d>& o = object_.bodies[body].surfaces[surface].outline;
    return o[0] + u * (o[1] - o[0]) + v * (o[3] - o[0]);
  }

  // Adds paint; returns its outline.
  const std::vector<Vector3d>& AddPaint(int body, int surface, const Patch& patch, double reflectance, double under) {
    std::vector<Paint>& paints = object_.bodies[body].surfaces[surface].paints;
    paints.push_back({{PointOn(body, surface, patch.u0, patch.v0), PointOn(body, surface, patch.u1, patch.v0),
                       PointOn(body, surface, patch.u1, patch.v1), PointOn(body, surface, patch.u0, patch.v1)},
                      reflectance,
                      under});
    return paints.back().outline;
  }

  void AddPaintedLine(int body, int surface, double u0, double v0, double u1, double v1) {
    AddLine(PointOn(body, surface, u0, v0), PointOn(body, surface, u1, v1),
            {object_.bodies[body].surfaces[surface].normal});
  }

  // Adds paint, and its four sides as lines.
  void AddPaintWithLines(int body, int surface, const Patch& patch, double reflectance, double under) {
    AddSides(AddPaint(body, surface, patch, reflectance, under), {object_.bodies[body].surfaces[surface].normal});
  }

  // Adds a plate without thickness: two surfaces back to back. Returns the index of the front surface, with normal u x
  // v.
  int AddPlate(int body, const Vector3d& corner, const Vector3d& u, const Vector3d& v, double front, double back) {
    const int surface = AddRectangle(body, corner, u, v, front);
    AddRectangle(body, corner, v, u, back);
    return surface;
  }

  // Adds the four sides of a plate as lines; they are the boundary of both its surfaces.
  void AddPlateLines(int body, int front) {
    const Surface& surface = object_.bodies[body].surfaces[front];
    AddSides(surface.outline, {surface.normal, -surface.normal});
  }

  void AddSides(const std::vector<Vector3d>& outline, const std::vector<Vector3d>& normals) {
    for (size_t i = 0; i < outline.size(); ++i) AddLine(outline[i], outline[(i + 1) % outline.size()], normals);
  }

  void AddLine(const Vector3d& p1, const Vector3d& p2, std::vector<Vector3d> normals) {
    object_.model.lines.push_back({p1, p2, std::move(normals)});
  }

  SceneObject Finish(const Eigen::Matrix3d& view_from_object) {
    for (const Vector3d& a : object_.model.vertices) {
      object_.radius_m = std::max(object_.radius_m, a.norm());
      for (const Vector3d& b : object_.model.vertices) {
        object_.model.diameter_m = std::max(object_.model.diameter_m, (a - b).norm());
      }
    }
    object_.extremes = object_.model.vertices;
    object_.model.symmetries = FindSymmetries(object_.model);
    object_.view_from_object = view_from_object;
    return std::move(object_);
  }

 private:
  // A corner shared by faces is one vertex of the mesh, so that an edge of the mesh has two faces.
  uint32_t AddVertex(const Vector3d& point) {
    std::vector<Vector3d>& vertices = object_.model.vertices;
    const auto near = [&](const Vector3d& other) { return (other - point).norm() < 1e-9; };  // metres; rounding
    const auto found = std::find_if(vertices.begin(), vertices.end(), near);
    if (found != vertices.end()) return static_cast<uint32_t>(found - vertices.begin());
    vertices.push_back(point);
    return static_cast<uint32_t>(vertices.size()) - 1;
  }

  SceneObject object_;
};

// Returns the rotation by `pitch_rad` about x after `yaw_rad` about y: an attitude that shows front, side and top.
Eigen::Matrix3d View(double pitch_rad, double yaw_rad) {
  return ExpSo3({pitch_rad, 0.0, 0.0}) * ExpSo3({0.0, yaw_rad, 0.0});
}

SceneObject MakeBox(const Vector3d& size) {
  ObjectBuilder builder;
  const int body = builder.AddBody(Vector3d::UnitZ(), 0.0);
  builder.AddBoxFaces(body, Vector3d::Zero(), size, kBoxShades);
  builder.AddBoxLines(Vector3d::Zero(), size);
  return builder.Finish(View(0.6, 0.7));
}

// A plate with six lines, the number on the paper's planar target: its border and two painted steps.
SceneObject MakePlanar(double size) {
  ObjectBuilder builder;
  const int body = builder.AddBody(Vector3d::UnitZ(), 0.0);
  const Vector3d side_u(0.0, 0.8 * size, 0.0);
  const Vector3d side_v(size, 0.0, 0.0);
  const Vector3d corner = -0.5 * (side_u + side_v);
  const int front = builder.AddPlate(body, corner, side_u, side_v, 0.85, 0.5);  // front towards -z, the camera
  builder.AddPlateLines(body, front);
  // u is along y, v along x. A dark area on one side and a grey one across the bright rest, so that there is no
  // symmetry.
  constexpr double kStepAcross = 0.35;
  constexpr double kStepAlong = 0.6;
  builder.AddPaint(body, front, {0.0, 0.0, 1.0, kStepAcross}, 0.22, 0.85);
  builder.AddPaint(body, front, {kStepAlong, kStepAcross, 1.0, 1.0}, 0.42, 0.85);
  builder.AddPaintedLine(body, front, 0.0, kStepAcross, 1.0, kStepAcross);
  builder.AddPaintedLine(body, front, kStepAlong, kStepAcross, kStepAlong, 1.0);
  return builder.Finish(View(0.35, 0.35));
}

SceneObject MakeBook(double size) {
  ObjectBuilder builder;
  const int body = builder.AddBody(Vector3d::UnitZ(), 0.0);
  const Vector3d extent(0.7 * size, size, 0.1 * size);
  constexpr double kCover = 0.28;  // a factor of 3 below the pages (0.8 to 0.9)
  // The pages are bright and the spine is grey, because edges between faces of equal shade would be invisible.
  builder.AddBoxFaces(body, Vector3d::Zero(), extent, {0.50, 0.9, 0.8, 0.85, kCover, 0.5});
  builder.AddBoxLines(Vector3d::Zero(), extent);
  // Rectangles as shares of the cover's sides, their paint, and the paint beneath. Parallel lines are at least 0.08 of
  // a side apart, about 20 px at 1 m, so that their events are not confused; neighbouring paints differ by a factor
  // of 2.5 or more.
  constexpr int kFront = 4;                                                         // towards -z; u along y, v along x
  builder.AddPaintWithLines(body, kFront, {0.08, 0.12, 0.26, 0.88}, 0.85, kCover);  // title
  builder.AddPaintWithLines(body, kFront, {0.40, 0.20, 0.78, 0.80}, 0.70, kCover);  // picture
  builder.AddPaintWithLines(body, kFront, {0.48, 0.32, 0.66, 0.60}, 0.17, 0.70);    // in the picture
  // A rule, about 2 px wide at 1 m: two edges; the line is the centre between them (core/estimation/README.md, section
  // 3).
  constexpr double kRuleU = 0.89;
  constexpr double kRuleHalfWidth = 0.005;
  builder.AddPaint(body, kFront, {kRuleU - kRuleHalfWidth, 0.12, kRuleU + kRuleHalfWidth, 0.88}, 0.9, kCover);
  builder.AddPaintedLine(body, kFront, kRuleU, 0.12, kRuleU, 0.88);
  return builder.Finish(View(0.35, 0.4));
}

// A panel of 2 x 4 cells, front towards -z. The cells' shades alternate, so that each border between cells is a step.
void AddPanel(ObjectBuilder& builder, int body, const Vector3d& corner, const Vector3d& u, const Vector3d& v) {
  // Two contrast thresholds apart, as the faces of a box.
  constexpr double kDarkCell = 0.22;
  constexpr double kBrightCell = 0.45;
  constexpr int kRows = 2;
  constexpr int kColumns = 4;
  const int front = builder.AddPlate(body, corner, u, v, kDarkCell, 0.7);
  builder.AddPlateLines(body, front);
  for (int row = 0; row < kRows; ++row) {
    for (int column = row % 2; column < kColumns; column += 2) {
      const Patch cell = {1.0 * row / kRows, 1.0 * column / kColumns, 1.0 * (row + 1) / kRows,
                          1.0 * (column + 1) / kColumns};
      builder.AddPaint(body, front, cell, kBrightCell, kDarkCell);
    }
  }
  for (int row = 1; row < kRows; ++row) builder.AddPaintedLine(body, front, 1.0 * row / kRows, 0, 1.0 * row / kRows, 1);
  for (int column = 1; column < kColumns; ++column) {
    builder.AddPaintedLine(body, front, 0, 1.0 * column / kColumns, 1, 1.0 * column / kColumns);
  }
}

SceneObject MakeSpacecraft(double size) {
  ObjectBuilder builder;
  const Vector3d bus(0.26 * size, 0.26 * size, 0.32 * size);
  const double panel_inner = 0.19 * size;  // distance of a panel's inner side from the centre
  const double strut_inner = 0.5 * bus.x();
  const Vector3d panel_u(0.0, 0.26 * size, 0.0);
  const Vector3d panel_v((0.5 - 0.19) * size, 0.0, 0.0);
  const Vector3d strut_u(0.0, 0.04 * size, 0.0);
  const Vector3d strut_v(panel_inner - strut_inner, 0.0, 0.0);
  // Bodies from the tips inwards, so that one plane separates each body from all later ones.
  for (const double side : {-1.0, 1.0}) {
    const int panel = builder.AddBody(side * Vector3d::UnitX(), panel_inner);
    const double left_x = side < 0.0 ? -0.5 * size : panel_inner;
    AddPanel(builder, panel, {left_x, -0.5 * panel_u.y(), 0.0}, panel_u, panel_v);
  }
  for (const double side : {-1.0, 1.0}) {
    const int strut = builder.AddBody(side * Vector3d::UnitX(), strut_inner);
    const Vector3d corner(side < 0.0 ? -panel_inner : strut_inner, -0.5 * strut_u.y(), 0.0);
    builder.AddPlate(strut, corner, strut_u, strut_v, 0.8, 0.8);
    const Vector3d normal = Vector3d::UnitZ();
    builder.AddLine(corner, corner + strut_v, {normal, -normal});
    builder.AddLine(corner + strut_u, corner + strut_u + strut_v, {normal, -normal});
  }
  const Vector3d mast(0.05 * size, 0.16 * size, 0.05 * size);
  const Vector3d mast_centre(0.06 * size, -0.5 * (bus.y() + mast.y()), -0.08 * size);  // on top, because y points down
  const int mast_body = builder.AddBody(-Vector3d::UnitY(), 0.5 * bus.y());
  builder.AddBoxFaces(mast_body, mast_centre, mast, {0.3, 0.3, 0.9, 0.9, 0.6, 0.6});
  builder.AddBoxLines(mast_centre, mast, /*without_face=*/3);
  const int bus_body = builder.AddBody(Vector3d::UnitZ(), 0.0);
  builder.AddBoxFaces(bus_body, Vector3d::Zero(), bus, kBoxShades);
  builder.AddBoxLines(Vector3d::Zero(), bus);
  return builder.Finish(View(0.45, 0.35));
}

}  // namespace

SceneObject MakeSceneObject(SimulatedObject object, double size_m) {
  switch (object) {
    case SimulatedObject::kCube:
      return MakeBox(Vector3d::Constant(size_m));
    case SimulatedObject::kCuboid:
      return MakeBox(Vector3d(1.0, 0.7, 0.45) * size_m);
    case SimulatedObject::kPlanar:
      return MakePlanar(size_m);
    case SimulatedObject::kBook:
      return MakeBook(size_m);
    case SimulatedObject::kSpacecraft:
      return MakeSpacecraft(size_m);
  }
  return {};
}

SceneObject MakeModelObject(const ObjectModel& model, uint64_t seed) {
  SceneObject object;
  Eigen::AlignedBox3d box;
  for (const Vector3d& vertex : model.vertices) box.extend(vertex);
  for (int i = 0; i < 8; ++i) object.extremes.push_back(box.corner(static_cast<Eigen::AlignedBox3d::CornerType>(i)));
  object.centre_m = box.center();
  for (const Vector3d& vertex : model.vertices) {
    object.radius_m = std::max(object.radius_m, (vertex - object.centre_m).norm());
  }
  Random random(seed);
  object.view_from_object = DrawRotation(random);
  return object;
}

std::vector<int> PaintersOrder(const std::vector<Body>& bodies, const Vector3d& camera_object) {
  std::vector<int> order;
  std::vector<int> nearer;  // bodies that are nearer than all later bodies; the outermost comes last
  for (size_t i = 0; i < bodies.size(); ++i) {
    const bool camera_on_its_side = bodies[i].separator_normal.dot(camera_object) > bodies[i].separator_offset_m;
    const bool is_last = i + 1 == bodies.size();
    if (camera_on_its_side && !is_last) {
      nearer.push_back(static_cast<int>(i));
    } else {
      order.push_back(static_cast<int>(i));
    }
  }
  order.insert(order.end(), nearer.rbegin(), nearer.rend());
  return order;
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// Surfaces of revolution for tests, tessellated, with the exact normals of the surface.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <functional>
#include <vector>

#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose::lathe {

// Part of a profile between two points (radius, height), with the normals (radial, axial) of the surface at both.
struct LathePiece {
  Eigen::Vector2d a, b;
  Eigen::Vector2d normal_a, normal_b;
};

inline LathePiece StraightPiece(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  const Eigen::Vector2d along = (b - a).normalized();
  const Eigen::Vector2d normal(along.y(), -along.x());  // outward for a profile that goes up on the outside
  return {a, b, normal, normal};
}

// Appends the arc about a centre from one angle to another, measured from the radial direction.
inline void AppendArc(const Eigen::Vector2d& centre, double radius, double from_rad, double to_rad, int pieces,
                      std::vector<LathePiece>& profile) {
  for (int i = 0; i < pieces; ++i) {
    const double t0 = from_rad + (to_rad - from_rad) * i / pieces,
                 t1 = from_rad + (to_rad - from_rad) * (i + 1) / pieces;
    const Eigen::Vector2d n0(std::cos(t0), std::sin(t0)), n1(std::cos(t1), std::sin(t1));
    profile.push_back({centre + radius * n0, centre + radius * n1, n0, n1});
  }
}

// Turns a profile about the z axis in `sides` steps. Points where the normals of two successive pieces differ become
// rings of curves. `radius`, unless null, returns the radius at an angle, height and radius; where it differs from the
// given one, the facets have no stated normals.
inline ObjectModel Lathe(const std::vector<LathePiece>& profile, int sides,
                         const std::function<double(double, double, double)>& radius = nullptr) {
  ObjectModel model;
  const auto point_at = [&](const Eigen::Vector2d& p, int side, bool& is_changed) {
    const double angle = 2.0 * M_PI * side / sides;
    const double r = radius != nullptr ? radius(angle, p.y(), p.x()) : p.x();
    is_changed |= r != p.x();
    return Eigen::Vector3d(r * std::cos(angle), r * std::sin(angle), p.y());
  };
  const auto normal_at = [&](const Eigen::Vector2d& n, int side) {
    const double angle = 2.0 * M_PI * side / sides;
    return Eigen::Vector3f(Eigen::Vector3d(n.x() * std::cos(angle), n.x() * std::sin(angle), n.y()).cast<float>());
  };
  const auto add_triangle = [&](const std::array<Eigen::Vector3d, 3>& points,
                                const std::array<Eigen::Vector3f, 3>& normals, bool is_changed) {
    if ((points[1] - points[0]).cross(points[2] - points[0]).norm() < 1e-12) return;
    const auto first = static_cast<uint32_t>(model.vertices.size());
    model.vertices.insert(model.vertices.end(), points.begin(), points.end());
    model.triangles.push_back({first, first + 1, first + 2});
    const Eigen::Vector3f none = Eigen::Vector3f::Zero();
    model.surface.normals.push_back(is_changed ? std::array{none, none, none} : normals);
    model.surface.region_of.push_back(0);
  };
  model.surface.regions.resize(1);
  for (size_t i = 0; i < profile.size(); ++i) {
    const LathePiece& piece = profile[i];
    for (const LathePiece& other : profile) {
      model.diameter_m =
          std::max(model.diameter_m, Eigen::Vector2d(piece.a.x() + other.a.x(), piece.a.y() - other.a.y()).norm());
    }
    for (int side = 0; side < sides; ++side) {
      bool is_changed = false;
      const Eigen::Vector3d a0 = point_at(piece.a, side, is_changed), a1 = point_at(piece.a, side + 1, is_changed);
      const Eigen::Vector3d b0 = point_at(piece.b, side, is_changed), b1 = point_at(piece.b, side + 1, is_changed);
      const Eigen::Vector3f na0 = normal_at(piece.normal_a, side), na1 = normal_at(piece.normal_a, side + 1);
      const Eigen::Vector3f nb0 = normal_at(piece.normal_b, side), nb1 = normal_at(piece.normal_b, side + 1);
      add_triangle({a0, a1, b1}, {na0, na1, nb1}, is_changed);
      add_triangle({a0, b1, b0}, {na0, nb1, nb0}, is_changed);
    }
    const LathePiece& next = profile[(i + 1) % profile.size()];
    const bool is_crease = (piece.b - next.a).norm() < 1e-9 && (piece.normal_b - next.normal_a).norm() > 0.1;
    if (!is_crease || piece.b.x() == 0.0) continue;
    EdgeCurve ring;
    bool is_changed = false;
    for (int side = 0; side <= sides; ++side) ring.points.push_back(point_at(piece.b, side % sides, is_changed));
    ring.face_normals.resize(ring.points.size() - 1);
    model.curves.push_back(ring);
  }
  return model;
}

inline ObjectModel Cylinder(int sides, double radius = 0.3, double height = 1.0) {
  const double h = 0.5 * height;
  return Lathe({StraightPiece({0, -h}, {radius, -h}), StraightPiece({radius, -h}, {radius, h}),
                StraightPiece({radius, h}, {0, h})},
               sides);
}

inline ObjectModel Cone(int sides) {
  return Lathe({StraightPiece({0, 0}, {0.4, 0}), StraightPiece({0.4, 0}, {0, 0.9})}, sides);
}

inline ObjectModel Capsule(int sides) {
  std::vector<LathePiece> profile;
  AppendArc({0, -0.4}, 0.25, -M_PI / 2, 0, sides / 4, profile);
  profile.push_back(StraightPiece({0.25, -0.4}, {0.25, 0.4}));
  AppendArc({0, 0.4}, 0.25, 0, M_PI / 2, sides / 4, profile);
  return Lathe(profile, sides);
}

inline ObjectModel Torus(int sides) {
  std::vector<LathePiece> profile;
  AppendArc({0.5, 0}, 0.15, 0, 2 * M_PI, sides / 2, profile);
  return Lathe(profile, sides);
}

inline ObjectModel Ball(int sides) {
  std::vector<LathePiece> profile;
  AppendArc({0, 0}, 0.5, -M_PI / 2, M_PI / 2, sides / 2, profile);
  return Lathe(profile, sides);
}

// Base, side, round shoulder, neck and mouth.
inline ObjectModel Bottle(int sides) {
  std::vector<LathePiece> profile = {StraightPiece({0, 0}, {0.3, 0}), StraightPiece({0.3, 0}, {0.3, 0.6})};
  AppendArc({0.15, 0.6}, 0.15, 0, M_PI / 2 - 0.4, sides / 6, profile);
  const Eigen::Vector2d shoulder = profile.back().b, neck(0.1, 0.85);
  profile.push_back(StraightPiece(shoulder, neck));
  profile.push_back(StraightPiece(neck, {0.1, 1.0}));
  profile.push_back(StraightPiece({0.1, 1.0}, {0, 1.0}));
  return Lathe(profile, sides);
}

inline void Move(const RigidTransform& motion, ObjectModel& model) {
  const Eigen::Matrix3f rotation = motion.rotation.cast<float>();
  for (Eigen::Vector3d& vertex : model.vertices) vertex = motion * vertex;
  for (EdgeCurve& curve : model.curves) {
    for (Eigen::Vector3d& point : curve.points) point = motion * point;
  }
  for (ModelLine& line : model.lines) {
    line.p1 = motion * line.p1;
    line.p2 = motion * line.p2;
  }
  for (auto& normals : model.surface.normals) {
    for (Eigen::Vector3f& normal : normals) normal = rotation * normal;
  }
}

}  // namespace evpose::lathe

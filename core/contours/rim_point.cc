// SPDX-License-Identifier: Apache-2.0
#include "core/contours/rim_point.h"

#include <algorithm>
#include <cmath>

#include "core/contours/edge_elements.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

// A contour that has to move farther than 60 degrees belongs to another place of the surface.
constexpr double kLeastCosine = 0.5;

struct Turn {
  bool exists = false;
  double cosine = 1.0;
  double sine = 0.0;
};

// The smallest angle t with a cos t + b sin t = c.
Turn SolveTurn(double a, double b, double c) {
  const double norm2 = a * a + b * b;
  const double rest2 = norm2 - c * c;
  if (!(rest2 >= 0.0) || !(norm2 > 0.0)) return {};
  const double rest = b < 0.0 ? -std::sqrt(rest2) : std::sqrt(rest2);
  const double cosine = (a * c + b * rest) / norm2;
  const double sine = (b * c - a * rest) / norm2;
  return {cosine >= kLeastCosine, cosine, sine};
}

// The radius of the normal section at an angle to the straight line of a cylinder or cone (Euler's theorem): the
// curvature is that across the line times the squared sine of the angle.
double RadiusAlong(const Eigen::Vector3d& ray, const Eigen::Vector3d& straight, double radius_across_m,
                   double max_radius_m) {
  const double sine2 = ray.normalized().cross(straight).squaredNorm();
  return radius_across_m < max_radius_m * sine2 ? radius_across_m / sine2 : max_radius_m;
}

RimPoint RimOfCylinder(const SurfaceRegion& cylinder, const Eigen::Vector3d& eye, const Eigen::Vector3d& surface_point,
                       const Eigen::Vector3d& normal, double max_radius_m) {
  const Eigen::Vector3d centre = surface_point - cylinder.radius_m * normal;
  const Eigen::Vector3d side = cylinder.axis.cross(normal);
  const Turn turn = SolveTurn(normal.dot(centre - eye), side.dot(centre - eye), -cylinder.radius_m);
  if (!turn.exists) return {};
  RimPoint rim;
  rim.normal = turn.cosine * normal + turn.sine * side;
  rim.point = centre + cylinder.radius_m * rim.normal;
  rim.radius_m = RadiusAlong(rim.point - eye, cylinder.axis, cylinder.radius_m, max_radius_m);
  return rim;
}

RimPoint RimOfCone(const SurfaceRegion& cone, const Eigen::Vector3d& eye, const Eigen::Vector3d& surface_point,
                   const Eigen::Vector3d& normal, double max_radius_m) {
  const auto [sine, cosine] = DeterministicSinCos(cone.half_angle_rad);
  const Eigen::Vector3d across = (normal - normal.dot(cone.axis) * cone.axis).normalized();
  const Eigen::Vector3d side = cone.axis.cross(across);
  const Eigen::Vector3d to_apex = cone.point - eye;
  const Turn turn = SolveTurn(cosine * across.dot(to_apex), cosine * side.dot(to_apex), sine * cone.axis.dot(to_apex));
  const double height_m = cone.axis.dot(surface_point - cone.point);
  if (!turn.exists || !(height_m > 0.0)) return {};
  const Eigen::Vector3d outward = turn.cosine * across + turn.sine * side;
  const Eigen::Vector3d straight = cosine * cone.axis + sine * outward;
  RimPoint rim;
  rim.normal = cosine * outward - sine * cone.axis;
  rim.point = cone.point + height_m / cosine * straight;
  rim.radius_m = RadiusAlong(rim.point - eye, straight, height_m * sine / (cosine * cosine), max_radius_m);
  return rim;
}

}  // namespace

bool MoveToRim(const Eigen::Vector3d& eye, double radius_m, Eigen::Vector3d& point, Eigen::Vector3d& normal) {
  const Eigen::Vector3d ray = point - eye;
  const double height_m = normal.dot(ray);
  const Eigen::Vector3d tangential = ray - height_m * normal;
  const double length_m = tangential.norm();
  if (!(length_m > 0.0)) return false;
  const Turn turn = SolveTurn(height_m - radius_m, length_m, -radius_m);
  if (!turn.exists) return false;
  const Eigen::Vector3d centre = point - radius_m * normal;
  normal = (turn.cosine * normal + turn.sine / length_m * tangential).normalized();
  point = centre + radius_m * normal;
  return true;
}

RimPoint RimOfShape(const SurfaceRegion& region, const Eigen::Vector3d& eye, const Eigen::Vector3d& surface_point,
                    const Eigen::Vector3d& normal, double max_radius_m) {
  if (region.shape == RegionShape::kCylinder) return RimOfCylinder(region, eye, surface_point, normal, max_radius_m);
  if (region.shape == RegionShape::kCone) return RimOfCone(region, eye, surface_point, normal, max_radius_m);
  RimPoint rim{surface_point, normal, std::min(region.radius_m, max_radius_m)};
  if (!MoveToRim(eye, region.radius_m, rim.point, rim.normal)) return {};
  return rim;
}

void SlideContour(const Eigen::Vector3d& eye, EdgeElement& element) {
  if (element.kind != EdgeKind::kContour) return;
  MoveToRim(eye, element.radius_m[0], element.p1, element.normals[0]);
  MoveToRim(eye, element.radius_m[1], element.p2, element.normals[1]);
}

}  // namespace evpose

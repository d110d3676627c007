// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/shape_fit.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "core/mesh/region_shapes.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

// Largest distance of a vertex from the shape. Relative to the diameter: 0.15 px at an object size of 300 px. Relative
// to the region: else a shape would fit any part that is small compared with the object.
constexpr double kMaxDistance = 5e-4;
constexpr double kMaxRelativeDistance = 5e-3;
// Largest distance of the middle of a facet from the shape, relative to the diameter of the model: a cylinder of twelve
// sides that is as wide as the object has 0.017. The chamfers of a cube have all vertices on a sphere and 0.06.
constexpr double kMaxFacetDistance = 0.02;
// Bounds the time of a fit; vertices of CAD models lie on their surfaces to single precision, so that more add nothing.
constexpr size_t kSampleTriangles = 128;
// Three strips of two triangles: any two strips lie on a cylinder.
constexpr size_t kMinTriangles = 6;
// A facet turns from the normals at its corners by less than these differ among each other, plus this (3 degrees),
// except for a share of the area that noisy slivers may have.
constexpr double kNormalSlack = 0.05;
constexpr double kMaxDifferentArea = 0.01;
// Gauss-Newton converges quadratically: from one degree and one percent of the size to rounding errors in four steps.
constexpr int kNewtonSteps = 5;
// Relative to the size of the region. Beyond it, the first estimate is too far from any shape that fits.
constexpr double kMaxFirstResidual = 0.05;
// Keeps the equations regular if the samples do not determine a parameter, relative to their trace.
constexpr double kDamping = 1e-13;
// The same for the steps of the refinement: one ring of vertices and an apex do not determine the tilt of a cone's
// axis, and rounding errors of single precision must not change it.
constexpr double kStepDamping = 1e-9;
// Distance from the axis relative to the radius. Nearer to the axis, as at the apex, the direction of the derivative is
// that of an error.
constexpr double kMinRelativeRadius = 0.02;
// A flatter or steeper cone is a cylinder or a plane.
constexpr double kMinConeSine = 1e-3, kMaxConeSine = 0.9999;

struct FacetMoments {
  double area_m2 = 0.0;
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();           // mean over the area
  Eigen::Matrix3d normal_products = Eigen::Matrix3d::Zero();  // mean of n n^T
  Eigen::AlignedBox3d box;
};

FacetMoments FacetMomentsOf(const RawMesh& mesh, absl::Span<const uint32_t> triangles) {
  FacetMoments moments;
  for (const uint32_t t : triangles) {
    const FacetGeometry facet = FacetOf(mesh, t);
    moments.area_m2 += facet.area_m2;
    moments.normal += facet.area_m2 * facet.normal;
    moments.normal_products += facet.area_m2 * facet.normal * facet.normal.transpose();
    for (const uint32_t vertex : mesh.triangles[t]) moments.box.extend(mesh.points[vertex]);
  }
  if (moments.area_m2 > 0.0) {
    moments.normal /= moments.area_m2;
    moments.normal_products /= moments.area_m2;
  }
  return moments;
}

// Vertices of up to kSampleTriangles triangles, at equal steps of the area, as (X - centre) / size.
struct SampledVertices {
  Eigen::Vector3d centre;
  double size_m;
  std::vector<Eigen::Vector3d> points;
};

SampledVertices TakeSamples(const RawMesh& mesh, absl::Span<const uint32_t> triangles, const FacetMoments& moments) {
  SampledVertices samples = {moments.box.center(), moments.box.diagonal().norm(), {}};
  const bool all = triangles.size() <= kSampleTriangles;
  const double step = moments.area_m2 / kSampleTriangles;
  double area = 0.0, next = 0.5 * step;
  for (const uint32_t t : triangles) {
    if (!all) {
      area += FacetOf(mesh, t).area_m2;
      if (area < next) continue;
      while (next <= area && samples.points.size() < 3 * kSampleTriangles) next += step;
      if (samples.points.size() >= 3 * kSampleTriangles) break;
    }
    for (const uint32_t vertex : mesh.triangles[t]) {
      samples.points.push_back((mesh.points[vertex] - samples.centre) / samples.size_m);
    }
  }
  return samples;
}

// --- Cylinder and cone: the distance from the axis is radius + tan(angle) h at the height h above `point`.

struct Revolution {
  Eigen::Vector3d point;
  Eigen::Vector3d axis;
  double radius = 0.0;
  double angle_rad = 0.0;  // half angle of a cone; 0 for a cylinder
};

enum class RevolutionKind : uint8_t { kCylinder, kCone };

// Eigenvector of the smallest eigenvalue.
Eigen::Vector3d LeastDirection(const Eigen::Matrix3d& matrix) {
  return Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(matrix).eigenvectors().col(0);
}

// core/mesh/README.md, equations (7) and (8).
std::optional<Revolution> FirstRevolution(const std::vector<Eigen::Vector3d>& points, const Eigen::Vector3d& axis,
                                          RevolutionKind kind) {
  const Eigen::Vector3d e1 = axis.unitOrthogonal(), e2 = axis.cross(e1);
  Eigen::Matrix4d a = Eigen::Matrix4d::Zero();
  Eigen::Vector4d b = Eigen::Vector4d::Zero();
  for (const Eigen::Vector3d& p : points) {
    const double x = p.dot(e1), y = p.dot(e2);
    const Eigen::Vector4d row(2.0 * x, 2.0 * y, 1.0, kind == RevolutionKind::kCone ? p.dot(axis) : 0.0);
    a += row * row.transpose();
    b += row * (x * x + y * y);
  }
  a.diagonal().array() += kDamping * a.trace();
  const Eigen::Vector4d solution = a.ldlt().solve(b);
  Revolution shape = {solution[0] * e1 + solution[1] * e2, axis};

  double sum_h = 0.0, sum_hh = 0.0, sum_r = 0.0, sum_hr = 0.0, sum_rr = 0.0;
  for (const Eigen::Vector3d& p : points) {
    const Eigen::Vector3d v = p - shape.point;
    const double h = v.dot(axis), r = (v - h * axis).norm();
    sum_h += h;
    sum_hh += h * h;
    sum_r += r;
    sum_hr += h * r;
    sum_rr += r * r;
  }
  const double n = static_cast<double>(points.size());
  const double variance_h = sum_hh - sum_h * sum_h / n, covariance = sum_hr - sum_h * sum_r / n;
  double slope = 0.0;
  if (kind == RevolutionKind::kCone && variance_h > 0.0) slope = covariance / variance_h;
  shape.radius = (sum_r - slope * sum_h) / n;
  shape.angle_rad = DeterministicAtan2(slope, 1.0);
  const double residual2 = (sum_rr - sum_r * sum_r / n - slope * covariance) / n;
  if (!(residual2 <= kMaxFirstResidual * kMaxFirstResidual)) return std::nullopt;
  return shape;
}

// One Gauss-Newton step on the distances (core/mesh/README.md, equations (9) and (10)).
void StepRevolution(const std::vector<Eigen::Vector3d>& points, RevolutionKind kind, Revolution& shape) {
  using Vector6d = Eigen::Matrix<double, 6, 1>;
  const Eigen::Vector3d e1 = shape.axis.unitOrthogonal(), e2 = shape.axis.cross(e1);
  const auto [s, c] = DeterministicSinCos(shape.angle_rad);
  Eigen::Matrix<double, 6, 6> a = Eigen::Matrix<double, 6, 6>::Zero();
  Vector6d b = Vector6d::Zero();
  for (const Eigen::Vector3d& p : points) {
    const Eigen::Vector3d v = p - shape.point;
    const double h = v.dot(shape.axis);
    const Eigen::Vector3d across = v - h * shape.axis;
    const double r = across.norm();
    const bool is_on_axis = !(r > kMinRelativeRadius * std::abs(shape.radius));
    const double u1 = is_on_axis ? 0.0 : across.dot(e1) / r, u2 = is_on_axis ? 0.0 : across.dot(e2) / r;
    const double lever = -(c * h + s * r);
    const double by_angle = kind == RevolutionKind::kCone ? -s * (r - shape.radius) - c * h : 0.0;
    const Vector6d row = (Vector6d() << lever * u1, lever * u2, -c * u1, -c * u2, -c, by_angle).finished();
    a += row * row.transpose();
    b -= row * (c * (r - shape.radius) - s * h);
  }
  a.diagonal().array() += kStepDamping * a.trace();
  const Vector6d x = a.ldlt().solve(b);
  shape.axis = (shape.axis + x[0] * e1 + x[1] * e2).normalized();
  shape.point += x[2] * e1 + x[3] * e2;
  shape.radius += x[4];
  shape.angle_rad += x[5];
}

std::optional<SurfaceRegion> FitCylinder(const SampledVertices& samples, const FacetMoments& moments) {
  // The normals lie on a great circle, whose pole is the axis.
  std::optional<Revolution> shape =
      FirstRevolution(samples.points, LeastDirection(moments.normal_products), RevolutionKind::kCylinder);
  if (!shape.has_value()) return std::nullopt;
  for (int i = 0; i < kNewtonSteps; ++i) StepRevolution(samples.points, RevolutionKind::kCylinder, *shape);
  SurfaceRegion region;
  region.shape = RegionShape::kCylinder;
  region.point = samples.centre + samples.size_m * shape->point;
  region.axis = shape->axis;
  region.radius_m = samples.size_m * shape->radius;
  return region;
}

std::optional<SurfaceRegion> FitCone(const SampledVertices& samples, const FacetMoments& moments) {
  // The normals lie on a circle; its plane need not contain the origin.
  const Eigen::Matrix3d centred = moments.normal_products - moments.normal * moments.normal.transpose();
  std::optional<Revolution> shape = FirstRevolution(samples.points, LeastDirection(centred), RevolutionKind::kCone);
  if (!shape.has_value()) return std::nullopt;
  for (int i = 0; i < kNewtonSteps; ++i) StepRevolution(samples.points, RevolutionKind::kCone, *shape);
  if (shape->angle_rad < 0.0) {
    shape->angle_rad = -shape->angle_rad;
    shape->axis = -shape->axis;
  }
  const auto [s, c] = DeterministicSinCos(shape->angle_rad);
  if (!(s >= kMinConeSine && s <= kMaxConeSine && c > 0.0)) return std::nullopt;
  SurfaceRegion region;
  region.shape = RegionShape::kCone;
  region.point = samples.centre + samples.size_m * (shape->point - shape->axis * (shape->radius * c / s));
  region.axis = shape->axis;
  region.half_angle_rad = shape->angle_rad;
  return region;
}

// --- Plane and sphere

std::optional<SurfaceRegion> FitPlane(const SampledVertices& samples, const FacetMoments& moments) {
  // The mean of unit normals that differ by less than the slack is nearly a unit vector.
  if (!(moments.normal.norm() >= 1.0 - kNormalSlack)) return std::nullopt;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& p : samples.points) mean += p;
  SurfaceRegion region;
  region.shape = RegionShape::kPlane;
  region.axis = moments.normal.normalized();
  region.point = samples.centre + mean * (samples.size_m / static_cast<double>(samples.points.size()));
  return region;
}

std::optional<SurfaceRegion> FitSphere(const SampledVertices& samples, const FacetMoments&) {
  // |X|^2 = 2 X . c + (r^2 - |c|^2), linear in c and the bracket, is the first estimate.
  Eigen::Matrix4d a = Eigen::Matrix4d::Zero();
  Eigen::Vector4d b = Eigen::Vector4d::Zero();
  for (const Eigen::Vector3d& p : samples.points) {
    const Eigen::Vector4d row(2.0 * p.x(), 2.0 * p.y(), 2.0 * p.z(), 1.0);
    a += row * row.transpose();
    b += row * p.squaredNorm();
  }
  a.diagonal().array() += kDamping * a.trace();
  const Eigen::Vector4d solution = a.ldlt().solve(b);
  Eigen::Vector3d centre = solution.head<3>();
  const double radius2 = solution[3] + centre.squaredNorm();
  if (!(radius2 > 0.0)) return std::nullopt;
  double radius = std::sqrt(radius2);
  for (int i = 0; i < kNewtonSteps; ++i) {
    a.setZero();
    b.setZero();
    for (const Eigen::Vector3d& p : samples.points) {
      const double distance = (p - centre).norm();
      if (!(distance > 0.0)) return std::nullopt;
      const Eigen::Vector3d u = (p - centre) / distance;
      const Eigen::Vector4d row(u.x(), u.y(), u.z(), 1.0);
      a += row * row.transpose();
      b += row * (distance - radius);
    }
    a.diagonal().array() += kDamping * a.trace();
    const Eigen::Vector4d x = a.ldlt().solve(b);
    centre += x.head<3>();
    radius += x[3];
  }
  SurfaceRegion region;
  region.shape = RegionShape::kSphere;
  region.point = samples.centre + samples.size_m * centre;
  region.radius_m = samples.size_m * radius;
  return region;
}

// --- Acceptance

bool VerticesLieOn(const RawMesh& mesh, absl::Span<const uint32_t> triangles, double tolerance_m,
                   const SurfaceRegion& region) {
  for (const uint32_t t : triangles) {
    for (const uint32_t vertex : mesh.triangles[t]) {
      const Eigen::Vector3d& p = mesh.points[vertex];
      // Written so that a fit that is not finite fails.
      if (!((ProjectToShape(region, p) - p).norm() <= tolerance_m)) return false;
    }
  }
  return true;
}

bool FacetAgrees(const RawMesh& mesh, uint32_t triangle, const FacetGeometry& facet, const SurfaceRegion& region) {
  std::array<Eigen::Vector3d, 3> normals;
  int count = 0;
  for (const uint32_t vertex : mesh.triangles[triangle]) {
    const Eigen::Vector3d normal = CornerNormal(region, mesh.points[vertex], facet);
    if (!normal.isZero()) normals[count++] = normal;
  }
  double spread = 0.0, difference = 0.0;
  for (int i = 0; i < count; ++i) {
    difference = std::max(difference, (facet.normal - normals[i]).norm());
    for (int j = 0; j < i; ++j) spread = std::max(spread, (normals[i] - normals[j]).norm());
  }
  return difference <= spread + kNormalSlack;
}

// Whether the facets are near to the shape and have its normals. Sets `is_convex`.
bool FacetsAgree(const RawMesh& mesh, absl::Span<const uint32_t> triangles, const FacetMoments& moments,
                 double diameter_m, SurfaceRegion& region) {
  double outward = 0.0, different = 0.0;
  for (const uint32_t t : triangles) {
    const FacetGeometry facet = FacetOf(mesh, t);
    outward += facet.area_m2 * facet.normal.dot(NormalOfShape(region, facet.centroid));
  }
  if (outward < 0.0) region.is_convex = !region.is_convex;
  for (const uint32_t t : triangles) {
    const FacetGeometry facet = FacetOf(mesh, t);
    const double distance_m = (ProjectToShape(region, facet.centroid) - facet.centroid).norm();
    if (!(distance_m <= kMaxFacetDistance * diameter_m)) return false;
    if (!FacetAgrees(mesh, t, facet, region)) different += facet.area_m2;
  }
  return different <= kMaxDifferentArea * moments.area_m2;
}

}  // namespace

FacetGeometry FacetOf(const RawMesh& mesh, uint32_t triangle) {
  const auto& [i, j, k] = mesh.triangles[triangle];
  const Eigen::Vector3d &a = mesh.points[i], &b = mesh.points[j], &c = mesh.points[k];
  const Eigen::Vector3d cross = (b - a).cross(c - a);
  const double length = cross.norm();
  return {(a + b + c) / 3.0, length > 0.0 ? Eigen::Vector3d(cross / length) : Eigen::Vector3d::Zero(), 0.5 * length};
}

Eigen::Vector3d CornerNormal(const SurfaceRegion& region, const Eigen::Vector3d& corner, const FacetGeometry& facet) {
  // Nearer to the apex, the direction from the axis may be that of an error.
  constexpr double kNearApex = 0.02;
  const bool is_apex = region.shape == RegionShape::kCone &&
                       (corner - region.point).norm() < kNearApex * (facet.centroid - region.point).norm();
  return NormalOfShape(region, is_apex ? facet.centroid : corner);
}

std::optional<SurfaceRegion> FitShape(const RawMesh& mesh, absl::Span<const uint32_t> triangles, ShapeChoice choice,
                                      double diameter_m) {
  const FacetMoments moments = FacetMomentsOf(mesh, triangles);
  if (!(moments.area_m2 > 0.0)) return std::nullopt;
  const SampledVertices samples = TakeSamples(mesh, triangles, moments);
  const double tolerance_m = std::min(kMaxDistance * diameter_m, kMaxRelativeDistance * samples.size_m);
  const auto accept = [&](std::optional<SurfaceRegion> region) -> std::optional<SurfaceRegion> {
    if (region.has_value() && VerticesLieOn(mesh, triangles, tolerance_m, *region) &&
        FacetsAgree(mesh, triangles, moments, diameter_m, *region)) {
      return region;
    }
    return std::nullopt;
  };
  if (choice == ShapeChoice::kAny) {
    if (const auto plane = accept(FitPlane(samples, moments))) return plane;
  }
  if (triangles.size() < kMinTriangles) return std::nullopt;
  // Shapes with few parameters are tried first, because a narrow band lies on shapes of all three kinds.
  for (const auto fit : {FitCylinder, FitCone, FitSphere}) {
    if (const auto region = accept(fit(samples, moments))) return region;
  }
  return std::nullopt;
}

}  // namespace evpose

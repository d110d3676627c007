// SPDX-License-Identifier: Apache-2.0
#include "client/convert_step/face_surface.h"

#include <BRepAdaptor_Surface.hxx>
#include <Eigen/Geometry>
#include <GeomAbs_SurfaceType.hxx>
#include <cmath>
#include <gp_Cone.hxx>
#include <gp_Cylinder.hxx>
#include <gp_Pln.hxx>
#include <gp_Sphere.hxx>

namespace evpose::client {
namespace {

template <typename Triple>  // gp_Pnt, gp_Dir, gp_Vec
Eigen::Vector3d ToEigen(const Triple& t) {
  return {t.X(), t.Y(), t.Z()};
}

// Relative to the product of the lengths of the two derivatives: below it their directions are noise.
constexpr double kMinSine = 1e-9;

}  // namespace

struct FaceSurface::Adaptor {
  BRepAdaptor_Surface surface;
};

FaceSurface::FaceSurface(const TopoDS_Face& face)
    : adaptor_(new Adaptor{BRepAdaptor_Surface(face)}), is_reversed_(face.Orientation() == TopAbs_REVERSED) {}
FaceSurface::~FaceSurface() = default;

Eigen::Vector3d FaceSurface::Point(const Eigen::Vector2d& parameters) const {
  return ToEigen(adaptor_->surface.Value(parameters.x(), parameters.y()));
}

Eigen::Vector3d FaceSurface::Normal(const Eigen::Vector2d& parameters) const {
  gp_Pnt point;
  gp_Vec along_u, along_v;
  adaptor_->surface.D1(parameters.x(), parameters.y(), point, along_u, along_v);
  const Eigen::Vector3d u = ToEigen(along_u), v = ToEigen(along_v);
  const Eigen::Vector3d normal = u.cross(v);
  const double length = normal.norm();
  // At a pole one derivative is zero, or nearly so.
  if (!(length > kMinSine * (u.squaredNorm() + v.squaredNorm()))) return Eigen::Vector3d::Zero();
  return (is_reversed_ ? -1.0 : 1.0) / length * normal;
}

SurfaceRegion FaceSurface::Region(const Eigen::Vector3d& point, const Eigen::Vector3d& normal, double scale) const {
  SurfaceRegion region;
  const BRepAdaptor_Surface& surface = adaptor_->surface;
  Eigen::Vector3d outward = Eigen::Vector3d::Zero();  // from the axis or the centre to `point`
  switch (surface.GetType()) {
    case GeomAbs_Plane:
      region.shape = RegionShape::kPlane;
      region.point = ToEigen(surface.Plane().Location());
      region.axis = normal;
      break;
    case GeomAbs_Cylinder:
      region.shape = RegionShape::kCylinder;
      region.point = ToEigen(surface.Cylinder().Location());
      region.axis = ToEigen(surface.Cylinder().Axis().Direction());
      region.radius_m = scale * surface.Cylinder().Radius();
      outward = point - region.point;
      break;
    case GeomAbs_Cone:
      region.shape = RegionShape::kCone;
      region.point = ToEigen(surface.Cone().Apex());
      region.axis = ToEigen(surface.Cone().Axis().Direction());
      outward = point - region.point;
      if (outward.dot(region.axis) < 0.0) region.axis = -region.axis;
      region.half_angle_rad = std::abs(surface.Cone().SemiAngle());
      outward -= outward.dot(region.axis) * region.axis;
      break;
    case GeomAbs_Sphere:
      region.shape = RegionShape::kSphere;
      region.point = ToEigen(surface.Sphere().Location());
      region.radius_m = scale * surface.Sphere().Radius();
      outward = point - region.point;
      break;
    default:
      return region;
  }
  region.is_convex = region.shape == RegionShape::kPlane || outward.dot(normal) > 0.0;
  region.point *= scale;
  return region;
}

}  // namespace evpose::client

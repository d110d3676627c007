// SPDX-License-Identifier: Apache-2.0

// The surface of a face of a CAD model.
#pragma once

#include <Eigen/Core>
#include <TopoDS_Face.hxx>
#include <memory>

#include "core/mesh/types/smooth_surface.h"

namespace evpose::client {

// Unit: that of the model.
class FaceSurface {
 public:
  explicit FaceSurface(const TopoDS_Face& face);
  ~FaceSurface();
  FaceSurface(const FaceSurface&) = delete;
  FaceSurface& operator=(const FaceSurface&) = delete;

  Eigen::Vector3d Point(const Eigen::Vector2d& parameters) const;
  // The outward unit normal at the parameters; zero where the surface has none, as at the apex of a cone.
  Eigen::Vector3d Normal(const Eigen::Vector2d& parameters) const;
  // Shape and parameters; `point` is a point of the face and `normal` the outward normal there. Lengths are multiplied
  // by `scale`.
  SurfaceRegion Region(const Eigen::Vector3d& point, const Eigen::Vector3d& normal, double scale) const;

 private:
  struct Adaptor;
  const std::unique_ptr<const Adaptor> adaptor_;
  const bool is_reversed_;
};

}  // namespace evpose::client

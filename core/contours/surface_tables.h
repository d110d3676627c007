// SPDX-License-Identifier: Apache-2.0

// The tables of a model's surface from which its visible edges are found. They depend on the model alone.
#pragma once

#include <cstdint>
#include <memory>
#include <utility>

#include "core/contours/contour_mesh.h"
#include "core/contours/facet_contours.h"
#include "core/mesh/triangle_bvh.h"
#include "core/models/object_model.h"

namespace evpose {

// Immutable. Keeps a reference: the model must outlive it. For a model of a million triangles it takes about 0.2 s and
// 200 to 400 bytes per triangle: all users of a model share it.
struct SurfaceTables {
  explicit SurfaceTables(const ObjectModel& model)
      : SurfaceTables(model, std::make_shared<const TriangleBvh>(model.vertices, model.triangles)) {}
  // `tree` is the search tree of the model's triangles.
  SurfaceTables(const ObjectModel& model, std::shared_ptr<const TriangleBvh> tree)
      : faces(std::move(tree)), contours(model), facets(model) {}

  // Curved regions; the facets of a model that has contours between them count as one.
  uint32_t num_regions() const { return contours.num_regions() + (facets.empty() ? 0 : 1); }

  const std::shared_ptr<const TriangleBvh> faces;
  const ContourMesh contours;
  const FacetContours facets;
};

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/contours/edge_elements.h"

#include <algorithm>
#include <utility>

#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/contours/curve_levels.h"
#include "core/contours/element_view.h"
#include "core/contours/surface_tables.h"

namespace evpose {
namespace {

// A level is kept while the size of a pixel is beyond its step by less than this factor, so that an object whose
// distance varies at a step does not change its elements to and fro.
constexpr double kLevelHysteresis = 1.1;
// Lower bound of the depth of the object's centre, relative to the diameter, for a centre at or behind the camera: the
// size of a pixel stays positive.
constexpr double kLeastDepth = 0.1;
// Number of vertices whose bounding box determines the centre of the object. The level of detail alone depends on it,
// for which some per cent of the size suffice.
constexpr size_t kCentreVertices = 64;
// Candidates that are tested for occlusion, relative to the largest number of elements: bounds the number of rays. With
// fewer, a view in which most of the strongest candidates are hidden would have too few elements.
constexpr size_t kCandidatesPerElement = 4;

Eigen::Vector3d CentreOf(const ObjectModel& model) {
  Eigen::AlignedBox3d box;
  const size_t step = std::max<size_t>(1, model.vertices.size() / kCentreVertices);
  for (size_t i = 0; i < model.vertices.size(); i += step) box.extend(model.vertices[i]);
  return box.isEmpty() ? Eigen::Vector3d::Zero() : Eigen::Vector3d(box.center());
}

}  // namespace

absl::Status EdgeElementOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("EdgeElementOptions.sagitta_px", sagitta_px, 0.01, 10.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("EdgeElementOptions.min_chain_px", min_chain_px, 0.0, 1000.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("EdgeElementOptions.max_arc_px", max_arc_px, 0.0, 1000.0));
  return CheckRange("EdgeElementOptions.max_elements", max_elements, 1, 10'000);
}

int DetailLevel(const ObjectModel& model, const CameraModel& camera, const RigidTransform& camera_from_object,
                int previous) {
  const double depth_m = std::max((camera_from_object * CentreOf(model)).z(), kLeastDepth * model.diameter_m);
  const double size = depth_m / (camera.MaxFocalPx() * model.diameter_m);
  const auto step_above = [](int level) { return level + 1 < kNumDetailLevels ? PixelSizeOfLevel(level + 1) : 1e300; };
  if (previous >= 0 && previous < kNumDetailLevels) {
    const double least = previous > 0 ? PixelSizeOfLevel(previous) : 0.0;
    if (size * kLevelHysteresis >= least && size < step_above(previous) * kLevelHysteresis) return previous;
  }
  int level = 0;
  while (level + 1 < kNumDetailLevels && size >= step_above(level)) ++level;
  return level;
}

EdgeElementExtractor::EdgeElementExtractor(const ObjectModel& model, std::shared_ptr<const SurfaceTables> surface,
                                           const EdgeElementOptions& options)
    : model_(model),
      surface_(std::move(surface)),
      options_(options),
      curves_(std::make_unique<const CurveLevels>(model, options.sagitta_px)) {}

EdgeElementExtractor::EdgeElementExtractor(const ObjectModel& model, const TriangleBvh& faces,
                                           const EdgeElementOptions& options)
    : EdgeElementExtractor(
          model,
          std::make_shared<const SurfaceTables>(
              model, std::shared_ptr<const TriangleBvh>(std::shared_ptr<const void>(), &faces)),  // without ownership
          options) {}

EdgeElementExtractor::~EdgeElementExtractor() = default;

bool EdgeElementExtractor::has_curves() const { return !model_.curves.empty() || surface_->num_regions() > 0; }

uint32_t EdgeElementExtractor::num_curves() const {
  return static_cast<uint32_t>(model_.lines.size() + model_.curves.size()) + kImageOctants * surface_->num_regions();
}

bool EdgeElementExtractor::Extract(const CameraModel& camera, const RigidTransform& camera_from_object, int level,
                                   std::vector<EdgeElement>& elements) const {
  elements.clear();
  if (!has_curves()) return false;
  const ElementView view{camera, camera_from_object, camera_from_object.Inverse().translation_m};
  std::vector<Candidate> candidates;
  curves_->VisitChords(level, [&](EdgeElement element, size_t curve) {
    if (IsTurnedAway(view, element)) return;
    if (element.kind == EdgeKind::kCrease) element.prior_contrast = CreaseContrast(model_.curves[curve].turn_rad);
    AppendCandidates(view, element, element.curve, candidates);
  });
  Rims rims;
  surface_->contours.FindRims(view.eye, options_.sagitta_px / camera.MaxFocalPx(), rims);
  surface_->facets.AppendRims(view.eye, surface_->contours.num_regions(), rims);
  AppendContours(view, rims, options_.sagitta_px, static_cast<uint32_t>(model_.lines.size() + model_.curves.size()),
                 candidates);
  RemoveShortChains(options_.min_chain_px, candidates);
  bool has_more = KeepStrongest(kCandidatesPerElement * static_cast<size_t>(options_.max_elements), candidates);
  KeepVisible(view, model_, *surface_->faces, candidates);
  RemoveShortChains(options_.min_chain_px, candidates);
  has_more |= SelectElements(options_.max_elements, candidates);
  elements.reserve(candidates.size());
  for (const Candidate& candidate : candidates) elements.push_back(candidate.element);
  return has_more;
}

double EdgeElementExtractor::FacetShiftPx(const EdgeElement& element, const Eigen::Vector3d& eye,
                                          double focal_px) const {
  return element.facet_edge == EdgeElement::kNoFacetEdge ? 0.0
                                                         : surface_->facets.ShiftPx(element.facet_edge, eye, focal_px);
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdint>

#include "core/base/yield_point.h"
#include "core/contours/element_view.h"
#include "core/models/visibility.h"

namespace evpose {
namespace {

// Distances relative to the diameter. The points of elements lie on the surface, not on the triangles that approximate
// it: they are tested this far nearer to the eye and outside of the surface.
constexpr double kTowardsEye = 3e-3;
constexpr double kOutwards = 1e-3;
// Prior contrasts. An inner contour separates parts of one colour; a crease changes the brightness with the angle by
// which the surface turns, by less than the threshold of a sensor in most light below 40 degrees.
constexpr float kOutlineContrast = 1.0f;
constexpr float kInnerContrast = 0.5f;
constexpr float kBluntContrast = 0.5f;
constexpr double kSharpTurnRad = 0.7;  // 40 degrees

// The rays that test the visibility of a candidate.
struct EdgeRays {
  Eigen::Vector3d origin;    // of the rays
  Eigen::Vector3d outwards;  // unit normal of a face that is turned to the eye; zero for an edge without faces
  Eigen::Vector3d beside;    // in the image beyond an occluding edge; zero for other edges
  bool is_turned_away = false;
};

EdgeRays RaysOfContour(const ElementView& view, const EdgeElement& element) {
  const Eigen::Vector3d normal = (element.normals[0] + element.normals[1]).normalized();
  return {view.eye, normal, normal, false};
}

EdgeRays RaysOfEdge(const ElementView& view, const EdgeElement& element, double grazing_cosine) {
  EdgeRays rays{view.eye, Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero(), false};
  std::array<Eigen::Vector3d, 2> normals;
  size_t num_normals = 0, num_back = 0;
  const Eigen::Vector3d middle = 0.5 * (element.p1 + element.p2);
  const Eigen::Vector3d to_eye = view.eye - middle;
  double best_height_m = 0.0;
  for (const Eigen::Vector3d& normal : element.normals) {
    if (normal.isZero()) continue;
    const double height_m = normal.dot(to_eye);
    if (height_m < 0.0) ++num_back;
    if (num_normals == 0 || height_m > best_height_m) {
      best_height_m = height_m;
      rays.outwards = normal;
    }
    normals[num_normals++] = normal;
  }
  rays.is_turned_away = !FindRayOrigin({normals.data(), num_normals}, middle, grazing_cosine, rays.origin);
  if (num_normals == 2 && num_back == 1) {
    const Eigen::Vector3d across = to_eye.cross(element.p2 - element.p1).normalized();
    rays.beside = across.dot(element.normals[0] + element.normals[1]) < 0.0 ? Eigen::Vector3d(-across) : across;
  }
  return rays;
}

class VisibilityRays {
 public:
  VisibilityRays(const ElementView& view, const ObjectModel& model, const TriangleBvh& faces)
      : view_(view), model_(model), faces_(faces), has_distortion_(view.camera.HasDistortion()) {}

  EdgeRays RaysOf(const EdgeElement& element) const {
    return element.kind == EdgeKind::kContour ? RaysOfContour(view_, element)
                                              : RaysOfEdge(view_, element, VisibilityOptions().grazing_cosine);
  }

  bool IsVisible(const EdgeRays& rays, const Eigen::Vector3d& point) {
    if (has_distortion_ && !view_.camera.IsInImage(view_.Project(point))) return false;
    const Eigen::Vector3d towards = (rays.origin - point).normalized();
    const Eigen::Vector3d moved = point + model_.diameter_m * (kTowardsEye * towards + kOutwards * rays.outwards);
    return !faces_.IsOccluded(rays.origin, moved, VisibilityOptions().surface_tolerance * model_.diameter_m, occluder_);
  }

  // Sets `prior_contrast` and `is_outline`. One ray tests whether the background lies behind an occluding edge.
  void SetPriorContrast(const EdgeRays& rays, Candidate& candidate) const {
    EdgeElement& element = candidate.element;
    if (element.kind == EdgeKind::kBoundary) {
      candidate.is_outline = true;
    } else if (!rays.beside.isZero()) {
      const Eigen::Vector3d middle = 0.5 * (element.p1 + element.p2);
      const double pixel_m = (middle - view_.eye).norm() / view_.camera.MaxFocalPx();
      const Eigen::Vector3d start = middle + kBesideEdgePx * pixel_m * rays.beside;
      const Eigen::Vector3d end = start + kBackgroundDiameters * model_.diameter_m * (start - view_.eye).normalized();
      candidate.is_outline = !faces_.IsOccluded(start, end, 0.0);
    }
    if (candidate.is_outline) {
      element.prior_contrast = kOutlineContrast;
    } else if (element.kind == EdgeKind::kContour) {
      element.prior_contrast = kInnerContrast;
    } else if (element.kind == EdgeKind::kCrease && IsStep(element)) {
      element.prior_contrast = kStepContrast;
    }
  }

 private:
  bool IsStep(const EdgeElement& element) const {
    const SeenEdge edge = {view_.eye, element.p1, element.p2, view_.camera.MaxFocalPx()};
    return SidesOf(edge, faces_, model_.diameter_m) == EdgeSides::kParallel;
  }

  const ElementView& view_;
  const ObjectModel& model_;
  const TriangleBvh& faces_;
  const bool has_distortion_;
  uint32_t occluder_ = ~0u;  // the hint of TriangleBvh::IsOccluded
};

// Cuts a candidate to its visible part; false if most of it is hidden.
bool CutToVisible(const ElementView& view, VisibilityRays& visibility, const EdgeRays& rays, Candidate& candidate) {
  const Eigen::Vector3d along = candidate.element.p2 - candidate.element.p1;
  const auto is_visible = [&](double fraction) {
    return visibility.IsVisible(rays, candidate.element.p1 + fraction * along);
  };
  const bool is_first_visible = is_visible(1.0 / 6.0), is_last_visible = is_visible(5.0 / 6.0);
  if (is_first_visible && is_last_visible) return true;
  if (!is_first_visible && !is_last_visible) return false;
  if (!is_visible(0.5)) return false;
  candidate.element = PartOf(candidate.element, is_first_visible ? 0.0 : 1.0 / 3.0, is_first_visible ? 2.0 / 3.0 : 1.0);
  (is_first_visible ? candidate.p2_px : candidate.p1_px) =
      view.Project(is_first_visible ? candidate.element.p2 : candidate.element.p1);
  return true;
}

}  // namespace

float CreaseContrast(double turn_rad) { return turn_rad < kSharpTurnRad ? kBluntContrast : kSharpCreaseContrast; }

bool IsTurnedAway(const ElementView& view, const EdgeElement& element) {
  return RaysOfEdge(view, element, VisibilityOptions().grazing_cosine).is_turned_away;
}

void KeepVisible(const ElementView& view, const ObjectModel& model, const TriangleBvh& faces,
                 std::vector<Candidate>& candidates) {
  VisibilityRays visibility(view, model, faces);
  size_t kept = 0;
  for (size_t i = 0; i < candidates.size(); ++i) {
    YieldPoint(i);
    Candidate candidate = candidates[i];
    const EdgeRays rays = visibility.RaysOf(candidate.element);
    if (rays.is_turned_away || !CutToVisible(view, visibility, rays, candidate)) continue;
    visibility.SetPriorContrast(rays, candidate);
    candidates[kept++] = candidate;
  }
  candidates.resize(kept);
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>

#include "core/base/yield_point.h"
#include "core/contours/element_view.h"
#include "core/contours/polyline.h"
#include "core/geometry/image_clip.h"

namespace evpose {
namespace {

// Successive points of one contour in the image. The surface is convex along the ray at each of them, so that only
// other parts of the object can hide them.
struct ImageRun {
  std::vector<Eigen::Vector2d> pixels;
  std::vector<Eigen::Vector2d> normals;  // unit, outward
  std::vector<uint32_t> points;          // indices into Rims::points

  void Clear() {
    pixels.clear();
    normals.clear();
    points.clear();
  }
};

// Mean distance, pixels, of the arc outside of its chord (core/contours/README.md, equation (7)). A contour of facets
// is straight between its points.
double MeanOutside(const ImageRun& run, size_t first, size_t last, bool is_faceted) {
  const Eigen::Vector2d chord = run.pixels[last] - run.pixels[first];
  Eigen::Vector2d outward = Eigen::Vector2d(-chord.y(), chord.x()).normalized();
  if (outward.dot(run.normals[first] + run.normals[last]) < 0.0) outward = -outward;
  double area = 0.0, length_px = 0.0;
  for (size_t i = first; i < last; ++i) {
    const Eigen::Vector2d step = run.pixels[i + 1] - run.pixels[i];
    const double step_px = step.norm();
    const double middle_px = outward.dot(0.5 * (run.pixels[i] + run.pixels[i + 1]) - run.pixels[first]);
    const double arc_mean_px = is_faceted ? 0.0 : (run.normals[i + 1] - run.normals[i]).dot(step) / 12.0;
    area += step_px * (middle_px + arc_mean_px);
    length_px += step_px;
  }
  return length_px > 0.0 ? area / length_px : 0.0;
}

// The displacement along the normal of a contour point that moves its image by one pixel.
Eigen::Vector3d MoveOfPixel(const ElementView& view, const RimPoint& rim, const Eigen::Vector2d& image_normal) {
  const Eigen::Vector3d point = view.camera_from_object * rim.point;
  const Eigen::Vector3d normal = view.camera_from_object.rotation * rim.normal;
  const double depth_m = point.z();
  const Eigen::Vector2d moved(view.camera.fx_px * (normal.x() - normal.z() * point.x() / depth_m) / depth_m,
                              view.camera.fy_px * (normal.y() - normal.z() * point.y() / depth_m) / depth_m);
  const double pixels = moved.dot(image_normal);
  return pixels > 0.0 ? Eigen::Vector3d(rim.normal / pixels) : Eigen::Vector3d::Zero();
}

// `chain` is the number of the connected candidates, `curve` that of the first arc of the region.
void AppendRun(const ElementView& view, const Rims& rims, const RimChain& rim_chain, const ImageRun& run,
               double sagitta_px, uint32_t curve, uint32_t chain, std::vector<double>& errors,
               std::vector<Candidate>& candidates) {
  if (run.points.size() < 2) return;
  FindCutErrors(absl::MakeConstSpan(run.pixels), sagitta_px, errors);
  for (size_t first = 0, last = 1; last < run.points.size(); ++last) {
    if (errors[last] == 0.0 && last + 1 < run.points.size()) continue;
    const RimPoint& begin = rims.points[run.points[first]];
    const RimPoint& end = rims.points[run.points[last]];
    const double outside_px = MeanOutside(run, first, last, rim_chain.is_faceted);
    EdgeElement element;
    element.kind = EdgeKind::kContour;
    element.p1 = begin.point + outside_px * MoveOfPixel(view, begin, run.normals[first]);
    element.p2 = end.point + outside_px * MoveOfPixel(view, end, run.normals[last]);
    element.normals = {begin.normal, end.normal};
    element.radius_m = {begin.radius_m, end.radius_m};
    if (rim_chain.is_faceted) element.facet_edge = rims.points[run.points[(first + last) / 2]].facet_edge;
    element.curve = curve + static_cast<uint32_t>(ImageOctant(run.normals[first] + run.normals[last]));
    AppendCandidates(view, element, chain, candidates);
    first = last;
  }
}

}  // namespace

int ImageOctant(const Eigen::Vector2d& direction) {
  constexpr double kTan = 0.41421356237309503;  // tangent of 22.5 degrees
  const double x = std::abs(direction.x()), y = std::abs(direction.y());
  const bool is_left = direction.x() < 0.0, is_down = direction.y() < 0.0;
  if (y < kTan * x) return is_left ? 4 : 0;
  if (x < kTan * y) return is_down ? 6 : 2;
  if (is_left) return is_down ? 5 : 3;
  return is_down ? 7 : 1;
}

void AppendContours(const ElementView& view, const Rims& rims, double sagitta_px, uint32_t first_curve,
                    std::vector<Candidate>& candidates) {
  ImageRun run;
  std::vector<double> errors;
  for (size_t c = 0; c < rims.chains.size(); ++c) {
    YieldPoint(c);
    const RimChain& chain = rims.chains[c];
    const uint32_t region_curve = first_curve + kImageOctants * chain.region;
    const uint32_t number = first_curve + static_cast<uint32_t>(c);
    run.Clear();
    for (uint32_t i = chain.begin; i < chain.end; ++i) {
      const RimPoint& rim = rims.points[i];
      const Eigen::Vector3d point = view.camera_from_object * rim.point;
      const Eigen::Vector3d normal = view.camera_from_object.rotation * rim.normal;
      if (!(chain.is_faceted || rim.is_convex()) || !(point.z() > kClipDepthM)) {
        AppendRun(view, rims, chain, run, sagitta_px, region_curve, number, errors, candidates);
        run.Clear();
        continue;
      }
      run.pixels.push_back(view.camera.Project(point));
      run.normals.push_back(
          Eigen::Vector2d(normal.x() / view.camera.fx_px, normal.y() / view.camera.fy_px).normalized());
      run.points.push_back(i);
    }
    AppendRun(view, rims, chain, run, sagitta_px, region_curve, number, errors, candidates);
  }
}

}  // namespace evpose

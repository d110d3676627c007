// SPDX-License-Identifier: Apache-2.0
#include "core/contours/element_view.h"

#include <algorithm>
#include <cmath>

#include "core/geometry/image_clip.h"

namespace evpose {
namespace {

// Parts that are longer are divided: a third of an element is the precision with which it is cut where it is hidden.
constexpr double kMaxElementPx = 30.0;

}  // namespace

EdgeElement PartOf(const EdgeElement& element, double begin, double end) {
  EdgeElement part = element;
  const Eigen::Vector3d along = element.p2 - element.p1;
  part.p1 = element.p1 + begin * along;
  part.p2 = element.p1 + end * along;
  if (element.kind != EdgeKind::kContour) return part;
  const Eigen::Vector3d turn = element.normals[1] - element.normals[0];
  const double growth_m = element.radius_m[1] - element.radius_m[0];
  part.normals = {(element.normals[0] + begin * turn).normalized(), (element.normals[0] + end * turn).normalized()};
  part.radius_m = {element.radius_m[0] + begin * growth_m, element.radius_m[0] + end * growth_m};
  return part;
}

void AppendCandidates(const ElementView& view, const EdgeElement& element, uint32_t chain,
                      std::vector<Candidate>& candidates) {
  const LineInterval seen =
      ClipToImage(view.camera, view.camera_from_object * element.p1, view.camera_from_object * element.p2);
  if (seen.empty()) return;
  const EdgeElement clipped = seen.begin > 0.0 || seen.end < 1.0 ? PartOf(element, seen.begin, seen.end) : element;
  const auto project = [&](const Eigen::Vector3d& point_object) {
    Eigen::Vector3d point = view.camera_from_object * point_object;
    point.z() = std::max(point.z(), kClipDepthM);  // the element is cut there up to rounding
    return view.camera.Project(point);
  };
  Candidate candidate{clipped, project(clipped.p1), project(clipped.p2), chain, false};
  // The image with its margin bounds the number of parts.
  const int num_parts = static_cast<int>(std::ceil(candidate.length_px() / kMaxElementPx));
  if (num_parts <= 1) {
    candidates.push_back(candidate);
    return;
  }
  const Eigen::Vector2d first_px = candidate.p1_px;
  const Eigen::Vector2d last_px = candidate.p2_px;
  // Equal parts of the line in space, which are nearly equal in the image.
  for (int i = 0; i < num_parts; ++i) {
    candidate.element = PartOf(clipped, static_cast<double>(i) / num_parts, static_cast<double>(i + 1) / num_parts);
    candidate.p1_px = i == 0 ? first_px : candidate.p2_px;
    candidate.p2_px = i + 1 == num_parts ? last_px : project(candidate.element.p2);
    candidates.push_back(candidate);
  }
}

void RemoveShortChains(double min_chain_px, std::vector<Candidate>& candidates) {
  // Ends that are farther apart are those of different runs. Chords of one curve are moved by their own offsets, of
  // less than the sagitta.
  constexpr double kMaxGapPx = 1.0;
  size_t kept = 0;
  for (size_t begin = 0, end; begin < candidates.size(); begin = end) {
    double length_px = candidates[begin].length_px();
    for (end = begin + 1; end < candidates.size(); ++end) {
      if (candidates[end].chain != candidates[begin].chain) break;
      if ((candidates[end].p1_px - candidates[end - 1].p2_px).squaredNorm() > kMaxGapPx * kMaxGapPx) break;
      length_px += candidates[end].length_px();
    }
    if (length_px < min_chain_px) continue;
    for (size_t i = begin; i < end; ++i) candidates[kept++] = candidates[i];
  }
  candidates.resize(kept);
}

}  // namespace evpose

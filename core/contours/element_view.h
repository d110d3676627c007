// SPDX-License-Identifier: Apache-2.0

// Edge elements while they are found: chords of curves, clipped to the image (core/contours/README.md, sections 3 and
// 4).
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <vector>

#include "core/contours/contour_mesh.h"
#include "core/contours/edge_elements.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

// The arguments of one extraction.
struct ElementView {
  const CameraModel& camera;
  const RigidTransform& camera_from_object;
  Eigen::Vector3d eye;  // object frame

  Eigen::Vector2d Project(const Eigen::Vector3d& point_object) const {
    return camera.Project(camera_from_object * point_object);
  }
};

// An element that may be visible.
struct Candidate {
  EdgeElement element;
  Eigen::Vector2d p1_px;
  Eigen::Vector2d p2_px;
  // Elements with the same number that follow each other are connected.
  uint32_t chain = 0;
  // The elements that are chosen first: occluding edges in front of the background, and boundaries.
  bool is_outline = false;

  double length_px() const { return (p2_px - p1_px).norm(); }
  double weight() const { return length_px() * element.prior_contrast; }
};

// The octant of a direction in the image, 0 to kImageOctants - 1. The octants are centred on the axes and their
// diagonals: 0 contains (1, 0), 1 contains (1, 1), 2 contains (0, 1).
inline constexpr int kImageOctants = 8;
int ImageOctant(const Eigen::Vector2d& direction);

// Appends the candidates of the contours; `first_curve` is the number of the first arc and of the first chain.
void AppendContours(const ElementView& view, const Rims& rims, double sagitta_px, uint32_t first_curve,
                    std::vector<Candidate>& candidates);

// Divides the part of an element that is in the image and appends the parts, which are not longer than 30 px: the
// visibility of an element is that of a few of its points.
void AppendCandidates(const ElementView& view, const EdgeElement& element, uint32_t chain,
                      std::vector<Candidate>& candidates);

// The part of an element from the fraction `begin` to `end` of its length.
EdgeElement PartOf(const EdgeElement& element, double begin, double end);

// Whether all faces of a crease or boundary are turned away from the eye, by the rule of FindRayOrigin().
bool IsTurnedAway(const ElementView& view, const EdgeElement& element);

// Cuts the candidates to their visible parts, removes the hidden ones, and sets `prior_contrast` and `is_outline`
// (core/contours/README.md, section 4).
void KeepVisible(const ElementView& view, const ObjectModel& model, const TriangleBvh& faces,
                 std::vector<Candidate>& candidates);

// Removes runs of connected candidates that are shorter than `min_chain_px`.
void RemoveShortChains(double min_chain_px, std::vector<Candidate>& candidates);

// Keeps the `count` strongest candidates: those with the largest product of length and prior contrast. Returns whether
// there are more.
bool KeepStrongest(size_t count, std::vector<Candidate>& candidates);

// Removes candidates beside a stronger parallel one, then the weakest until `max_elements` are left: spread evenly over
// image and orientations. The order of those that remain is kept. Returns whether there were more than `max_elements`.
bool SelectElements(int max_elements, std::vector<Candidate>& candidates);

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/templates/edge_samples.h"

#include <algorithm>

namespace evpose {
namespace {

// Points nearer to the camera plane than this have no usable image.
constexpr double kNearestM = 1e-6;

}  // namespace

void SampleVisibleEdges(const ModelEdges& edges, const CameraModel& camera, const RigidTransform& camera_from_object,
                        int count, std::vector<EdgeSample>& samples) {
  samples.clear();
  VisibleEdges visible(camera, edges);
  const absl::Span<const TrackedLine> lines = visible.At(camera_from_object);
  std::vector<double> weights;
  double total = 0.0;
  for (const TrackedLine& line : lines) {
    const Eigen::Vector3d p1 = camera_from_object * line.p1, p2 = camera_from_object * line.p2;
    const bool is_in_front = p1.z() > kNearestM && p2.z() > kNearestM;
    const double length_px = is_in_front ? (camera.Project(p2) - camera.Project(p1)).norm() : 0.0;
    weights.push_back(length_px * line.prior_contrast);
    total += weights.back();
  }
  if (!(total > 0.0)) return;
  const double spacing = total / count;
  double next = 0.5 * spacing;  // accumulated weight at which the next sample is taken
  for (size_t k = 0; k < lines.size(); ++k) {
    const Eigen::Vector3d extent = lines[k].p2 - lines[k].p1;
    for (; next < weights[k]; next += spacing) {
      samples.push_back({lines[k].p1 + next / weights[k] * extent, std::min(0.5, 0.5 * spacing / weights[k]) * extent,
                         lines[k].prior_contrast});
    }
    next -= weights[k];
  }
}

}  // namespace evpose

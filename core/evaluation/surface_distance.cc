// SPDX-License-Identifier: Apache-2.0
#include "core/evaluation/surface_distance.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "core/evaluation/triangle_sequence.h"

namespace evpose {
namespace {

// The standard deviation of the mean of 512 distances is a fortieth of it.
constexpr int kSamples = 512;
// The first radius in which triangles are searched, relative to the diameter: the error of a good pose.
constexpr double kFirstRadius = 1e-3;

double AreaOf(const ObjectModel& model, const std::array<uint32_t, 3>& triangle) {
  const auto& [i, j, k] = triangle;
  return 0.5 * (model.vertices[j] - model.vertices[i]).cross(model.vertices[k] - model.vertices[i]).norm();
}

// Points at equal steps of the area, in the order of the triangles; in each triangle at the next place of the sequence.
std::vector<Eigen::Vector3d> SamplesOf(const ObjectModel& model) {
  double total = 0.0;
  for (const auto& triangle : model.triangles) total += AreaOf(model, triangle);
  std::vector<Eigen::Vector3d> samples;
  double sum = 0.0;
  for (const auto& triangle : model.triangles) {
    sum += AreaOf(model, triangle);
    while (static_cast<int>(samples.size()) < kSamples &&
           sum * kSamples >= (static_cast<double>(samples.size()) + 0.5) * total) {
      const auto [u, v] = TriangleSequence(samples.size());
      const auto& [i, j, k] = triangle;
      samples.push_back(model.vertices[i] + u * (model.vertices[j] - model.vertices[i]) +
                        v * (model.vertices[k] - model.vertices[i]));
    }
  }
  return samples;
}

}  // namespace

SurfaceDistance::SurfaceDistance(const ObjectModel& model)
    : faces_(model.vertices, model.triangles), diameter_m_(model.diameter_m), samples_(SamplesOf(model)) {}

double SurfaceDistance::DistanceOf(const Eigen::Vector3d& point_object, std::vector<TriangleBvh::Near>& found) const {
  // Every point is within this of the surface.
  const double largest_m = (point_object - samples_.front()).norm();
  for (double radius_m = kFirstRadius * diameter_m_;; radius_m *= 2.0) {
    if (radius_m >= largest_m) radius_m = largest_m + kFirstRadius * diameter_m_;
    faces_.FindNear(point_object, radius_m, found);
    if (found.empty() && radius_m <= largest_m) continue;
    double least_m = largest_m;
    for (const TriangleBvh::Near& near : found) least_m = std::min(least_m, near.distance_m);
    return least_m;
  }
}

double SurfaceDistance::Between(const RigidTransform& true_pose, const RigidTransform& estimated_pose) const {
  const RigidTransform true_from_estimated = true_pose.Inverse() * estimated_pose;
  std::vector<TriangleBvh::Near> found;
  double sum = 0.0;
  for (const Eigen::Vector3d& sample : samples_) sum += DistanceOf(true_from_estimated * sample, found);
  return sum / static_cast<double>(samples_.size());
}

}  // namespace evpose

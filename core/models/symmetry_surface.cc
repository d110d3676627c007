// SPDX-License-Identifier: Apache-2.0
#include "core/models/symmetry_surface.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <numeric>

#include "absl/types/span.h"

namespace evpose {
namespace {

// Bounds the time of a test.
constexpr size_t kMaxSampledTriangles = 4096;
// Distances are in units of the tolerance. Points on the surface: one tolerance for the difference of equal surfaces
// and one for the rotation.
constexpr double kOnSurface = 2.0;
// Samples off the surface: distance beyond the rim; least distance from every face before the rotation, and after it.
constexpr double kBeyondRim = 4.0, kOff = 3.0, kNoLongerOff = 0.75;
// The normal of a triangle that is less high is inaccurate and not compared.
constexpr double kMinHeight = 4.0;
// 60 degrees: distinguishes perpendicular faces, and front from back, also on a noisy mesh.
constexpr double kSameSideCosine = 0.5;
// Relative to the diameter: largest distance between a facet and the smooth surface for which the facet is accepted.
constexpr double kMaxSagitta = 1e-2;

std::vector<Eigen::Vector3d> Centred(absl::Span<const Eigen::Vector3d> points, const Eigen::Vector3d& centre) {
  std::vector<Eigen::Vector3d> centred;
  centred.reserve(points.size());
  for (const Eigen::Vector3d& point : points) centred.push_back(point - centre);
  return centred;
}

// A permutation of [0, size) with successive elements far apart: multiples of a step near size / golden ratio that has
// no common divisor with the size.
std::vector<size_t> SpreadOrder(size_t size) {
  size_t step = std::max<size_t>(1, static_cast<size_t>(0.6180339887498949 * static_cast<double>(size)));
  while (std::gcd(step, size) > 1) ++step;
  std::vector<size_t> order(size);
  for (size_t i = 1; i < size; ++i) order[i] = (order[i - 1] + step) % size;
  return order;
}

}  // namespace

double AllowedSagitta(const ObjectModel& model) {
  if (model.surface.normals.size() != model.triangles.size()) return 0.0;
  double largest_m = 0.0;
  for (size_t i = 0; i < model.triangles.size(); ++i) {
    for (int k = 0; k < 3; ++k) {
      const int next = (k + 1) % 3;
      const double length_m = (model.vertices[model.triangles[i][next]] - model.vertices[model.triangles[i][k]]).norm();
      const double turn_rad = (model.surface.normals[i][next] - model.surface.normals[i][k]).cast<double>().norm();
      largest_m = std::max(largest_m, length_m * turn_rad / 8.0);
    }
  }
  return std::min(largest_m, kMaxSagitta * model.diameter_m);
}

CentredSurface::CentredSurface(const ObjectModel& model, const Eigen::Vector3d& centre, double tolerance_m)
    : tolerance_m_(tolerance_m), faces_(Centred(model.vertices, centre), model.triangles) {
  const std::vector<Eigen::Vector3d> points = Centred(model.vertices, centre);
  const std::vector<size_t> order = SpreadOrder(model.triangles.size());
  const size_t count = std::min(order.size(), kMaxSampledTriangles);
  std::vector<Sample> samples;
  for (size_t i = 0; i < count; ++i) AddSamples(points, model.triangles[order[i]], samples);
  for (const size_t i : SpreadOrder(samples.size())) samples_.push_back(samples[i]);
}

void CentredSurface::AddSamples(const std::vector<Eigen::Vector3d>& points, const std::array<uint32_t, 3>& triangle,
                                std::vector<Sample>& samples) const {
  const Eigen::Vector3d centroid = (points[triangle[0]] + points[triangle[1]] + points[triangle[2]]) / 3.0;
  const Eigen::Vector3d across =
      (points[triangle[1]] - points[triangle[0]]).cross(points[triangle[2]] - points[triangle[0]]);
  double longest_m = 0.0;
  for (int i = 0; i < 3; ++i) {
    longest_m = std::max(longest_m, (points[triangle[(i + 1) % 3]] - points[triangle[i]]).norm());
  }
  const bool has_normal = across.norm() > kMinHeight * tolerance_m_ * longest_m;
  const Eigen::Vector3d no_normal = Eigen::Vector3d::Zero();
  samples.push_back({centroid, has_normal ? Eigen::Vector3d(across.normalized()) : no_normal, true});
  for (int i = 0; i < 3; ++i) {
    const Eigen::Vector3d &a = points[triangle[i]], &b = points[triangle[(i + 1) % 3]];
    const Eigen::Vector3d middle = 0.5 * (a + b);
    samples.push_back({a, no_normal, true});
    const Eigen::Vector3d beyond = middle + kBeyondRim * tolerance_m_ * (b - a).cross(across).normalized();
    if (!IsNear(beyond, no_normal, kOff * tolerance_m_)) samples.push_back({beyond, no_normal, false});
  }
}

bool CentredSurface::IsNear(const Eigen::Vector3d& point, const Eigen::Vector3d& normal, double distance_m) const {
  return faces_.HasNear(point, distance_m, normal, normal.isZero() ? 0.0 : kSameSideCosine);
}

bool CentredSurface::IsMapped(const Sample& sample, const Eigen::Matrix3d& rotation) const {
  const double distance_m = (sample.is_on_surface ? kOnSurface : kNoLongerOff) * tolerance_m_;
  return IsNear(rotation * sample.point, rotation * sample.normal, distance_m) == sample.is_on_surface;
}

bool CentredSurface::IsMappedOntoItself(const Eigen::Matrix3d& rotation, int64_t max_samples, int64_t& samples,
                                        size_t& witness) const {
  for (size_t i = 0; i < samples_.size(); ++i) {
    if (++samples >= max_samples) return false;
    const size_t sample = (witness + i) % samples_.size();
    if (IsMapped(samples_[sample], rotation)) continue;
    witness = sample;
    return false;
  }
  return true;
}

bool CentredSurface::IsMappedOntoItself(absl::Span<const Eigen::Matrix3d> rotations, int64_t max_samples,
                                        int64_t& samples) const {
  for (size_t i = 0; i < samples_.size(); ++i) {
    if (++samples >= max_samples) return false;
    if (!IsMapped(samples_[i], rotations[i % rotations.size()])) return false;
  }
  return true;
}

}  // namespace evpose

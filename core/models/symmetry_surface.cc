// SPDX-License-Identifier: Apache-2.0
#include "core/models/symmetry_surface.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <utility>

#include "absl/types/span.h"
#include "core/geometry/half_turn.h"
#include "core/models/slippage.h"
#include "core/numerics/math.h"

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

// Models without edges. Moments of the surface that differ by less, relative to the largest, are equal: the facets of a
// mesh of 24 sides change them by up to 4 %.
constexpr double kEqualMoments = 0.05;
constexpr int kMaxOrder = 16;
// Angles at which half turns across an axis are tested. From one to the next the image of the outermost point moves by
// at most 2.2e-3 of the diameter; an interval of 4e-3 is accepted.
constexpr int kFlipSteps = 1440;
// Halvings that locate an end of an accepted interval of angles, to a thousandth of its length.
constexpr int kFlipHalvings = 10;
// Angle, rad, of a turn that is tested, too: a turn by a small angle moves a part near the axis, or a shallow oval, by
// less than the tolerance.
constexpr double kLargeTurn = 2.4;
// Without edges the surface alone decides. Twice the tolerance and the distance between facets and surface are
// accepted; a larger distance, relative to the diameter, would hide features of more than 3.6 px of an object of 300
// px.
constexpr double kMaxSagittaAlone = 5e-3;

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

// Every symmetry maps the axes of the moments of the surface onto each other.
class SurfaceGroupSearch {
 public:
  SurfaceGroupSearch(const ObjectModel& model, const SurfaceMoments& moments, double tolerance_m, int64_t max_samples)
      : surface_(model, moments.centroid, tolerance_m), max_samples_(max_samples) {
    group_.centre = moments.centroid;
    group_.rotations.push_back(Eigen::Matrix3d::Identity());
  }

  SurfaceGroup Run(const SurfaceMoments& moments) {
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(
        Eigen::Matrix3d(moments.slippage.topLeftCorner<3, 3>()));
    const Eigen::Vector3d& values = solver.eigenvalues();
    const double equal = kEqualMoments * values[2];
    const bool is_low_pair = values[1] - values[0] <= equal, is_high_pair = values[2] - values[1] <= equal;
    if (is_low_pair != is_high_pair) {
      const Eigen::Vector3d axis = solver.eigenvectors().col(is_low_pair ? 2 : 0);
      FindTurns(axis);
      FindFlips(axis);
    } else if (!is_low_pair) {
      FindHalfTurns(solver.eigenvectors());
    }
    group_.was_cut_short = group_.num_samples >= max_samples_;
    return std::move(group_);
  }

 private:
  bool IsSymmetry(const Eigen::Matrix3d& rotation) {
    return group_.num_samples < max_samples_ &&
           surface_.IsMappedOntoItself(rotation, max_samples_, group_.num_samples, witness_);
  }

  // About three perpendicular axes: one, or all, because the third is the product of the other two.
  void FindHalfTurns(const Eigen::Matrix3d& axes) {
    std::vector<Eigen::Matrix3d> found;
    for (int axis = 0; axis < 3 && found.size() < 2; ++axis) {
      const Eigen::Matrix3d half_turn = HalfTurn(axes.col(axis));
      if (IsSymmetry(half_turn)) found.push_back(half_turn);
    }
    if (found.size() == 2) found.push_back(found[0] * found[1]);
    group_.rotations.insert(group_.rotations.end(), found.begin(), found.end());
  }

  // The rotations about the axis with the largest number of equal steps.
  void FindTurns(const Eigen::Vector3d& axis) {
    for (int order = kMaxOrder; order >= 2; --order) {
      const double step_rad = 2.0 * std::numbers::pi / order;
      const double large_rad = step_rad * std::max(1.0, std::round(kLargeTurn / step_rad));
      if (!IsSymmetry(ExpSo3(large_rad * axis)) || !IsSymmetry(ExpSo3(step_rad * axis))) continue;
      for (int k = 1; k < order; ++k) group_.rotations.push_back(ExpSo3(k * step_rad * axis));
      return;
    }
  }

  // The half turns across the axis: the first one is the middle of an interval of angles at which they are symmetries.
  void FindFlips(const Eigen::Vector3d& axis) {
    const Eigen::Vector3d first = axis.unitOrthogonal(), second = axis.cross(first);
    const auto half_turn = [&](double step) {
      const auto [sin, cos] = DeterministicSinCos(step * std::numbers::pi / kFlipSteps);
      return HalfTurn(cos * first + sin * second);
    };
    int found = 0;
    while (found < kFlipSteps && !IsSymmetry(half_turn(found))) ++found;
    if (found == kFlipSteps) return;
    // The end of the interval in one direction: at most a quarter turn away, where another half turn would be across.
    const auto end = [&](int direction) {
      double inside = 0.0, outside = 1.0;
      while (outside < 0.5 * kFlipSteps && IsSymmetry(half_turn(found + direction * outside))) {
        inside = outside;
        outside *= 2.0;
      }
      for (int i = 0; i < kFlipHalvings; ++i) {
        const double middle = 0.5 * (inside + outside);
        (IsSymmetry(half_turn(found + direction * middle)) ? inside : outside) = middle;
      }
      return found + direction * inside;
    };
    const double low = end(-1), high = end(1);
    const Eigen::Matrix3d flip = half_turn(0.5 * (low + high));
    const size_t num_turns = group_.rotations.size();
    for (size_t i = 0; i < num_turns; ++i) group_.rotations.push_back(flip * group_.rotations[i]);
  }

  const CentredSurface surface_;
  const int64_t max_samples_;
  size_t witness_ = 0;  // sample of the surface that has contradicted a rotation
  SurfaceGroup group_;
};

}  // namespace

SurfaceGroup FindSurfaceGroup(const ObjectModel& model, double tolerance_m, int64_t max_samples) {
  const SurfaceMoments moments = MomentsOf(model);
  if (!(moments.radius_m > 0.0)) return {moments.centroid, {Eigen::Matrix3d::Identity()}, 0, false};
  const double sagitta_m = std::min(AllowedSagitta(model), kMaxSagittaAlone * model.diameter_m);
  return SurfaceGroupSearch(model, moments, tolerance_m + sagitta_m, max_samples).Run(moments);
}

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

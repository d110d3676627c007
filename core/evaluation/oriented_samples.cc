// SPDX-License-Identifier: Apache-2.0
#include "core/evaluation/oriented_samples.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/functional/function_ref.h"
#include "core/evaluation/triangle_sequence.h"

namespace evpose {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kMaxSamples = 20'000.0;  // bounds the time
// Relative to the diameter: less than the tolerance of a near-symmetry along edges; in a surface, a curved one turns
// less than 20 degrees in it unless it is a fillet.
constexpr double kEdgeSpacing = 0.005, kSurfaceSpacing = 0.01;
constexpr double kSameCosine = 0.94;        // 20 degrees
constexpr double kSameAxisCosine = 0.9986;  // 3 degrees
constexpr int kMaxAxes = 40;                // bounds the time: each axis is compared on all samples

using SegmentVisitor = absl::FunctionRef<void(const Vector3d& from, const Vector3d& to)>;

void VisitSegments(const ObjectModel& model, SegmentVisitor visit) {
  for (const ModelLine& line : model.lines) visit(line.p1, line.p2);
  for (const EdgeCurve& curve : model.curves) {
    for (size_t i = 1; i < curve.points.size(); ++i) visit(curve.points[i - 1], curve.points[i]);
  }
}

// Twice the area of a triangle along its normal.
Vector3d AreaVector(const ObjectModel& model, const std::array<uint32_t, 3>& triangle) {
  const Vector3d& a = model.vertices[triangle[0]];
  return (model.vertices[triangle[1]] - a).cross(model.vertices[triangle[2]] - a);
}

// OrientedSample::weight of points of a triangle. The normals of a sphere of radius r differ by a / r at a distance of
// a.
double ContourWeight(const ObjectModel& model, size_t triangle) {
  if (model.surface.empty()) return model.facet_edges.empty() ? 0.0 : 1.0;
  if (model.surface.regions[model.surface.region_of[triangle]].is_flat()) return 0.0;
  const auto& normals = model.surface.normals[triangle];
  double sum = 0.0;
  for (size_t k = 0; k < 3; ++k) {
    const size_t next = (k + 1) % 3;
    const double length_m =
        (model.vertices[model.triangles[triangle][next]] - model.vertices[model.triangles[triangle][k]]).norm();
    if (length_m > 0.0) sum += (normals[next] - normals[k]).cast<double>().norm() / length_m / 3.0;
  }
  return sum;
}

double AreaOf(const ObjectModel& model) {
  double area = 0.0;
  for (const auto& triangle : model.triangles) area += 0.5 * AreaVector(model, triangle).norm();
  return area;
}

// A set of directions with weights. Directions that differ by less than 3 degrees are merged, and their weights are
// added.
class Directions {
 public:
  void Add(const Vector3d& direction, double weight) {
    for (auto& [known, sum] : weighted_) {
      if (std::abs(known.dot(direction)) < kSameAxisCosine) continue;
      sum += weight;
      return;
    }
    // More directions than these are those of a round surface, which has no preferred one.
    constexpr size_t kMaxDirections = 500;
    if (weighted_.size() < kMaxDirections) weighted_.emplace_back(direction, weight);
  }

  // The directions with the largest weights.
  std::vector<Vector3d> Largest(size_t count) {
    std::stable_sort(weighted_.begin(), weighted_.end(),
                     [](const auto& a, const auto& b) { return a.second > b.second; });
    std::vector<Vector3d> largest;
    for (size_t i = 0; i < std::min(count, weighted_.size()); ++i) largest.push_back(weighted_[i].first);
    return largest;
  }

 private:
  std::vector<std::pair<Vector3d, double>> weighted_;
};

void AddAxis(const Vector3d& axis, std::vector<Vector3d>& axes) {
  if (!(axis.norm() > 1e-6) || axes.size() >= kMaxAxes) return;
  const Vector3d unit = axis.normalized();
  const auto is_same = [&unit](const Vector3d& other) { return std::abs(other.dot(unit)) > kSameAxisCosine; };
  if (std::none_of(axes.begin(), axes.end(), is_same)) axes.push_back(unit);
}

void AddPrincipalAxes(absl::Span<const OrientedSample> samples, std::vector<Vector3d>& axes) {
  if (samples.empty()) return;
  const double count = static_cast<double>(samples.size());
  Vector3d mean = Vector3d::Zero();
  for (const OrientedSample& sample : samples) mean += sample.point / count;
  Matrix3d moments = Matrix3d::Zero();
  for (const OrientedSample& sample : samples) {
    moments += (sample.point - mean) * (sample.point - mean).transpose() / count;
  }
  const Eigen::SelfAdjointEigenSolver<Matrix3d> solver(moments);
  for (int i = 0; i < 3; ++i) AddAxis(solver.eigenvectors().col(i), axes);
}

}  // namespace

double EdgeSpacing(const ObjectModel& model) {
  double length_m = 0.0;
  VisitSegments(model, [&](const Vector3d& from, const Vector3d& to) { length_m += (to - from).norm(); });
  return std::max(kEdgeSpacing * model.diameter_m, length_m / kMaxSamples);
}

std::vector<OrientedSample> SampleEdges(const ObjectModel& model) {
  const double step_m = EdgeSpacing(model);
  std::vector<OrientedSample> samples;
  double next_m = 0.5 * step_m;  // from the beginning of the segment
  VisitSegments(model, [&](const Vector3d& from, const Vector3d& to) {
    const double length_m = (to - from).norm();
    for (; next_m < length_m; next_m += step_m) {
      samples.push_back({from + next_m / length_m * (to - from), (to - from) / length_m, 1.0});
    }
    next_m -= length_m;
  });
  return samples;
}

double SurfaceSpacing(const ObjectModel& model) {
  return std::max(kSurfaceSpacing * model.diameter_m, std::sqrt(AreaOf(model) / kMaxSamples));
}

std::vector<OrientedSample> SampleSurface(const ObjectModel& model) {
  const double spacing_m = SurfaceSpacing(model), step = spacing_m * spacing_m;
  const bool has_normals = model.surface.normals.size() == model.triangles.size();
  std::vector<OrientedSample> samples;
  double sum = 0.0;
  for (size_t t = 0; t < model.triangles.size(); ++t) {
    const auto& [a, b, c] = model.triangles[t];
    const Vector3d area = AreaVector(model, model.triangles[t]);
    sum += 0.5 * area.norm();
    const double weight = ContourWeight(model, t);
    while (sum >= (static_cast<double>(samples.size()) + 0.5) * step) {
      const auto [u, v] = TriangleSequence(samples.size());
      const double w = 1.0 - u - v;
      Vector3d normal = area.normalized();
      if (has_normals) {
        const auto& normals = model.surface.normals[t];
        const Vector3d smooth = (w * normals[0] + u * normals[1] + v * normals[2]).cast<double>();
        if (smooth.norm() > 0.5) normal = smooth.normalized();
      }
      samples.push_back({w * model.vertices[a] + u * model.vertices[b] + v * model.vertices[c], normal, weight});
    }
  }
  return samples;
}

std::vector<Vector3d> CandidateAxes(const ObjectModel& model, absl::Span<const OrientedSample> edges,
                                    absl::Span<const OrientedSample> surface) {
  // Directions of faces, and of lines, that are tried: a cuboid has three of each, a regular dodecahedron six of its
  // faces. Each adds the time of testing an axis.
  constexpr size_t kMaxOfEach = 6;
  std::vector<Vector3d> axes;
  AddPrincipalAxes(surface, axes);
  AddPrincipalAxes(edges, axes);
  Directions normals, along;
  for (const OrientedSample& sample : surface) normals.Add(sample.direction, 1.0);
  for (const ModelLine& line : model.lines) along.Add((line.p2 - line.p1).normalized(), (line.p2 - line.p1).norm());
  const std::vector<Vector3d> faces = normals.Largest(kMaxOfEach), lines = along.Largest(kMaxOfEach);
  for (const Vector3d& axis : faces) AddAxis(axis, axes);
  for (const Vector3d& axis : lines) AddAxis(axis, axes);
  // If the directions `sides` are the face normals of a cube, these are its axes through edges and through corners.
  const std::vector<Vector3d>& sides = faces.empty() ? lines : faces;
  const size_t count = std::min<size_t>(3, sides.size());
  for (size_t i = 0; i < count; ++i) {
    for (size_t j = i + 1; j < count; ++j) {
      AddAxis(sides[i] + sides[j], axes);
      AddAxis(sides[i] - sides[j], axes);
    }
  }
  if (count == 3) {
    for (const double x : {1.0, -1.0}) {
      for (const double y : {1.0, -1.0}) AddAxis(sides[0] + x * sides[1] + y * sides[2], axes);
    }
  }
  return axes;
}

OrientedIndex::OrientedIndex(std::vector<OrientedSample> samples, bool is_surface, double max_reach_m)
    : samples_(std::move(samples)), is_surface_(is_surface), cell_m_(max_reach_m) {
  if (samples_.empty()) return;
  Eigen::AlignedBox3d box;
  for (const OrientedSample& sample : samples_) box.extend(sample.point);
  low_ = box.min();
  for (int i = 0; i < 3; ++i) sizes_[i] = static_cast<int>(box.sizes()[i] / cell_m_) + 1;
  begin_.assign(Number({sizes_[0] - 1, sizes_[1] - 1, sizes_[2] - 1}) + 2, 0);
  for (const OrientedSample& sample : samples_) ++begin_[Number(CellOf(sample.point)) + 1];
  for (size_t i = 1; i < begin_.size(); ++i) begin_[i] += begin_[i - 1];
  by_cell_.resize(samples_.size());
  std::vector<uint32_t> next = begin_;
  for (size_t i = 0; i < samples_.size(); ++i) {
    by_cell_[next[Number(CellOf(samples_[i].point))]++] = static_cast<uint32_t>(i);
  }
}

std::array<int, 3> OrientedIndex::CellOf(const Vector3d& point) const {
  std::array<int, 3> cell;
  for (int i = 0; i < 3; ++i) cell[i] = static_cast<int>(std::floor((point[i] - low_[i]) / cell_m_));
  return cell;
}

const OrientedSample* OrientedIndex::Nearest(const OrientedSample& sample, double reach_m) const {
  if (samples_.empty()) return nullptr;
  const std::array<int, 3> first = CellOf(sample.point - Vector3d::Constant(reach_m));
  const std::array<int, 3> last = CellOf(sample.point + Vector3d::Constant(reach_m));
  const OrientedSample* nearest = nullptr;
  double least2 = reach_m * reach_m;
  for (int z = std::max(0, first[2]); z <= std::min(sizes_[2] - 1, last[2]); ++z) {
    for (int y = std::max(0, first[1]); y <= std::min(sizes_[1] - 1, last[1]); ++y) {
      for (int x = std::max(0, first[0]); x <= std::min(sizes_[0] - 1, last[0]); ++x) {
        const size_t cell = Number({x, y, z});
        for (uint32_t i = begin_[cell]; i < begin_[cell + 1]; ++i) {
          const OrientedSample& other = samples_[by_cell_[i]];
          const double distance2 = (other.point - sample.point).squaredNorm();
          const double cosine = other.direction.dot(sample.direction);
          if (distance2 > least2 || (is_surface_ ? cosine : std::abs(cosine)) < kSameCosine) continue;
          least2 = distance2;
          nearest = &other;
        }
      }
    }
  }
  return nearest;
}

Matrix3d OrientedIndex::Across(const OrientedSample& sample) const {
  const Matrix3d along = sample.direction * sample.direction.transpose();
  return is_surface_ ? along : Matrix3d(Matrix3d::Identity() - along);
}

}  // namespace evpose

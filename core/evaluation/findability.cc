// SPDX-License-Identifier: Apache-2.0
#include "core/evaluation/findability.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/geometry/half_turn.h"
#include "core/geometry/lines_of_a_pose.h"
#include "core/initialization/check_lines.h"
#include "core/models/continuous_symmetry.h"
#include "core/models/object_model.h"

namespace evpose {
namespace {

constexpr double kSamplePx = 4.0;  // along edges, for the comparison of two images

struct SampledEdge {
  Eigen::Vector2d position_px;
  Eigen::Vector2d direction;  // unit, either sign
};

std::vector<SampledEdge> SampleEdges(absl::Span<const ImageLine> lines) {
  std::vector<SampledEdge> samples;
  for (const ImageLine& line : lines) {
    if (!line.in_view()) continue;
    const int count = std::max(1, static_cast<int>(std::lround(line.length_px / kSamplePx)));
    for (int k = 0; k < count; ++k) samples.push_back({line.PointAt((k + 0.5) / count), line.direction});
  }
  return samples;
}

// Finds the nearest sample of an image within a radius.
class SampleIndex {
 public:
  SampleIndex(const std::vector<SampledEdge>& samples, double radius_px, double same_rad)
      : samples_(samples), radius_px_(radius_px), min_cosine_(1.0 - 0.5 * same_rad * same_rad) {
    for (size_t i = 0; i < samples.size(); ++i) cells_[CellOf(samples[i].position_px)].push_back(i);
  }

  // Null if there is none with about the same direction within `radius_px`.
  const SampledEdge* Nearest(const SampledEdge& sample) const {
    const auto [column, row] = CellOf(sample.position_px);
    const SampledEdge* nearest = nullptr;
    double distance_px = radius_px_;
    for (int y = row - 1; y <= row + 1; ++y) {
      for (int x = column - 1; x <= column + 1; ++x) {
        const auto cell = cells_.find({x, y});
        if (cell == cells_.end()) continue;
        for (const size_t i : cell->second) {
          const SampledEdge& other = samples_[i];
          if (std::abs(other.direction.dot(sample.direction)) < min_cosine_) continue;
          const double other_px = (other.position_px - sample.position_px).norm();
          if (other_px > distance_px) continue;
          distance_px = other_px;
          nearest = &other;
        }
      }
    }
    return nearest;
  }

 private:
  std::pair<int, int> CellOf(const Eigen::Vector2d& position_px) const {
    return {static_cast<int>(std::floor(position_px.x() / radius_px_)),
            static_cast<int>(std::floor(position_px.y() / radius_px_))};
  }

  const std::vector<SampledEdge>& samples_;
  const double radius_px_;
  const double min_cosine_;
  std::map<std::pair<int, int>, std::vector<size_t>> cells_;
};

// Moves `samples` by the shift that brings them nearest to `target` (iterated mean of the distances to the nearest).
void ShiftOnto(const std::vector<SampledEdge>& target, double reach_px, double same_rad,
               std::vector<SampledEdge>& samples) {
  constexpr int kIterations = 4;  // each compares the samples with the edges that are nearest by then
  const SampleIndex index(target, reach_px, same_rad);
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    // Only the part of the distance across the edge counts, because the position along an edge is not measured.
    Eigen::Matrix2d information = Eigen::Matrix2d::Zero();
    Eigen::Vector2d right_side = Eigen::Vector2d::Zero();
    for (const SampledEdge& sample : samples) {
      const SampledEdge* nearest = index.Nearest(sample);
      if (nearest == nullptr) continue;
      const Eigen::Vector2d normal(-nearest->direction.y(), nearest->direction.x());
      information += normal * normal.transpose();
      right_side += normal * normal.dot(nearest->position_px - sample.position_px);
    }
    information.diagonal().array() += 1.0;  // no shift along a direction without information
    const Eigen::Vector2d shift = information.inverse() * right_side;
    for (SampledEdge& sample : samples) sample.position_px += shift;
  }
}

// Number of `samples` without a counterpart in `target`.
size_t CountDiffering(const std::vector<SampledEdge>& samples, const std::vector<SampledEdge>& target,
                      const FindabilityOptions& options) {
  // Half of the distance between two samples may separate counterparts along the edge.
  const SampleIndex index(target, options.same_px + 0.5 * kSamplePx, options.same_rad);
  return static_cast<size_t>(std::count_if(samples.begin(), samples.end(), [&index](const SampledEdge& sample) {
    return index.Nearest(sample) == nullptr;
  }));
}

// The principal axes of the edges and vertices about their mean, and the mean; columns are unit vectors.
struct PrincipalAxes {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Eigen::Matrix3d axes = Eigen::Matrix3d::Identity();
};

PrincipalAxes FindPrincipalAxes(const ObjectModel& model) {
  // Points are weighted by area, so that the density of a tessellation does not matter; models without faces by the
  // length of their edges.
  std::vector<std::pair<double, Eigen::Vector3d>> weighted;
  for (const auto& triangle : model.triangles) {
    const Eigen::Vector3d &a = model.vertices[triangle[0]], &b = model.vertices[triangle[1]],
                          &c = model.vertices[triangle[2]];
    const double area = 0.5 * (b - a).cross(c - a).norm();
    // Exact for the second moment of a triangle: its edge midpoints with equal weights.
    for (const Eigen::Vector3d& point :
         {Eigen::Vector3d(0.5 * (a + b)), Eigen::Vector3d(0.5 * (b + c)), Eigen::Vector3d(0.5 * (c + a))}) {
      weighted.emplace_back(area / 3.0, point);
    }
  }
  if (weighted.empty()) {
    for (const ModelLine& line : model.lines) {
      weighted.emplace_back(0.5 * (line.p2 - line.p1).norm(), line.p1);
      weighted.emplace_back(0.5 * (line.p2 - line.p1).norm(), line.p2);
    }
  }
  double sum = 0.0;
  PrincipalAxes result;
  for (const auto& [weight, point] : weighted) {
    sum += weight;
    result.centre += weight * point;
  }
  if (!(sum > 0.0)) return result;
  result.centre /= sum;
  Eigen::Matrix3d moments = Eigen::Matrix3d::Zero();
  for (const auto& [weight, point] : weighted) {
    moments += weight / sum * (point - result.centre) * (point - result.centre).transpose();
  }
  result.axes = Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(moments).eigenvectors();
  return result;
}

// The half turns about the principal axes that change the object, object_from_object.
std::vector<std::pair<Eigen::Vector3d, RigidTransform>> HalfTurns(const ObjectModel& model) {
  const PrincipalAxes principal = FindPrincipalAxes(model);
  constexpr double kSameRad = 0.02;  // InitializationOptions::merge_rad
  std::vector<std::pair<Eigen::Vector3d, RigidTransform>> turns;
  for (int i = 0; i < 3; ++i) {
    const Eigen::Vector3d axis = principal.axes.col(i);
    const Eigen::Matrix3d rotation = HalfTurn(axis);
    const RigidTransform turn = RotationAbout(principal.centre, rotation);
    const RigidTransform nearest = NearestEquivalent(RigidTransform(), model, turn);
    if (RotationAngle(nearest.rotation, rotation) > kSameRad) turns.emplace_back(axis, turn);
  }
  return turns;
}

// Predicts one view after the other.
class FindabilityPredictor {
 public:
  FindabilityPredictor(const ObjectModel& model, const CameraModel& camera, const FindabilityOptions& options)
      : options_(options),
        has_curves_(HasCurvedEdges(model)),
        viewer_(model, camera, options.views),
        turns_(HalfTurns(model)) {
    const double max_px = std::min<double>(
        {options.max_object_px, static_cast<double>(camera.width_px), static_cast<double>(camera.height_px)});
    for (double px = options.min_object_px; px <= max_px; px *= options.size_step) sizes_px_.push_back(px);
  }

  ViewFindability From(const Eigen::Vector3d& direction) {
    ViewFindability result;
    result.direction = direction;
    const ModelView view = viewer_.From(direction, options_.views.object_px);
    result.edge_px = view.length_px;
    const std::vector<SampledEdge> samples = SampleEdges(viewer_.image_lines());
    for (const auto& [axis, turn] : turns_) {
      viewer_.At(view.camera_from_object * turn);
      result.rivals.push_back(Compare(axis, samples, SampleEdges(viewer_.image_lines())));
    }
    FindSmallest(direction, result);
    return result;
  }

 private:
  HalfTurnRival Compare(const Eigen::Vector3d& axis, const std::vector<SampledEdge>& samples,
                        std::vector<SampledEdge> rival) const {
    // The rival would be shifted by the search: its centre of rotation is not that of its outline.
    constexpr double kReach = 0.08;  // relative to the object's size
    ShiftOnto(samples, kReach * options_.views.object_px, options_.same_rad, rival);
    const size_t differing = CountDiffering(samples, rival, options_) + CountDiffering(rival, samples, options_);
    const size_t all = samples.size() + rival.size();
    return {axis, kSamplePx * static_cast<double>(differing),
            all > 0 ? static_cast<double>(differing) / static_cast<double>(all) : 0.0};
  }

  bool IsFindable(const Eigen::Vector3d& direction, double object_px) {
    const ModelView view = viewer_.From(direction, object_px);
    if (view.length_px < options_.min_edge_px) return false;
    if (!has_curves_ && NumLongLines() < kLinesOfAPose) return false;
    // `weakest_px` is that of ModelViewOptions::events events.
    const double events = options_.motion_px * view.length_px;
    const double deviation_px = view.weakest_px * std::sqrt(options_.views.events / events);
    return deviation_px <= options_.max_deviation_rad * 0.5 * object_px;
  }

  std::ptrdiff_t NumLongLines() const {
    const absl::Span<const ImageLine> lines = viewer_.image_lines();
    return std::count_if(lines.begin(), lines.end(), [this](const ImageLine& line) {
      return line.in_view() && line.length_px >= options_.min_line_px;
    });
  }

  // Bisects the sizes: length and certainty grow with the size.
  void FindSmallest(const Eigen::Vector3d& direction, ViewFindability& result) {
    if (sizes_px_.empty() || !IsFindable(direction, sizes_px_.back())) return;
    size_t low = 0, high = sizes_px_.size() - 1;
    while (low < high) {
      const size_t middle = (low + high) / 2;
      if (IsFindable(direction, sizes_px_[middle])) {
        high = middle;
      } else {
        low = middle + 1;
      }
    }
    result.smallest_px = sizes_px_[high];
  }

  const FindabilityOptions options_;
  const bool has_curves_;
  ModelViewer viewer_;
  std::vector<double> sizes_px_;
  const std::vector<std::pair<Eigen::Vector3d, RigidTransform>> turns_;
};

}  // namespace

absl::Status FindabilityOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(views.Validate());
  EVPOSE_RETURN_IF_ERROR(CheckPositive("min_edge_px", min_edge_px));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("min_line_px", min_line_px));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("motion_px", motion_px));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("max_deviation_rad", max_deviation_rad));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("min_object_px", min_object_px));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_object_px", max_object_px, min_object_px, 1e6));
  EVPOSE_RETURN_IF_ERROR(CheckRange("size_step", size_step, 1.01, 10.0));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("same_px", same_px));
  return CheckPositive("same_rad", same_rad);
}

absl::StatusOr<std::vector<ViewFindability>> PredictFindability(const ObjectModel& model, const CameraModel& camera,
                                                                const FindabilityOptions& options) {
  EVPOSE_RETURN_IF_ERROR(camera.Validate());
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  FindabilityPredictor predictor(model, camera, options);
  std::vector<ViewFindability> views;
  for (const Eigen::Vector3d& direction : EvenDirections(options.views.num_views)) {
    views.push_back(predictor.From(direction));
  }
  return views;
}

}  // namespace evpose

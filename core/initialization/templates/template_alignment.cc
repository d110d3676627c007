// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/templates/template_alignment.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "core/numerics/math.h"

namespace evpose {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// Distance, cells, up to which a sample meets an edge: about 2 % of the size of the object, the error of a pose between
// two views after its alignment.
constexpr double kHitCells = 3.0;
// An event is explained by an edge up to 1.5 cells away in each direction.
constexpr int kMarkedCells = 1;
// Standard deviation of a distance, cells, with the correlation of neighbouring samples.
constexpr double kSigmaCells = 3.0;
// Change of a pose in one alignment, one standard deviation: half the distance of two views, a tenth of the size.
constexpr double kRotationRad = 0.12;
constexpr double kShiftOfRadius = 0.2;
constexpr double kDepthRatio = 0.1;

}  // namespace

TemplateAligner::TemplateAligner(const EdgeDistanceMap& map, const CameraModel& camera, double object_radius_m,
                                 const Vector3d& object_centre)
    : map_(map), camera_(map.CameraOf(camera)), radius_m_(object_radius_m), centre_(object_centre) {}

bool TemplateAligner::Project(const RigidTransform& camera_from_object, const EdgeSample& sample, Image& image) const {
  image.arm = camera_from_object.rotation * sample.point;
  image.point = image.arm + camera_from_object.translation_m;
  if (!(image.point.z() > 1e-3 * radius_m_)) return false;
  image.at = camera_.Project(image.point);
  if (!(image.at.x() > -0.5 && image.at.y() > -0.5 && image.at.x() < map_.width() && image.at.y() < map_.height())) {
    return false;
  }
  const Vector3d along = camera_from_object.rotation * sample.along;
  const double per_m = 1.0 / image.point.z();
  image.along = {camera_.fx_px * per_m * (along.x() - along.z() * per_m * image.point.x()),
                 camera_.fy_px * per_m * (along.y() - along.z() * per_m * image.point.y())};
  image.bin = OrientationBin(image.along.x(), image.along.y());
  image.x = RoundNonNegative(image.at.x());
  image.y = RoundNonNegative(image.at.y());
  return true;
}

Vector6d TemplateAligner::RowOf(const Image& image, const Vector2d& normal) const {
  const double per_m = 1.0 / image.point.z();
  const double nx = normal.x() * camera_.fx_px * per_m, ny = normal.y() * camera_.fy_px * per_m;
  const Vector3d gradient(nx, ny, -(nx * image.point.x() + ny * image.point.y()) * per_m);
  Vector6d row;
  row.head<3>() = gradient;
  row.tail<3>() = image.arm.cross(gradient);  // gradient . (w x arm)
  return row;
}

const MapEdge* TemplateAligner::EdgeAt(const Image& image) const {
  const uint16_t nearest = map_.Nearest(image.bin, image.x, image.y);
  return nearest == EdgeDistanceMap::kNoEdge ? nullptr : &map_.edges()[nearest];
}

RigidTransform TemplateAligner::Align(RigidTransform camera_from_object, absl::Span<const EdgeSample> samples,
                                      double gate, double last_gate, int iterations, size_t stride) const {
  const double shrink = iterations > 1 ? (gate - last_gate) / (iterations - 1) : 0.0;
  for (int iteration = 0; iteration < iterations; ++iteration, gate -= shrink) {
    Matrix6d information = Matrix6d::Zero();
    Vector6d right_side = Vector6d::Zero();
    for (size_t i = 0; i < samples.size(); i += stride) {
      Image image;
      if (!Project(camera_from_object, samples[i], image)) continue;
      const MapEdge* edge = EdgeAt(image);
      if (edge == nullptr) continue;
      const Vector2d offset = edge->at.cast<double>() - image.at;
      const double of_gate = offset.squaredNorm() / (gate * gate);
      const double length = image.along.norm();
      if (of_gate >= 1.0 || !(length > 0.0)) continue;
      const Vector2d normal = Vector2d(-image.along.y(), image.along.x()) / length;
      const double weight = (1.0 - of_gate) * (1.0 - of_gate);  // Tukey
      const Vector6d row = RowOf(image, normal);
      information += weight * row * row.transpose();
      right_side += weight * normal.dot(offset) * row;
    }
    // The prior keeps what the edges do not determine: the turn is about the centre of the object, and the shift is
    // across or along the line of sight to it.
    const Vector3d arm = camera_from_object.rotation * centre_;
    const Vector3d sight = (arm + camera_from_object.translation_m).normalized();
    const double depth_m = (arm + camera_from_object.translation_m).norm();
    const Eigen::Matrix3d along_sight = sight * sight.transpose();
    const double across_weight = 1.0 / (kShiftOfRadius * kShiftOfRadius * radius_m_ * radius_m_);
    const double depth_weight = 1.0 / (kDepthRatio * kDepthRatio * depth_m * depth_m);
    const Eigen::Matrix3d shift =
        across_weight * (Eigen::Matrix3d::Identity() - along_sight) + depth_weight * along_sight;
    Eigen::Matrix<double, 3, 6> centre_motion;
    centre_motion << Eigen::Matrix3d::Identity(), -Hat(arm);
    const double variance = kSigmaCells * kSigmaCells;
    information += variance * centre_motion.transpose() * shift * centre_motion;
    information.bottomRightCorner<3, 3>().diagonal().array() += variance / (kRotationRad * kRotationRad);
    const Vector6d step = information.ldlt().solve(right_side);
    if (!step.allFinite()) return camera_from_object;
    camera_from_object = Perturb(camera_from_object, step);
  }
  return camera_from_object;
}

double TemplateAligner::Nearness(const RigidTransform& camera_from_object, absl::Span<const EdgeSample> samples) const {
  int sum = 0;
  for (const EdgeSample& sample : samples) {
    Image image;
    if (Project(camera_from_object, sample, image)) sum += map_.Nearness(image.bin, image.x, image.y);
  }
  return samples.empty() ? 0.0 : sum / (255.0 * static_cast<double>(samples.size()));
}

void TemplateAligner::Mark(const Image& image, std::vector<uint16_t>& directions) const {
  uint16_t bits = 0;
  for (int turn = -1; turn <= 1; ++turn) {
    bits |= static_cast<uint16_t>(1u << ((image.bin + turn + kOrientationBins) % kOrientationBins));
  }
  const int steps = std::clamp(static_cast<int>(image.along.norm()), 1, EdgeDistanceMap::kCellsOfBox);
  for (int step = -steps; step <= steps; ++step) {
    const Vector2d at = image.at + static_cast<double>(step) / steps * image.along;
    const int x = static_cast<int>(std::floor(at.x() + 0.5)), y = static_cast<int>(std::floor(at.y() + 0.5));
    for (int dy = -kMarkedCells; dy <= kMarkedCells; ++dy) {
      for (int dx = -kMarkedCells; dx <= kMarkedCells; ++dx) {
        if (map_.IsInside(x + dx, y + dy)) directions[map_.Place(x + dx, y + dy)] |= bits;
      }
    }
  }
}

AlignmentScore TemplateAligner::Score(const RigidTransform& camera_from_object, absl::Span<const EdgeSample> samples,
                                      const Vector6d& twist, double duration_s) const {
  // An edge that moves by less across itself has few events or none.
  constexpr double kLeastMotionPx = 0.5;
  // The directions of the samples near each cell, one bit for each bin.
  std::vector<uint16_t> directions(static_cast<size_t>(map_.width()) * map_.height(), 0);
  double hits = 0.0;
  int expected = 0;
  for (const EdgeSample& sample : samples) {
    Image image;
    if (!Project(camera_from_object, sample, image)) {
      ++expected;
      continue;
    }
    Mark(image, directions);
    const Vector2d normal = Vector2d(-image.along.y(), image.along.x()).normalized();
    const double motion_px = std::abs(RowOf(image, normal).dot(twist)) * duration_s * map_.cell_px();
    if (motion_px < kLeastMotionPx) continue;
    ++expected;
    const MapEdge* edge = EdgeAt(image);
    if (edge == nullptr) continue;
    const double of_reach = (edge->at.cast<double>() - image.at).squaredNorm() / (kHitCells * kHitCells);
    hits += std::max(0.0, 1.0 - of_reach);
  }
  double explained = 0.0;
  for (const MapEdge& edge : map_.edges()) {
    const int x = RoundNonNegative(edge.at.x()), y = RoundNonNegative(edge.at.y());
    if (map_.IsInside(x, y) && ((directions[map_.Place(x, y)] >> edge.bin) & 1) != 0) explained += edge.weight;
  }
  AlignmentScore score;
  if (expected > 0) score.hit_ratio = hits / expected;
  if (map_.edge_weight() > 0.0) score.explained_ratio = explained / map_.edge_weight();
  return score;
}

TwistEstimate TemplateAligner::EstimateTwist(const RigidTransform& camera_from_object,
                                             absl::Span<const EdgeSample> samples, const TwistPrior& prior) const {
  // Standard deviation of a measured normal flow: of the speed, and of an edge at rest. The second is relative to the
  // prior of the velocity, and keeps the weights finite.
  constexpr double kSpeedRatio = 0.2;
  constexpr double kAtRestOfPrior = 0.01;
  // Each iteration reduces the weights (Cauchy) of edges of something else further, and takes the time of all samples.
  constexpr int kIterations = 4;
  const double m_per_px = camera_from_object.translation_m.norm() / (camera_.fx_px * map_.cell_px());
  const double at_rest = kAtRestOfPrior * prior.velocity_px_per_s / map_.cell_px();
  TwistEstimate estimate;
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    TwistEquations equations;
    equations.AddPrior(prior, m_per_px);
    for (const EdgeSample& sample : samples) {
      Image image;
      if (!Project(camera_from_object, sample, image)) continue;
      const MapEdge* edge = EdgeAt(image);
      if (edge == nullptr || (edge->at.cast<double>() - image.at).squaredNorm() > kHitCells * kHitCells) continue;
      const Vector2d normal = Vector2d(-image.along.y(), image.along.x()).normalized();
      const double measured = normal.dot(edge->flow.cast<double>());
      const double sigma = kSpeedRatio * std::abs(measured) + at_rest;
      const Vector6d row = RowOf(image, normal);
      // Student's t with one degree of freedom: an edge of something else moves at any speed.
      const double error = (measured - row.dot(estimate.twist)) / sigma;
      const double robust = iteration == 0 ? 1.0 : 1.0 / (1.0 + error * error);
      equations.Add(row, measured, robust / (sigma * sigma));
    }
    estimate = equations.Solve();
  }
  return estimate;
}

}  // namespace evpose

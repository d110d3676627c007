// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/templates/template_scan.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/base/yield_point.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

using Eigen::Vector2f;

// Turns of the coarse scan: every second one, 15 degrees; and the points that it looks at: every third one.
constexpr int kCoarseTurnStep = 2;
constexpr size_t kCoarseStride = 3;
// Placements of the coarse scan that the fine scan refines. The time of the fine scan is proportional to it; with
// fewer, the right view may be lost, because the coarse scan sees a third of the points.
constexpr size_t kKept = 400;
// Largest ratio of the aspect ratios of the box and of a template that fills it: an edge that moves along itself has no
// events, so that a box may lack a part of the object.
constexpr float kMaxAspectRatio = 1.6f;
// Least and largest ratio of the size of a partly hidden object to that of the box. Below the least one the template is
// placed as one that fills the box. Beyond the largest one too few edges are visible.
constexpr float kMinHidden = 1.15f;
constexpr float kMaxHidden = 2.5f;

void KeepBest(size_t count, std::vector<TemplatePlacement>& placements) {
  std::stable_sort(placements.begin(), placements.end(),
                   [](const TemplatePlacement& a, const TemplatePlacement& b) { return a.score > b.score; });
  if (placements.size() > count) placements.resize(count);
}

}  // namespace

float TemplateScanner::ScoreOf(const EdgeDistanceMap& map, const TemplatePlacement& placement, size_t stride) const {
  const std::vector<TemplatePoint>& points = model_.views()[placement.view].points;
  const TemplateTurn unit = TemplateTurn::At(placement.turn);
  const TemplateTurn turn{placement.cells_per_radius * unit.sin, placement.cells_per_radius * unit.cos};
  const Vector2f centre = placement.centre.array() + 0.5f;
  constexpr int kStepsOfBin = kTemplateTurns / kOrientationBins;
  int sum = 0, count = 0;
  for (size_t i = stride / 2; i < points.size(); i += stride, ++count) {
    const Vector2f at = centre + turn * points[i].at;
    const int bin = (points[i].direction + 2 * placement.turn) % kTemplateTurns / kStepsOfBin;
    // Truncation towards zero: a negative coordinate of less than one cell counts as inside.
    sum += map.Nearness(bin, static_cast<int>(at.x()), static_cast<int>(at.y()));
  }
  return count > 0 ? static_cast<float>(sum) / (255.0f * static_cast<float>(count)) : 0.0f;
}

void TemplateScanner::AppendPlacements(const EdgeDistanceMap& map, int view, int turn, size_t stride,
                                       std::vector<TemplatePlacement>& placements) const {
  const TemplateExtent& extent = model_.views()[view].extents[turn];
  const Vector2f low = map.ToCells(map.box().low_px).cast<float>(), high = map.ToCells(map.box().high_px).cast<float>();
  const Vector2f box = high - low, size = extent.high - extent.low;
  if (!(box.minCoeff() > 0.0f) || !(size.minCoeff() > 0.0f)) return;
  const auto append = [&](float scale, const Vector2f& centre_of_extent) {
    TemplatePlacement placement{view, turn, centre_of_extent - 0.5f * scale * (extent.low + extent.high), scale, 0.0f};
    placement.score = ScoreOf(map, placement, stride);
    placements.push_back(placement);
  };
  const Vector2f middle = 0.5f * (low + high);
  const Vector2f fill = box.cwiseQuotient(size);  // scales at which width and height are those of the box
  if (fill.maxCoeff() < kMaxAspectRatio * fill.minCoeff()) append(std::sqrt(fill.x() * fill.y()), middle);
  // One side is hidden: across it the object is larger than the box.
  for (int axis = 0; axis < 2; ++axis) {
    const float scale = fill[1 - axis], length = scale * size[axis];
    if (length < kMinHidden * box[axis] || length > kMaxHidden * box[axis]) continue;
    Vector2f centre = middle;
    centre[axis] = low[axis] + 0.5f * length;
    append(scale, centre);
    centre[axis] = high[axis] - 0.5f * length;
    append(scale, centre);
  }
}

std::vector<TemplatePlacement> TemplateScanner::Scan(const EdgeDistanceMap& map, size_t count) const {
  const std::vector<ViewTemplate>& views = model_.views();
  const int num_turns = model_.num_turns();
  std::vector<TemplatePlacement> coarse;
  for (int view = 0; view < model_.num_coarse(); ++view) {
    YieldPoint();
    for (int turn = 0; turn < num_turns; turn += kCoarseTurnStep) {
      AppendPlacements(map, view, turn, kCoarseStride, coarse);
    }
  }
  KeepBest(kKept, coarse);
  // Which views and turns to look at; one may be near to several coarse ones.
  std::vector<bool> is_chosen(views.size() * num_turns, false);
  for (size_t view = 0; view < views.size(); ++view) {
    YieldPoint();
    for (const TemplatePlacement& placement : coarse) {
      if (placement.view != views[view].parent) continue;
      for (int turn = 1 - kCoarseTurnStep; turn < kCoarseTurnStep; ++turn) {
        const int of_view = placement.turn + views[view].parent_turn + turn;
        is_chosen[view * num_turns + static_cast<size_t>((of_view + num_turns) % num_turns)] = true;
      }
    }
  }
  std::vector<TemplatePlacement> fine;
  for (size_t i = 0; i < is_chosen.size(); ++i) {
    YieldPoint(i);
    if (!is_chosen[i]) continue;
    AppendPlacements(map, static_cast<int>(i) / num_turns, static_cast<int>(i) % num_turns, 1, fine);
  }
  KeepBest(count, fine);
  return fine;
}

RigidTransform TemplateScanner::PoseOf(const TemplatePlacement& placement, const EdgeDistanceMap& map,
                                       const CameraModel& camera) const {
  const CameraModel of_map = map.CameraOf(camera);
  const Eigen::Vector3d bearing = BearingOf(of_map, placement.centre.cast<double>());
  const double depth_m = of_map.MaxFocalPx() * model_.radius_m() / placement.cells_per_radius;
  // The template shows the object at the optical axis: turned so that the line of sight to the centre is that axis.
  const Eigen::Vector3d sight = bearing.normalized();
  const Eigen::Vector3d axis = Eigen::Vector3d::UnitZ().cross(sight);
  const double angle_rad = DeterministicAtan2(axis.norm(), sight.z());
  const Eigen::Matrix3d to_sight =
      axis.norm() > 0.0 ? ExpSo3(angle_rad / axis.norm() * axis) : Eigen::Matrix3d(Eigen::Matrix3d::Identity());
  const auto [sin, cos] = DeterministicSinCos(2.0 * std::numbers::pi / kTemplateTurns * placement.turn);
  Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();
  turn.topLeftCorner<2, 2>() << cos, -sin, sin, cos;
  const Eigen::Matrix3d rotation = to_sight * turn * model_.views()[placement.view].rotation;
  return {rotation, depth_m * bearing - rotation * model_.centre()};
}

}  // namespace evpose

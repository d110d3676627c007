// SPDX-License-Identifier: Apache-2.0
#include "core/contours/curve_levels.h"

#include <algorithm>

#include "core/base/yield_point.h"
#include "core/contours/polyline.h"

namespace evpose {
namespace {

// Level 0 is for an object that is 3000 pixels wide, wider than the image of any event camera. The levels above it are
// for pixels that are larger by this factor each: a larger one makes the chords finer than a view needs, a smaller one
// changes the level, and with it the elements, more often.
constexpr double kFinestPixel = 1.0 / 3000.0;
constexpr double kLevelRatio = 1.5;
// A tessellated curve turns by less at a point, 40 degrees; where it turns by more it has a corner.
constexpr double kLeastSmoothCosine = 0.766;
// The segments of a tessellated arc are nearly equal; beside one that is longer by this factor the curve is straight.
constexpr double kMaxLengthRatio = 2.0;

// Unit directions of a curve at its points: that of the chord between the neighbours. Zero at a corner, and where a
// straight part begins.
std::vector<Eigen::Vector3d> TangentsOf(const EdgeCurve& curve) {
  const size_t count = curve.points.size();
  std::vector<Eigen::Vector3d> tangents(count, Eigen::Vector3d::Zero());
  const auto step = [&](size_t segment) { return Eigen::Vector3d(curve.points[segment + 1] - curve.points[segment]); };
  for (size_t i = 0; i < count; ++i) {
    if ((i == 0 || i + 1 == count) && !curve.is_ring()) continue;
    const Eigen::Vector3d before = step(i == 0 ? count - 2 : i - 1), after = step(i + 1 == count ? 0 : i);
    const double before_m = before.norm(), after_m = after.norm();
    if (std::max(before_m, after_m) > kMaxLengthRatio * std::min(before_m, after_m)) continue;
    if (before.dot(after) < kLeastSmoothCosine * before_m * after_m) continue;
    tangents[i] = (before / before_m + after / after_m).normalized();
  }
  return tangents;
}

// Mean position of the arc between two points of a smooth curve relative to the middle of its chord
// (core/contours/README.md, equation (10)). A tangent that is not known is the mirror image of the other one.
Eigen::Vector3d MeanOfArc(const Eigen::Vector3d& chord, const Eigen::Vector3d& tangent1,
                          const Eigen::Vector3d& tangent2) {
  const double length_m = chord.norm();
  if ((tangent1.isZero() && tangent2.isZero()) || !(length_m > 0.0)) return Eigen::Vector3d::Zero();
  const Eigen::Vector3d along = chord / length_m;
  const auto mirror = [&](const Eigen::Vector3d& t) { return Eigen::Vector3d(2.0 * t.dot(along) * along - t); };
  const Eigen::Vector3d begin = tangent1.isZero() ? mirror(tangent2) : tangent1;
  const Eigen::Vector3d end = tangent2.isZero() ? mirror(tangent1) : tangent2;
  return -length_m / 12.0 * (end - begin);
}

}  // namespace

double PixelSizeOfLevel(int level) {
  double size = kFinestPixel;
  for (int i = 0; i < level; ++i) size *= kLevelRatio;
  return size;
}

CurveLevels::CurveLevels(const ObjectModel& model, double sagitta_px) : model_(model) {
  std::vector<double> errors;
  for (std::vector<std::vector<uint32_t>>& cuts : cuts_) cuts.resize(model.curves.size());
  for (size_t c = 0; c < model.curves.size(); ++c) {
    YieldPoint(c);
    const EdgeCurve& curve = model.curves[c];
    // Without a curved surface the facets of the mesh are those of the object, and the curve is its polyline.
    const std::vector<Eigen::Vector3d> tangents =
        model.surface.empty() ? std::vector<Eigen::Vector3d>(curve.points.size(), Eigen::Vector3d::Zero())
                              : TangentsOf(curve);
    std::vector<Integral>& integrals = integrals_.emplace_back(curve.points.size());
    for (size_t i = 1; i < curve.points.size(); ++i) {
      const Eigen::Vector3d chord = curve.points[i] - curve.points[i - 1];
      const double length_m = chord.norm();
      const Eigen::Vector3d mean =
          0.5 * (curve.points[i] + curve.points[i - 1]) + MeanOfArc(chord, tangents[i - 1], tangents[i]);
      integrals[i].length_m = integrals[i - 1].length_m + length_m;
      integrals[i].position = integrals[i - 1].position + length_m * (mean - curve.points[0]);
    }
    FindCutErrors(absl::MakeConstSpan(curve.points), sagitta_px * PixelSizeOfLevel(0) * model.diameter_m, errors);
    for (int level = 0; level < kNumDetailLevels; ++level) {
      const double tolerance_m = sagitta_px * PixelSizeOfLevel(level) * model.diameter_m;
      for (uint32_t i = 0; i < errors.size(); ++i) {
        if (i == 0 || i + 1 == errors.size() || errors[i] > tolerance_m) cuts_[level][c].push_back(i);
      }
    }
  }
}

EdgeElement CurveLevels::MakeChord(size_t curve, uint32_t first, uint32_t last) const {
  const EdgeCurve& edge = model_.curves[curve];
  const Integral& begin = integrals_[curve][first];
  const Integral& end = integrals_[curve][last];
  EdgeElement element;
  element.kind = edge.kind;
  element.curve = static_cast<uint32_t>(model_.lines.size() + curve);
  element.p1 = edge.points[first];
  element.p2 = edge.points[last];
  const size_t middle = std::min<size_t>(first + (last - first) / 2, edge.face_normals.size() - 1);
  element.normals = edge.face_normals[middle];
  const Eigen::Vector3d along = element.p2 - element.p1;
  const double length2 = along.squaredNorm(), length_m = end.length_m - begin.length_m;
  if (!(length2 > 0.0) || !(length_m > 0.0)) return element;
  // The chord is moved to the mean position of the arc (core/contours/README.md, equation (9)).
  Eigen::Vector3d offset =
      edge.points[0] + (end.position - begin.position) / length_m - 0.5 * (element.p1 + element.p2);
  offset -= offset.dot(along) / length2 * along;
  element.p1 += offset;
  element.p2 += offset;
  return element;
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/models/smooth_curve.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <utility>

#include "core/mesh/facet_graph.h"
#include "core/models/circle_fit.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

// Largest distance of a vertex from a circle, relative to the diameter: 0.15 px at an object size of 300 px, as for the
// shapes of regions (core/mesh/shape_fit.cc).
constexpr double kArcDistance = 5e-4;
// Sagitta of the segments, relative to the diameter: 0.06 px of an object that is 3000 px wide.
constexpr double kArcSagitta = 2e-5;
// A vertex at which the chords turn by more (rad, 40 degrees) is a corner, as in core/contours/curve_levels.cc.
constexpr double kMaxArcTurn = 0.7;
// A chord that is longer than its neighbours by this factor is a straight part, as there.
constexpr double kMaxArcLengthRatio = 2.0;
// An arc between two vertices of a curve turns by about 2 kMaxArcTurn at most.
constexpr double kMaxArcPieces = 64.0;

// The arc over a chord: the direction from the chord to the arc times half of the angle of the arc.
using Bend = Eigen::Vector3d;

// The part of `v` perpendicular to the chord, with the given length; zero if there is none.
Bend AcrossChord(const Eigen::Vector3d& v, const Eigen::Vector3d& chord, double length) {
  const Eigen::Vector3d across = v - v.dot(chord) / chord.squaredNorm() * chord;
  const double norm = across.norm();
  return norm > 0.0 ? Bend(across * (length / norm)) : Bend::Zero();
}

// Returns the bend of the circle about a centre, whose radius need not be exactly that of the ends of the chord.
Bend BendAbout(const Circle& circle, const Eigen::Vector3d& p, const Eigen::Vector3d& q) {
  const Eigen::Vector3d away = 0.5 * (p + q) - circle.centre;
  const Eigen::Vector3d in_plane = away - away.dot(circle.axis) * circle.axis;
  return AcrossChord(in_plane, q - p, DeterministicAtan2(0.5 * (q - p).norm(), in_plane.norm()));
}

// Returns the bend of the circle through a third point, before p or after q: the inscribed angle there is half of that
// of the arc.
Bend BendThrough(const Eigen::Vector3d& p, const Eigen::Vector3d& q, const Eigen::Vector3d& third) {
  return AcrossChord(p - third, q - p, AngleBetween(p - third, q - third));
}

// The point of the arc at the fraction t of its angle.
Eigen::Vector3d PointOfArc(const Eigen::Vector3d& p, const Eigen::Vector3d& q, const Bend& bend, double t) {
  constexpr double kStraight = 1e-9;  // radians; below it the arc is its chord to rounding
  const Eigen::Vector3d chord = q - p;
  const double half = bend.norm();
  if (half < kStraight) return p + t * chord;
  const auto [sin_half, cos_half] = DeterministicSinCos(half);
  const auto [sin, cos] = DeterministicSinCos((2.0 * t - 1.0) * half);
  const double radius_m = 0.5 * chord.norm() / sin_half;
  return 0.5 * (p + q) + 0.5 * sin / sin_half * chord + radius_m * (cos - cos_half) / half * bend;
}

class ChainSmoother {
 public:
  ChainSmoother(absl::Span<const Eigen::Vector3d> vertices, double diameter_m, const std::optional<Circle>& circle)
      : vertices_(vertices),
        count_(vertices.size() - 1),
        is_ring_(count_ > 2 && vertices.front() == vertices.back()),
        is_circle_known_(circle.has_value()),
        sagitta_m_(kArcSagitta * diameter_m),
        circle_(circle.has_value() ? circle : FitCircle(vertices, kArcDistance * diameter_m)) {}

  SmoothCurve Smooth(size_t& max_inserted) const {
    std::vector<size_t> pieces;
    size_t inserted = 0;
    for (size_t k = 0; k < count_; ++k) {
      pieces.push_back(PiecesOf(k, BendsOf(k)));
      inserted += pieces.back() - 1;
    }
    const bool may_insert = inserted <= max_inserted;
    if (may_insert) max_inserted -= inserted;
    SmoothCurve curve;
    curve.points.push_back(vertices_[0]);
    for (size_t k = 0; k < count_; ++k) {
      const std::array<Bend, 2> bends = BendsOf(k);
      for (size_t i = 1; may_insert && i < pieces[k]; ++i) {
        const double t = static_cast<double>(i) / static_cast<double>(pieces[k]);
        const Bend bend = (1.0 - t) * bends[0] + t * bends[1];
        curve.points.push_back(PointOfArc(vertices_[k], vertices_[k + 1], bend, t));
        curve.chord_of.push_back(static_cast<uint32_t>(k));
      }
      curve.points.push_back(vertices_[k + 1]);
      curve.chord_of.push_back(static_cast<uint32_t>(k));
    }
    return curve;
  }

 private:
  // Returns the next or the previous chord; nullopt beyond an end of the chain.
  std::optional<size_t> Neighbour(size_t chord, bool is_next) const {
    if (is_next)
      return chord + 1 < count_ ? std::optional(chord + 1) : is_ring_ ? std::optional(size_t{0}) : std::nullopt;
    return chord > 0 ? std::optional(chord - 1) : is_ring_ ? std::optional(count_ - 1) : std::nullopt;
  }
  Eigen::Vector3d Vector(size_t chord) const { return vertices_[chord + 1] - vertices_[chord]; }

  // Whether an arc over the chord `here` may continue beyond the vertex between two chords. If the vertices determine
  // the circle without the other chord, that may be a straight part.
  bool IsSmooth(size_t here, size_t there) const {
    const double here_m = Vector(here).norm(), there_m = Vector(there).norm();
    return AngleBetween(Vector(here), Vector(there)) <= kMaxArcTurn && here_m <= kMaxArcLengthRatio * there_m &&
           (circle_.has_value() || there_m <= kMaxArcLengthRatio * here_m);
  }

  // The arcs at both ends of a chord, between which the curve changes over: on a circle both are the same.
  std::array<Bend, 2> BendsOf(size_t chord) const {
    const Eigen::Vector3d &p = vertices_[chord], &q = vertices_[chord + 1];
    const std::optional<size_t> before = Neighbour(chord, false), after = Neighbour(chord, true);
    const bool has_before = before.has_value() && IsSmooth(chord, *before);
    const bool has_after = after.has_value() && IsSmooth(chord, *after);
    std::array<Bend, 2> bends = {Bend::Zero(), Bend::Zero()};
    if (!(p != q) || (!is_circle_known_ && !has_before && !has_after)) return bends;
    if (circle_.has_value()) {
      bends.fill(BendAbout(*circle_, p, q));
      return bends;
    }
    if (has_before) bends[0] = BendThrough(p, q, vertices_[*before]);
    if (has_after) bends[1] = BendThrough(p, q, vertices_[*after + 1]);
    if (!has_before) bends[0] = bends[1];
    if (!has_after) bends[1] = bends[0];
    if (bends[0].dot(bends[1]) < 0.0) bends.fill(Bend::Zero());
    return bends;
  }

  size_t PiecesOf(size_t chord, const std::array<Bend, 2>& bends) const {
    const double half = std::max(bends[0].norm(), bends[1].norm());
    // The sagitta of the chord is length half / 4 for small angles; that of n pieces is smaller by n^2.
    const double pieces = std::ceil(std::sqrt(0.25 * Vector(chord).norm() * half / sagitta_m_));
    return static_cast<size_t>(std::clamp(pieces, 1.0, kMaxArcPieces));
  }

  const absl::Span<const Eigen::Vector3d> vertices_;
  const size_t count_;  // chords
  const bool is_ring_;
  const bool is_circle_known_;
  const double sagitta_m_;
  const std::optional<Circle> circle_;
};

}  // namespace

SmoothCurve SmoothChain(absl::Span<const Eigen::Vector3d> vertices, double diameter_m, size_t& max_inserted,
                        const std::optional<EdgeCircle>& circle) {
  return ChainSmoother(vertices, diameter_m, circle).Smooth(max_inserted);
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/rotation_search.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <deque>
#include <functional>
#include <utility>
#include <vector>

#include "core/base/yield_point.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// Number of rotations in half a turn of the sweep: steps of 1.5 degrees, half of which is 0.013 rad
// (RotationSearchOptions::sweep_sigma_rad).
constexpr int kHalfCircleSteps = 120;
// Every second rotation of a flat valley is kept (RotationSearchOptions::valley_cost_ratio); the steps between them
// are within the range of the refinement.
constexpr int kValleyStride = 2;
// Gauss-Newton steps. The start is within 0.01 rad, where the cost is nearly quadratic.
constexpr int kRefineIterations = 3;
// Number of minima of the sweeps that are refined for each requested candidate: refinement makes many of them equal.
constexpr size_t kRefinedPerCandidate = 3;
// Smallest squared sine of the angle between the first direction and the second segment's normal; below it the second
// direction is not determined.
constexpr double kMinSine2 = 1e-6;
constexpr float kNoCost = 1e9f;  // above any cost of up to 64 segments

// The normals of the segments as a structure of arrays, to score many rotations.
class Scorer {
 public:
  static constexpr int kMaxSegments = 64;  // the largest PoseSearchOptions::max_segments

  Scorer(absl::Span<const SearchSegment> segments, const RotationSearchOptions& options)
      : count_(static_cast<int>((std::min<size_t>(segments.size(), kMaxSegments) + 3) / 4 * 4)),
        cap_(static_cast<float>(options.max_segment_cost)),
        sweep_variance_(static_cast<float>(options.sweep_sigma_rad * options.sweep_sigma_rad)) {
    turn_variance_.setConstant(1.0f);
    Vector3d sight = Vector3d::Zero();
    x_.setZero();
    y_.setZero();
    z_.setZero();
    for (int j = 0; j < std::min<int>(segments.size(), kMaxSegments); ++j) {
      x_[j] = static_cast<float>(segments[j].normal.x());
      y_[j] = static_cast<float>(segments[j].normal.y());
      z_[j] = static_cast<float>(segments[j].normal.z());
      turn_variance_[j] = static_cast<float>(segments[j].turn_variance);
      sight += segments[j].sight;
    }
    sight_ = sight.normalized().cast<float>();
  }

  // `directions` are in the camera frame. A direction along the line of sight is determined by the position of a
  // segment instead of its orientation, and the position is accurate: the angular uncertainty of the segment counts
  // only by the component of the direction across the line of sight.
  float Cost(const std::vector<Eigen::Vector3f>& directions) {
    auto best = best_.head(count_);
    best.setConstant(cap_);
    for (const Eigen::Vector3f& d : directions) {
      const float along_sight = d.dot(sight_);
      const float across2 = std::max(0.0f, 1.0f - along_sight * along_sight);
      best = best.min((x_.head(count_) * d.x() + y_.head(count_) * d.y() + z_.head(count_) * d.z()).square() /
                      (turn_variance_.head(count_) * across2 + sweep_variance_));
    }
    return best.sum();
  }

 private:
  using Row = Eigen::Array<float, kMaxSegments, 1>;
  const int count_;
  const float cap_;
  const float sweep_variance_;
  Eigen::Vector3f sight_;  // to the centre of the segments
  Row x_, y_, z_, turn_variance_, best_;
};

using SweepAngles = std::array<SinCos, size_t{2} * kHalfCircleSteps>;

// Sine and cosine of the angles of a sweep.
const SweepAngles& Sweep() {
  static const SweepAngles kAngles = [] {
    SweepAngles angles;
    for (size_t i = 0; i < angles.size(); ++i) angles[i] = DeterministicSinCos(M_PI * i / kHalfCircleSteps);
    return angles;
  }();
  return kAngles;
}

class RotationSearch {
 public:
  RotationSearch(const SearchModel& model, absl::Span<const SearchSegment> segments,
                 const RotationSearchOptions& options)
      : model_(model), segments_(segments), options_(options), scorer_(segments, options) {
    for (const Vector3d& v : model.directions()) directions_.push_back(v.cast<float>());
    turned_.resize(directions_.size());
    for (const Matrix3d& q : model.direction_symmetries()) symmetries_.emplace_back(q);
  }

  std::vector<RotationCandidate> Run() {
    for (const auto& [i, j, pair] : SweepOrder()) {
      if (budget_ <= 0) break;
      SweepPair(segments_[i].normal, segments_[j].normal, model_.pairs()[pair]);
    }
    return RefineBest();
  }

 private:
  struct Work {
    int i, j, pair;
  };

  // Returns the pairs of segments and of directions to be swept. Long segments and informative pairs of directions come
  // first. A pair of directions is tried on each pair of segments in both orders, unless a symmetry makes the orders
  // equal (the pair is then listed once).
  std::vector<Work> SweepOrder() const {
    const int count = static_cast<int>(segments_.size());
    const int num_pairs = static_cast<int>(model_.pairs().size());
    std::vector<Work> order;
    const int max_work = options_.max_rotations / kHalfCircleSteps + 1;
    // In the order of the sum of the ranks of both segments and of the pair of directions.
    for (int rank = 1; rank < 2 * count + num_pairs && static_cast<int>(order.size()) < max_work; ++rank) {
      for (int i = 0; i < count; ++i) {
        for (int j = i + 1; j < count && i + j <= rank; ++j) {
          const int pair = rank - i - j;
          if (pair < num_pairs) order.push_back({i, j, pair});
        }
      }
    }
    return order;
  }

  // Scores the rotations that map direction a of the pair into the plane of the first segment and direction b into that
  // of the second one, and keeps the minima.
  void SweepPair(const Vector3d& n1, const Vector3d& n2, const DirectionPair& pair) {
    const Vector3d e1 = n1.unitOrthogonal(), e2 = n1.cross(e1);
    const int steps = pair.needs_half_circle ? kHalfCircleSteps : 2 * kHalfCircleSteps;
    const double sine = std::sqrt(std::max(0.0, 1.0 - pair.cosine * pair.cosine));
    for (const double sign : {1.0, -1.0}) {
      if (sign < 0.0 && pair.has_one_solution) break;
      // The costs one and two steps ago; a minimum is detected one step late.
      float before = kNoCost, last = kNoCost;
      Matrix3d last_rotation = Matrix3d::Identity();
      for (int step = 0; step < steps; ++step) {
        YieldPoint(static_cast<size_t>(step));
        const auto& [sin, cos] = Sweep()[step];
        const Vector3d d = cos * e1 + sin * e2;
        const Vector3d p = n2.cross(d);
        const double s2 = p.squaredNorm();
        float cost = kNoCost;
        Matrix3d rotation = Matrix3d::Identity();
        if (s2 > pair.cosine * pair.cosine && s2 > kMinSine2) {
          // R v_b = x (d in n2's plane) + y (orthogonal to it), such that its angle with d is right.
          const double x = pair.cosine / s2, y = sign * std::sqrt(1.0 / s2 - x * pair.cosine / s2);
          const Vector3d f = x * (d - d.dot(n2) * n2) + y * p;
          rotation = Rotation(d, (f - pair.cosine * d) / sine, pair);
          cost = Score(rotation);
        }
        const bool is_minimum = last <= before && last < cost;
        if (is_minimum || (step % kValleyStride == 0 && last < best_ + valley_)) Keep(last, last_rotation);
        before = last;
        last = cost;
        last_rotation = rotation;
      }
      if (last < before) Keep(last, last_rotation);
    }
  }

  static Matrix3d Rotation(const Vector3d& a, const Vector3d& b, const DirectionPair& pair) {
    Matrix3d frame;
    frame.col(0) = a;
    frame.col(1) = b;
    frame.col(2) = a.cross(b);
    return frame * pair.frame.transpose();
  }

  float Score(const Matrix3d& rotation) {
    --budget_;
    const Eigen::Matrix3f r = rotation.cast<float>();
    for (size_t i = 0; i < directions_.size(); ++i) turned_[i] = r * directions_[i];
    return scorer_.Cost(turned_);
  }

  void Keep(float cost, const Matrix3d& rotation) {
    best_ = std::min(best_, cost);
    kept_.push_back({rotation, cost});
  }

  // Gauss-Newton on the truncated cost, with the uncertainty of each segment about its assigned direction. A prior
  // keeps the result close to the rotation of the sweep: the segments of a flat object leave its tilt almost
  // undetermined, and then all rotations of the flat valley must be examined instead of the minimum that noise selects.
  RotationCandidate RefineRotation(RotationCandidate candidate) const {
    for (int iteration = 0;; ++iteration) {
      Matrix3d h = Matrix3d::Identity() / (options_.prior_rad * options_.prior_rad);
      Vector3d g = Vector3d::Zero();
      candidate.cost = 0.0;
      const double sigma_rad = iteration == 0 ? options_.sweep_sigma_rad : options_.refined_sigma_rad;
      const double rotation_variance = sigma_rad * sigma_rad;
      for (const SearchSegment& segment : segments_) {
        double least = options_.max_segment_cost;
        Vector3d row = Vector3d::Zero();
        double residual = 0.0;
        for (const Vector3d& v : model_.directions()) {
          const Vector3d d = candidate.rotation * v;
          const double sine = segment.normal.dot(d);
          const double variance = segment.Variance(d) + rotation_variance;
          if (sine * sine >= least * variance) continue;
          least = sine * sine / variance;
          const double scale = 1.0 / std::sqrt(variance);
          residual = sine * scale;
          row = d.cross(segment.normal) * scale;  // n . (dtheta x d) = dtheta . (d x n)
        }
        candidate.cost += least < options_.max_segment_cost ? least : options_.unexplained_cost;
        h += row * row.transpose();
        g += row * residual;
      }
      if (iteration == kRefineIterations) return candidate;
      candidate.rotation = ExpSo3(-h.ldlt().solve(g)) * candidate.rotation;
    }
  }

  // Returns the quaternion nearest to the identity among those that the symmetries of the directions make equivalent.
  // Nearly equal rotations at a border may get different ones; then both are tried.
  Eigen::Vector4d Canonical(const Matrix3d& rotation) const {
    const Eigen::Quaterniond q(rotation);
    Eigen::Vector4d best = q.coeffs();
    for (const Eigen::Quaterniond& symmetry : symmetries_) {
      const Eigen::Vector4d other = (q * symmetry).coeffs();
      if (std::abs(other.w()) > std::abs(best.w())) best = other;
    }
    return best.w() < 0.0 ? Eigen::Vector4d(-best) : best;
  }

  // Returns the candidates without duplicates, the cheapest one of each, in order of cost and at most `max_count`. Of
  // equal costs, the first candidate comes first.
  std::vector<RotationCandidate> CheapestDistinct(const auto& candidates, size_t max_count) const {
    // A heap, because a sort of all candidates takes milliseconds without a yield point, and few are taken.
    std::vector<std::pair<double, uint32_t>> heap;
    heap.reserve(candidates.size());
    for (const RotationCandidate& candidate : candidates) {
      YieldPoint(heap.size());
      heap.emplace_back(candidate.cost, static_cast<uint32_t>(heap.size()));
    }
    std::make_heap(heap.begin(), heap.end(), std::greater<>());
    // The dot product of two quaternions is the cosine of half the angle.
    const double least_dot = 1.0 - options_.same_rotation_rad * options_.same_rotation_rad / 8.0;
    std::vector<Eigen::Vector4d> taken;
    std::vector<RotationCandidate> distinct;
    while (!heap.empty() && distinct.size() < max_count) {
      YieldPoint();
      std::pop_heap(heap.begin(), heap.end(), std::greater<>());
      const RotationCandidate& candidate = candidates[heap.back().second];
      heap.pop_back();
      const Eigen::Vector4d q = Canonical(candidate.rotation);
      const auto is_near = [&](const Eigen::Vector4d& other) { return std::abs(other.dot(q)) > least_dot; };
      if (std::any_of(taken.begin(), taken.end(), is_near)) continue;
      taken.push_back(q);
      distinct.push_back(candidate);
    }
    return distinct;
  }

  // Refines the cheapest rotations of all sweeps.
  std::vector<RotationCandidate> RefineBest() const {
    std::vector<RotationCandidate> refined = CheapestDistinct(kept_, kRefinedPerCandidate * options_.max_candidates);
    for (RotationCandidate& candidate : refined) {
      YieldPoint();
      candidate = RefineRotation(candidate);
    }
    return CheapestDistinct(refined, options_.max_candidates);
  }

  const SearchModel& model_;
  const absl::Span<const SearchSegment> segments_;
  const RotationSearchOptions& options_;
  Scorer scorer_;
  int budget_ = options_.max_rotations;
  float best_ = kNoCost;
  const float valley_ =
      static_cast<float>(options_.max_segment_cost * (model_.directions().size() == 2 ? options_.flat_valley_cost_ratio
                                                                                      : options_.valley_cost_ratio));
  std::vector<Eigen::Quaterniond> symmetries_;  // symmetries of the directions
  std::vector<Eigen::Vector3f> directions_, turned_;
  std::deque<RotationCandidate> kept_;  // grows without copies: there may be tens of thousands
};

}  // namespace

std::vector<RotationCandidate> FindRotations(const SearchModel& model, absl::Span<const SearchSegment> segments,
                                             const RotationSearchOptions& options) {
  if (segments.size() < 2 || model.pairs().empty()) return {};
  return RotationSearch(model, segments, options).Run();
}

}  // namespace evpose

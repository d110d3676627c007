// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/aspnl.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/baselines/first_pose/p3l.h"

namespace evpose {
namespace {

// Two for the mirror pose of a plane, and as many that are better before the refinement.
constexpr int kMaxRefined = 4;
constexpr int kRefinementIterations = 10;  // Gauss-Newton converges in three to five

struct Candidate {
  RigidTransform pose;
  double residual_px;
};

struct PlaneAndDirection {
  // Normal times the length of the segment relative to the longest one: the noise of its direction is inverse to it.
  Eigen::Vector3d normal;
  Eigen::Vector3d direction;
};

// Sorts the lines: the longest one, then the longest one that is not parallel to it, then the rest. Returns false if
// all are parallel.
bool OrderLines(absl::Span<const LineMatch> matches, const CameraModel& camera, std::vector<PlaneAndDirection>& lines) {
  constexpr double kParallelSine = 0.02;  // about 1 deg; with less, the second line gives no information
  std::vector<size_t> order(matches.size());
  for (size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::stable_sort(order.begin(), order.end(),
                   [&](size_t a, size_t b) { return matches[a].segment.length_px() > matches[b].segment.length_px(); });
  const double longest_px = matches[order[0]].segment.length_px();
  for (const size_t i : order) {
    const Eigen::Vector3d normal = BackProjectedNormal(camera, matches[i].segment);
    const Eigen::Vector3d direction = (matches[i].p2 - matches[i].p1).normalized();
    if (normal.isZero() || !(direction.norm() > 0.5)) continue;
    lines.push_back({matches[i].segment.length_px() / longest_px * normal, direction});
  }
  const auto second = std::find_if(lines.begin(), lines.end(), [&](const PlaneAndDirection& line) {
    return line.direction.cross(lines[0].direction).norm() > kParallelSine;
  });
  if (lines.size() < 3 || second == lines.end()) return false;
  std::rotate(lines.begin() + 1, second, second + 1);
  return true;
}

// Sum of the squared polynomials of the triples, divided by the power of 1 + t^2 that makes it a function of the angle.
double Cost(const std::vector<P3lConstraint>& constraints, double alpha_rad) {
  double cost = 0.0;
  for (size_t i = 1; i < constraints.size(); ++i) {
    const double value = ConstraintOfAlpha(constraints[0], constraints[i], alpha_rad);
    cost += value * value;
  }
  return cost;
}

// Local minima of the cost. For a box they are multiple roots of its derivative, which a companion matrix of degree 15
// returns as clusters of complex roots. They are therefore bracketed by sampling, with 20 samples for each of the at
// most 16 minima, and narrowed by golden section search.
std::vector<double> MinimaOfCost(const std::vector<P3lConstraint>& constraints) {
  constexpr int kSamples = 320;
  constexpr int kSteps = 30;  // 2e-2 rad times 0.618^30: 1e-8 rad
  constexpr double kGolden = 0.6180339887498949;
  constexpr double kStep = 2.0 * M_PI / kSamples;
  std::vector<double> samples(kSamples);
  for (int i = 0; i < kSamples; ++i) samples[i] = Cost(constraints, kStep * i);
  std::vector<double> minima;
  for (int i = 0; i < kSamples; ++i) {
    if (samples[i] > samples[(i + 1) % kSamples] || samples[i] >= samples[(i + kSamples - 1) % kSamples]) continue;
    double low = kStep * (i - 1), high = kStep * (i + 1);
    for (int k = 0; k < kSteps; ++k) {
      const double left = high - kGolden * (high - low), right = low + kGolden * (high - low);
      if (Cost(constraints, left) < Cost(constraints, right)) {
        high = right;
      } else {
        low = left;
      }
    }
    minima.push_back(0.5 * (low + high));
  }
  return minima;
}

// Angles beta at which sum_i (a_i cos(beta) + b_i sin(beta) + d_i)^2 is stationary, by u = tan(beta / 2).
std::vector<double> StationaryBetas(const std::vector<P3lConstraint>& constraints, double alpha_rad) {
  const Eigen::Vector3d base(1.0, std::cos(alpha_rad), std::sin(alpha_rad));
  double aa = 0.0, bb = 0.0, ab = 0.0, ad = 0.0, bd = 0.0;
  for (const P3lConstraint& constraint : constraints) {
    const double a = constraint.a.dot(base), b = constraint.b.dot(base), d = constraint.d.dot(base);
    aa += a * a;
    bb += b * b;
    ab += a * b;
    ad += a * d;
    bd += b * d;
  }
  Eigen::VectorXd quartic(5);
  quartic << ab + bd, 2.0 * (bb - aa - ad), -6.0 * ab, 2.0 * (aa - bb - ad), ab - bd;
  std::vector<double> betas;
  for (const double u : RealRoots(quartic, 1e-3)) betas.push_back(2.0 * std::atan(u));
  return betas;
}

std::vector<Candidate> FindCandidates(absl::Span<const LineMatch> matches, const CameraModel& camera,
                                      const std::vector<PlaneAndDirection>& lines) {
  const P3lFrame frame(lines[0].normal.normalized(), lines[0].direction);
  std::vector<P3lConstraint> constraints;
  for (size_t i = 1; i < lines.size(); ++i) constraints.emplace_back(frame, lines[i].normal, lines[i].direction);
  std::vector<Candidate> candidates;
  for (const double alpha : MinimaOfCost(constraints)) {
    for (const double beta : StationaryBetas(constraints, alpha)) {
      const Eigen::Matrix3d rotation = frame.Rotation(alpha, beta);
      const auto translation_m = SolveTranslation(matches, camera, rotation);
      if (!translation_m) continue;
      const RigidTransform pose{rotation, *translation_m};
      const double residual_px = LineResidualPx(matches, camera, pose);
      if (std::isfinite(residual_px)) candidates.push_back({pose, residual_px});
    }
  }
  return candidates;
}

}  // namespace

absl::StatusOr<RigidTransform> EstimatePoseByAspnl(const CameraModel& camera, absl::Span<const LineMatch> matches) {
  if (matches.size() < 3) {
    return absl::InvalidArgumentError(absl::StrCat("ASPnL needs three matches: there are ", matches.size()));
  }
  std::vector<PlaneAndDirection> lines;
  if (!OrderLines(matches, camera, lines)) return absl::NotFoundError("ASPnL: the lines are parallel");
  std::vector<Candidate> candidates = FindCandidates(matches, camera, lines);
  const auto is_better = [](const Candidate& a, const Candidate& b) { return a.residual_px < b.residual_px; };
  std::stable_sort(candidates.begin(), candidates.end(), is_better);
  if (candidates.size() > kMaxRefined) candidates.resize(kMaxRefined);
  for (Candidate& candidate : candidates) {
    const auto refined = RefinePose(matches, camera, candidate.pose, kRefinementIterations);
    if (!refined) continue;
    const double residual_px = LineResidualPx(matches, camera, *refined);
    if (residual_px < candidate.residual_px) candidate = {*refined, residual_px};
  }
  const auto best = std::min_element(candidates.begin(), candidates.end(), is_better);
  if (best == candidates.end()) return absl::NotFoundError("ASPnL: no pose in front of the camera");
  return best->pose;
}

}  // namespace evpose

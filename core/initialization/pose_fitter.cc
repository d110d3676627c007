// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/pose_fitter.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>

#include "core/base/yield_point.h"
#include "core/geometry/half_turn.h"
#include "core/geometry/lines_of_a_pose.h"
#include "core/geometry/projected_line.h"
#include "core/initialization/false_alarms.h"
#include "core/initialization/segment_fit.h"

namespace evpose {
namespace {

// Factors of the gates of the successive matchings in MatchAndRefine(). The first one admits the error of a pose from
// one segment.
constexpr std::array<double, 3> kWidenings = {4.0, 2.0, 1.0};
// Numbers of Levenberg-Marquardt steps. After each matching few steps suffice, because the matches change anyway; a
// reflected pose starts farther away from its minimum.
constexpr int kStepsPerMatching = 3;
constexpr int kReflectionSteps = 8;
constexpr int kVisibleSteps = 5;
constexpr int kMaxStepsToMinimum = 50;  // a pose that several segments determine takes 6 to 20
constexpr double kFirstDamping = 1e-4;  // share of the mean diagonal of the normal equations
// Factors of the damping after a step that lowers the cost and after one that does not.
constexpr double kDampingAfterSuccess = 0.1;
constexpr double kDampingAfterFailure = 20.0;
// Rounding tolerance of the cost: a step that raises it by less is accepted, and the descent continues until the
// gradient vanishes.
constexpr double kCostRounding = 1e-14;
// The refinement ends when a step is expected to lower the cost by less than this share, which is lost in rounding, or
// when the damping has grown to this value.
constexpr double kLeastDecrease = 1e-16;
constexpr double kMaxDamping = 1e12;
constexpr double kUnmatched = 1e300;  // cost of a line without a segment

}  // namespace

ImagePart PoseFitter::MakePart(const RigidTransform& pose, int line, double begin, double end) const {
  const SearchLine& l = model_.lines()[line];
  const Eigen::Vector3d a = l.p1 + begin * (l.p2 - l.p1), b = l.p1 + end * (l.p2 - l.p1);
  return {line, a, b, camera_.Project(pose * a), camera_.Project(pose * b)};
}

std::vector<ImagePart> PoseFitter::LikelyParts(const RigidTransform& pose) const {
  const Eigen::Vector3d to_camera = -(pose.rotation.transpose() * (pose * model_.centre()));
  std::vector<ImagePart> parts;
  for (const ViewLine& seen : model_.View(to_camera)) {
    const SearchLine& line = model_.lines()[seen.line];
    if (!((pose * line.p1).z() > 0.0 && (pose * line.p2).z() > 0.0)) continue;
    parts.push_back(MakePart(pose, seen.line, seen.begin, seen.end));
  }
  return parts;
}

std::vector<ImagePart> PoseFitter::VisibleParts(const RigidTransform& pose) const {
  std::vector<ImagePart> parts;
  for (const VisibleSegment& seen : model_.visibility().VisibleSegments(camera_, pose)) {
    parts.push_back(MakePart(pose, seen.line, seen.begin, seen.end));
  }
  return parts;
}

std::vector<SegmentMatch> PoseFitter::Match(absl::Span<const ImagePart> parts, double widening) const {
  const FitWeights weights = FitWeights::Make(options_, widening);
  std::vector<SegmentMatch> matches;
  YieldPoint();
  for (size_t j = 0; j < segments_.size(); ++j) {
    double least = options_.unexplained_cost;
    const ImagePart* best = nullptr;
    SegmentFit fit;
    for (const ImagePart& part : parts) {
      if (!FitSegment(segments_[j], part.a_px, part.b_px, weights, least, fit)) continue;
      least = fit.cost;
      best = &part;
    }
    if (best == nullptr) continue;
    const bool is_turned = segments_[j].along.dot(best->b_px - best->a_px) < 0.0;
    matches.push_back({static_cast<int>(j), best->line, is_turned ? best->b : best->a, is_turned ? best->a : best->b});
  }
  return matches;
}

bool PoseFitter::Accumulate(absl::Span<const SegmentMatch> matches, const FitWeights& weights,
                            const RigidTransform& pose, NormalEquations& normal) const {
  normal = {};
  for (const SegmentMatch& match : matches) {
    const SearchSegment& seen = segments_[match.segment];
    const auto projected = ProjectLine(camera_, pose, match.p1, match.p2);
    if (!projected || !((pose * match.p1).z() > 0.0 && (pose * match.p2).z() > 0.0)) return false;
    for (const Eigen::Vector3d* q : {&seen.q1, &seen.q2}) {
      normal.Add(projected->jacobian.transpose() * *q, projected->a.dot(*q), weights.across);
    }
    // Position of the ends along the segment: positive values are line ends beyond the segment's ends.
    for (const double side : {-1.0, 1.0}) {
      const Eigen::Vector3d turned = pose.rotation * (side < 0.0 ? match.p1 : match.p2);
      const Eigen::Vector3d x = turned + pose.translation_m;
      const double inside_px = side * seen.along.dot(camera_.Project(x) - seen.middle_px) - seen.half_px;
      const double zx = camera_.fx_px * seen.along.x(), zy = camera_.fy_px * seen.along.y();
      const Eigen::Vector3d by_x = side / x.z() * Eigen::Vector3d(zx, zy, -(zx * x.x() + zy * x.y()) / x.z());
      Vector6d row;
      row << by_x, turned.cross(by_x);  // dx = dt + dtheta x (R p)
      normal.Add(row, inside_px, EndWeight(inside_px, weights));
      normal.cost += EndCost(inside_px, weights) - inside_px * inside_px * EndWeight(inside_px, weights);
    }
  }
  return true;
}

bool PoseFitter::Refine(absl::Span<const SegmentMatch> matches, double widening, int iterations,
                        RigidTransform& pose) const {
  const FitWeights weights = FitWeights::Make(options_, widening);
  NormalEquations normal, next_normal;
  if (!Accumulate(matches, weights, pose, normal)) return false;
  double damping = kFirstDamping;
  for (int i = 0; i < iterations && damping < kMaxDamping; ++i) {
    // Translations are in units of the object's radius, so that one damping constant suits translation and rotation.
    const double unit_m2 = model_.radius_m() * model_.radius_m();
    Matrix6d h = normal.h;
    const double level =
        damping * (h.topLeftCorner<3, 3>().trace() * unit_m2 + h.bottomRightCorner<3, 3>().trace()) / 6;
    h.diagonal().head<3>().array() += level / unit_m2;
    h.diagonal().tail<3>().array() += level;
    const Eigen::LDLT<Matrix6d> ldlt(h);
    if (ldlt.info() != Eigen::Success || !(ldlt.vectorD().minCoeff() > 0.0)) return false;
    const Vector6d step = -ldlt.solve(normal.g);
    if (!step.allFinite()) return false;
    if (-step.dot(normal.g) <= kLeastDecrease * normal.cost) break;
    const RigidTransform next = Perturb(pose, step);
    const bool is_better =
        Accumulate(matches, weights, next, next_normal) && next_normal.cost <= (1.0 + kCostRounding) * normal.cost;
    damping *= is_better ? kDampingAfterSuccess : kDampingAfterFailure;
    if (!is_better) continue;
    pose = next;
    std::swap(normal, next_normal);
  }
  return IsBeforeCamera(pose);
}

bool PoseFitter::IsBeforeCamera(const RigidTransform& pose) const {
  return (pose * model_.centre()).z() > 0.5 * model_.radius_m();
}

bool PoseFitter::MatchAndRefine(RigidTransform& pose) const {
  for (const double widening : kWidenings) {
    const std::vector<SegmentMatch> matches = Match(LikelyParts(pose), widening);
    if (matches.size() < kLinesOfAPose || !Refine(matches, widening, kStepsPerMatching, pose)) return false;
  }
  return true;
}

void PoseFitter::Project(const RigidTransform& pose, std::vector<ImagePart>& parts) const {
  for (ImagePart& part : parts) {
    part.a_px = camera_.Project(pose * part.a);
    part.b_px = camera_.Project(pose * part.b);
  }
}

PoseHypothesis PoseFitter::ScoreVisible(RigidTransform pose, size_t num_segments) const {
  std::vector<ImagePart> parts = VisibleParts(pose);
  RigidTransform refined = pose;
  if (Refine(Match(parts, 1.0), 1.0, kVisibleSteps, refined)) {
    pose = refined;
    Project(pose, parts);
  }
  return Score(pose, parts, num_segments);
}

PoseHypothesis PoseFitter::ScoreMinimum(RigidTransform pose, size_t num_segments) const {
  std::vector<ImagePart> parts = VisibleParts(pose);
  const std::vector<SegmentMatch> matches = Match(parts, 1.0);
  RigidTransform refined = pose;
  if (matches.size() >= kLinesOfAPose && Refine(matches, 1.0, kMaxStepsToMinimum, refined)) {
    pose = refined;
    Project(pose, parts);
  }
  return Score(pose, parts, num_segments);
}

bool PoseFitter::ReflectDepths(RigidTransform& pose) const {
  const std::vector<SegmentMatch> matches = Match(LikelyParts(pose), 1.0);
  if (matches.size() < kLinesOfAPose) return false;
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const SegmentMatch& match : matches) middle += 0.5 / static_cast<double>(matches.size()) * (match.p1 + match.p2);
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const SegmentMatch& match : matches) {
    scatter += (match.p1 - middle) * (match.p1 - middle).transpose();
    scatter += (match.p2 - middle) * (match.p2 - middle).transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(scatter);
  const Eigen::Vector3d plane_normal = solver.eigenvectors().col(0);
  const Eigen::Vector3d middle_camera = pose * middle;
  const Eigen::Vector3d sight = middle_camera.normalized();
  pose.rotation = Reflection(sight) * pose.rotation * Reflection(plane_normal);
  pose.translation_m = middle_camera - pose.rotation * middle;
  return Refine(matches, kWidenings.front(), kReflectionSteps, pose);
}

PoseHypothesis PoseFitter::Score(const RigidTransform& pose, absl::Span<const ImagePart> parts,
                                 size_t num_segments) const {
  PoseHypothesis hypothesis;
  hypothesis.camera_from_object = pose;
  hypothesis.model_line.assign(num_segments, -1);
  const FitWeights weights = FitWeights::Make(options_, 1.0);
  std::vector<double> covered_px(parts.size(), 0.0), lengths_px;
  std::vector<double> across_cost(model_.lines().size(), kUnmatched);  // by line: the least of its segments
  YieldPoint();
  for (const SearchSegment& segment : segments_) {
    double least = options_.unexplained_cost, across = 0.0;
    int matched = -1;
    for (size_t i = 0; i < parts.size(); ++i) {
      SegmentFit fit;
      if (!FitSegment(segment, parts[i].a_px, parts[i].b_px, weights, options_.unexplained_cost, fit)) continue;
      covered_px[i] += fit.overlap_px;  // one segment covers all lines that coincide in the image
      if (fit.cost >= least) continue;
      least = fit.cost;
      across = fit.across_cost;
      matched = parts[i].line;
    }
    hypothesis.cost += least;
    if (matched < 0) continue;
    across_cost[matched] = std::min(across_cost[matched], across);
    hypothesis.model_line[segment.index] = model_.lines()[matched].model_line;
    ++hypothesis.num_matched;
  }
  for (size_t i = 0; i < parts.size(); ++i) {
    lengths_px.push_back((parts[i].b_px - parts[i].a_px).norm());
    hypothesis.cost += MissingCost(lengths_px[i], std::min(covered_px[i], lengths_px[i]), options_);
  }
  ExplainedSegments explained;
  for (const double cost : across_cost) {
    if (cost >= kUnmatched) continue;
    ++explained.num_lines;
    explained.across_cost += cost;
  }
  const double lines_per_part = static_cast<double>(model_.lines().size()) / static_cast<double>(parts.size());
  hypothesis.expected_false_alarms =
      ExpectedFalseAlarms(explained, segments_, lengths_px, std::max(1.0, lines_per_part),
                          static_cast<double>(model_.num_symmetries()), options_);
  return hypothesis;
}

}  // namespace evpose

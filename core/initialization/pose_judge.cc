#include "core/initialization/pose_judge.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <optional>

#include "core/geometry/projected_line.h"
#include "core/initialization/segment_fit.h"

namespace evpose {
namespace {

constexpr int kMinMatches = 3;
// Tolerances for matching while the pose improves, in standard deviations' multiples; the first takes in what a pose
// from one segment is off by.
constexpr std::array<double, 3> kWidenings = {4.0, 2.0, 1.0};
constexpr int kStepsWhileSettling = 3;
// Of the trace of the information: below, a motion of the pose does not show in the image.
constexpr double kMinPivotRatio = 1e-9;

struct Normal {
  Matrix6d h = Matrix6d::Zero();
  Vector6d g = Vector6d::Zero();
  double cost_px2 = 0.0;
};

}  // namespace

std::vector<ImagePart> PoseJudge::LikelyParts(const RigidTransform& pose) const {
  const Eigen::Vector3d to_camera = -(pose.rotation.transpose() * (pose * model_.centre()));
  std::vector<ImagePart> parts;
  for (const ViewLine& seen : model_.View(to_camera)) {
    const SearchLine& line = model_.lines()[seen.line];
    const Eigen::Vector3d p1 = pose * line.p1, p2 = pose * line.p2;
    const Eigen::Vector3d a = p1 + seen.begin * (p2 - p1), b = p1 + seen.end * (p2 - p1);
    if (!(a.z() > 0.0 && b.z() > 0.0)) continue;
    parts.push_back({seen.line, camera_.Project(a), camera_.Project(b)});
  }
  return parts;
}

std::vector<ImagePart> PoseJudge::VisibleParts(const RigidTransform& pose) const {
  std::vector<ImagePart> parts;
  for (const VisibleSegment& seen : model_.VisibleParts(camera_, pose)) {
    const SearchLine& line = model_.lines()[seen.line];
    const Eigen::Vector3d p1 = pose * line.p1, p2 = pose * line.p2;
    parts.push_back(
        {seen.line, camera_.Project(p1 + seen.begin * (p2 - p1)), camera_.Project(p1 + seen.end * (p2 - p1))});
  }
  return parts;
}

std::vector<int> PoseJudge::Match(absl::Span<const ImagePart> parts, double widening) const {
  const auto weight = [widening](double sigma) { return 1.0 / (widening * widening * sigma * sigma); };
  const FitWeights weights = {weight(options_.end_point_sigma_px), weight(options_.end_point_along_sigma_px)};
  std::vector<int> matches(lines_.size(), -1);
  for (size_t j = 0; j < lines_.size(); ++j) {
    double least = options_.unexplained_cost;
    SegmentFit fit;
    for (const ImagePart& part : parts) {
      if (!FitSegment(lines_[j], part.a, part.b, weights, least, fit)) continue;
      least = fit.cost;
      matches[j] = part.line;
    }
  }
  return matches;
}

bool PoseJudge::Refine(absl::Span<const int> matches, int iterations, RigidTransform& pose) const {
  const auto accumulate = [&](const RigidTransform& at) -> std::optional<Normal> {
    Normal normal;
    for (size_t j = 0; j < matches.size(); ++j) {
      if (matches[j] < 0) continue;
      const SearchLine& line = model_.lines()[matches[j]];
      const auto projected = ProjectLine(camera_, at, line.p1, line.p2);
      if (!projected) return std::nullopt;
      for (const Eigen::Vector3d* q : {&lines_[j].q1, &lines_[j].q2}) {
        const double d_px = projected->a.dot(*q);
        const Vector6d row = projected->jacobian.transpose() * *q;
        normal.h.noalias() += row * row.transpose();
        normal.g += row * d_px;
        normal.cost_px2 += d_px * d_px;
      }
    }
    return normal;
  };
  std::optional<Normal> normal = accumulate(pose);
  double damping = 1e-4;
  for (int i = 0; normal && i < iterations; ++i) {
    // Translations in units of the object's radius, so that one damping serves both.
    const double unit_m2 = model_.radius_m() * model_.radius_m();
    Matrix6d h = normal->h;
    const double level =
        damping * (h.topLeftCorner<3, 3>().trace() * unit_m2 + h.bottomRightCorner<3, 3>().trace()) / 6;
    h.diagonal().head<3>().array() += level / unit_m2;
    h.diagonal().tail<3>().array() += level;
    const Eigen::LDLT<Matrix6d> ldlt(h);
    if (ldlt.info() != Eigen::Success || !(ldlt.vectorD().minCoeff() > 0.0)) return false;
    const Vector6d step = -ldlt.solve(normal->g);
    if (!step.allFinite()) return false;
    const RigidTransform next = Perturb(pose, step);
    const std::optional<Normal> next_normal = accumulate(next);
    const bool is_better = next_normal && next_normal->cost_px2 <= normal->cost_px2;
    damping *= is_better ? 0.1 : 20.0;
    if (!is_better) continue;
    pose = next;
    normal = next_normal;
  }
  return normal && (pose * model_.centre()).z() > 0.5 * model_.radius_m();
}

bool PoseJudge::Settle(RigidTransform& pose) const {
  const auto enough = [](const std::vector<int>& matches) {
    return std::count_if(matches.begin(), matches.end(), [](int line) { return line >= 0; }) >= kMinMatches;
  };
  for (const double widening : kWidenings) {
    const std::vector<int> matches = Match(LikelyParts(pose), widening);
    if (!enough(matches) || !Refine(matches, kStepsWhileSettling, pose)) return false;
  }
  return true;
}

PoseHypothesis PoseJudge::Judge(const RigidTransform& pose, size_t num_segments) const {
  PoseHypothesis hypothesis;
  hypothesis.camera_from_object = pose;
  hypothesis.model_line.assign(num_segments, -1);
  const std::vector<ImagePart> parts = VisibleParts(pose);
  const FitWeights weights = {1.0 / (options_.end_point_sigma_px * options_.end_point_sigma_px),
                              1.0 / (options_.end_point_along_sigma_px * options_.end_point_along_sigma_px)};
  std::vector<double> covered_px(parts.size(), 0.0);
  for (const ImageLine& line : lines_) {
    double least = options_.unexplained_cost;
    int matched = -1;
    for (size_t i = 0; i < parts.size(); ++i) {
      SegmentFit fit;
      if (!FitSegment(line, parts[i].a, parts[i].b, weights, options_.unexplained_cost, fit)) continue;
      covered_px[i] += fit.overlap_px;  // lines that lie on one another in the image are covered by one segment
      if (fit.cost >= least) continue;
      least = fit.cost;
      matched = parts[i].line;
    }
    hypothesis.cost += least;
    if (matched < 0) continue;
    hypothesis.model_line[line.index] = model_.lines()[matched].model_line;
    ++hypothesis.num_matched;
  }
  double all_px = 0.0, all_covered_px = 0.0;
  for (size_t i = 0; i < parts.size(); ++i) {
    const double length_px = (parts[i].b - parts[i].a).norm();
    const double part_covered_px = std::min(covered_px[i], length_px);
    hypothesis.cost += MissingCost(length_px, part_covered_px, options_);
    all_px += length_px;
    all_covered_px += part_covered_px;
  }
  hypothesis.matched_ratio = all_px > 0.0 ? all_covered_px / all_px : 0.0;
  return hypothesis;
}

}  // namespace evpose

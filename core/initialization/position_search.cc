#include "core/initialization/position_search.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <bit>

#include "core/initialization/segment_fit.h"

namespace evpose {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

// What a rotation from directions is off by, rad.
constexpr double kRotationSigmaRad = 0.01;
// What a position from one segment and that rotation makes of the picture: shares of the object's radius.
constexpr double kAcrossSigmaOfRadius = 0.01;
constexpr double kAlongSigmaOfRadius = 0.02;
// Segments that give positions. Of the longest ten more than half are whole lines of the object, or there is little
// hope.
constexpr size_t kMaxVoters = 10;
// Votes closer than this support each other: depths, and lateral distances in radii.
constexpr double kVoteDepthRatio = 0.06;
constexpr double kVoteLateralOfRadius = 0.05;
// Votes that are scored for one rotation, the best supported first.
constexpr size_t kMaxScoredVotes = 24;
constexpr double kSameRotationRad = 0.03;
constexpr double kSamePositionRatio = 0.02;  // of the distance

}  // namespace

void BestCandidates::Add(const PoseCandidate& candidate) {
  if (candidate.cost >= cap_) return;
  const auto is_same = [&](const PoseCandidate& other) {
    const Matrix3d between = candidate.camera_from_object.rotation.transpose() * other.camera_from_object.rotation;
    const double distance_m =
        (candidate.camera_from_object.translation_m - other.camera_from_object.translation_m).norm();
    return distance_m < kSamePositionRatio * other.camera_from_object.translation_m.norm() &&
           between.trace() > 3.0 - kSameRotationRad * kSameRotationRad;
  };
  const auto cheaper = [](const PoseCandidate& a, const PoseCandidate& b) { return a.cost < b.cost; };
  const auto same = std::find_if(candidates_.begin(), candidates_.end(), is_same);
  if (same != candidates_.end()) {
    if (candidate.cost < same->cost) *same = candidate;
  } else if (candidates_.size() < capacity_) {
    candidates_.push_back(candidate);
  } else {
    *std::max_element(candidates_.begin(), candidates_.end(), cheaper) = candidate;
  }
  const double best = std::min_element(candidates_.begin(), candidates_.end(), cheaper)->cost;
  cap_ = std::min(cap_, best + margin_);
  if (candidates_.size() == capacity_) {
    cap_ = std::min(cap_, std::max_element(candidates_.begin(), candidates_.end(), cheaper)->cost);
  }
}

PositionSearch::PositionSearch(const SearchModel& model, const CameraModel& camera, absl::Span<const ImageLine> lines,
                               const PoseSearchOptions& options)
    : model_(model), camera_(camera), lines_(lines), options_(options), fitting_(lines.size()) {
  Vector2d low = lines[0].middle_px, high = low;
  for (const ImageLine& line : lines) {
    const Vector2d half = (line.half_px * line.along).cwiseAbs();
    low = low.cwiseMin(line.middle_px - half);
    high = high.cwiseMax(line.middle_px + half);
  }
  const Vector2d middle = 0.5 * (low + high);
  bearing_ = Vector3d((middle.x() - camera.cx_px) / camera.fx_px, (middle.y() - camera.cy_px) / camera.fy_px, 1.0);
}

void PositionSearch::Prepare(const Matrix3d& rotation) {
  parts_.clear();
  for (const ViewLine& seen : model_.View(-(rotation.transpose() * bearing_))) {
    const SearchLine& line = model_.lines()[seen.line];
    const Vector3d p1 = rotation * line.p1, extent = rotation * (line.p2 - line.p1);
    parts_.push_back({p1 + seen.begin * extent, p1 + seen.end * extent, line.direction, seen.certain_ratio});
  }
  a_px_.resize(parts_.size());
  b_px_.resize(parts_.size());
  covered_px_.resize(parts_.size());
  const double variance = kRotationSigmaRad * kRotationSigmaRad;
  for (size_t j = 0; j < lines_.size(); ++j) {
    fitting_[j].clear();
    uint64_t fits = 0, tested = 0;
    for (size_t i = 0; i < parts_.size(); ++i) {
      const uint64_t bit = uint64_t{1} << (parts_[i].direction & 63);
      bool does_fit = (fits & bit) != 0;
      if (parts_[i].direction > 63 || (tested & bit) == 0) {
        const Vector3d d = rotation * model_.directions()[parts_[i].direction];
        const double sine = lines_[j].normal.dot(d);
        does_fit = sine * sine < options_.max_across_cost() * (lines_[j].Variance(d) + variance);
        if (parts_[i].direction <= 63) {
          tested |= bit;
          if (does_fit) fits |= bit;
        }
      }
      if (does_fit) fitting_[j].push_back(static_cast<int>(i));
    }
  }
}

// With l1 q1 and l2 q2 the ends of the part: l2 q2 - l1 q1 = +-(b - a), in the segment's plane.
bool PositionSearch::PositionFrom(const ImageLine& line, const Part& part, Vector3d& position) const {
  const Vector3d extent = part.b - part.a;
  const double scale = -1.0 / line.normal.dot(line.q1.cross(line.q2));
  const double l1 = scale * line.normal.dot(extent.cross(line.q2));
  const double l2 = scale * line.normal.dot(extent.cross(line.q1));
  const Vector3d x1 = l1 * line.q1, x2 = l2 * line.q2;
  if (l1 > 0.0 && l2 > 0.0) {
    position = 0.5 * ((x1 - part.a) + (x2 - part.b));
  } else if (l1 < 0.0 && l2 < 0.0) {  // the other way round
    position = 0.5 * ((-x1 - part.b) + (-x2 - part.a));
  } else {
    return false;
  }
  return true;
}

bool PositionSearch::Project(const Vector3d& position) {
  const double near_m = 0.1 * model_.radius_m();
  const auto project = [&](const Vector3d& x) -> Vector2d {
    const double inverse = 1.0 / x.z();
    return {camera_.fx_px * x.x() * inverse + camera_.cx_px, camera_.fy_px * x.y() * inverse + camera_.cy_px};
  };
  for (size_t i = 0; i < parts_.size(); ++i) {
    const Vector3d a = parts_[i].a + position, b = parts_[i].b + position;
    if (!(a.z() > near_m && b.z() > near_m)) return false;
    a_px_[i] = project(a);
    b_px_[i] = project(b);
  }
  return true;
}

double PositionSearch::Score(const Vector3d& position, double cap) {
  if (!Project(position)) return cap;
  const double radius_px = model_.radius_m() * camera_.fx_px / position.z();
  const auto weight = [](double sigma1, double sigma2) { return 1.0 / (sigma1 * sigma1 + sigma2 * sigma2); };
  const FitWeights weights = {weight(options_.end_point_sigma_px, kAcrossSigmaOfRadius * radius_px),
                              weight(options_.end_point_along_sigma_px, kAlongSigmaOfRadius * radius_px),
                              options_.max_across_cost(), options_.short_cost};
  std::fill(covered_px_.begin(), covered_px_.end(), 0.0);
  double cost = 0.0;
  for (size_t j = 0; j < lines_.size(); ++j) {
    double least = options_.unexplained_cost, overlap_px = 0.0;
    int matched = -1;
    for (const int i : fitting_[j]) {
      SegmentFit fit;
      if (!FitSegment(lines_[j], a_px_[i], b_px_[i], weights, least, fit)) continue;
      least = fit.cost;
      overlap_px = fit.overlap_px;
      matched = i;
    }
    if (matched >= 0) covered_px_[matched] += overlap_px;
    cost += least;
    if (cost >= cap) return cap;
  }
  for (size_t i = 0; i < parts_.size() && cost < cap; ++i) {
    if (parts_[i].certain_ratio <= 0.0) continue;
    const double length_px = (b_px_[i] - a_px_[i]).norm();
    cost += parts_[i].certain_ratio * MissingCost(length_px, std::min(covered_px_[i], length_px), options_);
  }
  return cost;
}

void PositionSearch::CastVotes() {
  votes_.clear();
  for (size_t j = 0; j < std::min(lines_.size(), kMaxVoters); ++j) {
    for (const int i : fitting_[j]) {
      Vote vote;
      if (!PositionFrom(lines_[j], parts_[i], vote.position)) continue;
      if (!(vote.position.z() > model_.radius_m())) continue;
      vote.voter = static_cast<int>(j);
      votes_.push_back(vote);
    }
  }
  std::sort(votes_.begin(), votes_.end(), [](const Vote& a, const Vote& b) { return a.position.z() < b.position.z(); });
}

// Votes of different segments that agree support each other.
void PositionSearch::CountSupport() {
  const double lateral_m = kVoteLateralOfRadius * model_.radius_m();
  for (size_t i = 0; i < votes_.size(); ++i) {
    Vote& vote = votes_[i];
    const double z_max = vote.position.z() * (1.0 + kVoteDepthRatio);
    for (size_t k = i + 1; k < votes_.size() && votes_[k].position.z() < z_max; ++k) {
      // Beside each other, at the same depth.
      const Vector3d& other = votes_[k].position;
      const Vector3d at_depth = other * (vote.position.z() / other.z());
      if (std::abs(at_depth.x() - vote.position.x()) > lateral_m) continue;
      if (std::abs(at_depth.y() - vote.position.y()) > lateral_m) continue;
      const uint32_t ours = uint32_t{1} << vote.voter, theirs = uint32_t{1} << votes_[k].voter;
      vote.supporters |= theirs;
      votes_[k].supporters |= ours;
    }
    vote.supporters |= uint32_t{1} << vote.voter;
  }
}

void PositionSearch::Search(const Matrix3d& rotation, BestCandidates& best, int& budget) {
  Prepare(rotation);
  CastVotes();
  CountSupport();
  std::stable_sort(votes_.begin(), votes_.end(), [](const Vote& a, const Vote& b) {
    return std::popcount(a.supporters) > std::popcount(b.supporters);
  });
  const size_t count = std::min(votes_.size(), kMaxScoredVotes);
  for (size_t i = 0; i < count && budget > 0; ++i) {
    --budget;
    const double cost = Score(votes_[i].position, best.cap());
    if (cost < best.cap()) best.Add({{rotation, votes_[i].position}, cost});
  }
}

}  // namespace evpose

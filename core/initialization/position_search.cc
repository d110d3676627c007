// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/position_search.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <tuple>

#include "core/base/yield_point.h"
#include "core/initialization/segment_fit.h"

namespace evpose {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

// Standard deviations of the projected lines at a position from one segment and one rotation from directions, as shares
// of the object's radius. Across the lines it is that of the rotation, 0.01 rad times the radius; along them it is
// twice as much, because the segment's ends are less certain. They inflate the cost of stage 3.
constexpr double kAcrossSigmaOfRadius = 0.01;
constexpr double kAlongSigmaOfRadius = 0.02;
// Number of pairs of votes that take as long as casting one vote. Among scattered votes fewer pairs are examined.
constexpr size_t kPairsPerVote = 32;
// Number of best-supported positions that are kept for each rotation, because parallel lines give several. The time of
// scoring is proportional to it.
constexpr int kPositionsPerRotation = 4;
// Candidates closer than this are duplicates, because the refinement converges to the same pose: rotation in radians,
// distance as a share of the distance from the camera.
constexpr double kSameCandidateRad = 0.03;
constexpr double kSameCandidateRatio = 0.02;
// Mean number of directions that fit a segment, including the correct one. It only scales the expected number of votes.
constexpr double kFittingDirections = 1.3;
// Smallest depth of a line's end, as a share of the object's radius: nearer points project too far outside.
constexpr double kMinDepthOfRadius = 0.1;

}  // namespace

void BestCandidates::Add(const PoseCandidate& candidate) {
  if (candidate.cost >= cap_) return;
  const auto is_same = [&](const PoseCandidate& other) {
    const Matrix3d between = candidate.camera_from_object.rotation.transpose() * other.camera_from_object.rotation;
    const double distance_m =
        (candidate.camera_from_object.translation_m - other.camera_from_object.translation_m).norm();
    return distance_m < kSameCandidateRatio * other.camera_from_object.translation_m.norm() &&
           between.trace() > 3.0 - kSameCandidateRad * kSameCandidateRad;
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

PositionSearch::PositionSearch(const SearchModel& model, const CameraModel& camera,
                               absl::Span<const SearchSegment> segments, const PoseSearchOptions& options)
    : model_(model), camera_(camera), segments_(segments), options_(options), fitting_(segments.size()) {
  Vector2d low = segments[0].middle_px, high = low;
  for (const SearchSegment& segment : segments) {
    const Vector2d half = (segment.half_px * segment.along).cwiseAbs();
    low = low.cwiseMin(segment.middle_px - half);
    high = high.cwiseMax(segment.middle_px + half);
  }
  bearing_ = BearingOf(camera, 0.5 * (low + high));
}

void PositionSearch::Prepare(const Matrix3d& rotation) {
  const size_t num_directions = model_.directions().size();
  const std::vector<ViewLine>& view = model_.View(-(rotation.transpose() * bearing_));
  first_part_.assign(num_directions + 1, 0);
  for (const ViewLine& seen : view) ++first_part_[model_.lines()[seen.line].direction + 1];
  for (size_t d = 0; d < num_directions; ++d) first_part_[d + 1] += first_part_[d];
  parts_.resize(view.size());
  next_part_.assign(first_part_.begin(), first_part_.end());
  for (const ViewLine& seen : view) {
    const SearchLine& line = model_.lines()[seen.line];
    const Vector3d p1 = rotation * line.p1, extent = rotation * (line.p2 - line.p1);
    const Vector3d a = p1 + seen.begin * extent, b = p1 + seen.end * extent;
    parts_[next_part_[line.direction]++] = {a, b, 0.5 * (a + b), (b - a).norm(), seen.certain_ratio};
  }
  a_px_.resize(parts_.size());
  b_px_.resize(parts_.size());
  covered_px_.resize(parts_.size());

  turned_.resize(num_directions);
  for (size_t d = 0; d < num_directions; ++d) turned_[d] = rotation * model_.directions()[d];
  const double variance = options_.rotation_sigma_rad * options_.rotation_sigma_rad;
  for (size_t j = 0; j < segments_.size(); ++j) {
    fitting_[j].clear();
    for (size_t d = 0; d < num_directions; ++d) {
      if (first_part_[d] == first_part_[d + 1]) continue;
      const double sine = segments_[j].normal.dot(turned_[d]);
      if (sine * sine < options_.max_across_cost() * (segments_[j].Variance(turned_[d]) + variance)) {
        fitting_[j].push_back(static_cast<int>(d));
      }
    }
  }
}

// Equation (6) of the README: l2 q2 - l1 q1 = +-d in the segment's plane, for the ends l1 q1 and l2 q2 of a part of
// unit length with direction d.
void PositionSearch::CastVotes() {
  votes_.clear();
  const double least_depth_m = model_.radius_m();  // the whole object must lie in front of the camera
  for (size_t j = 0; j < std::min(segments_.size(), static_cast<size_t>(options_.max_voters)); ++j) {
    const SearchSegment& segment = segments_[j];
    const double scale = -1.0 / segment.normal.dot(segment.q1.cross(segment.q2));
    const Vector3d by_l1 = scale * segment.q2.cross(segment.normal), by_l2 = scale * segment.q1.cross(segment.normal);
    for (const int direction : fitting_[j]) {
      const double l1 = turned_[direction].dot(by_l1), l2 = turned_[direction].dot(by_l2);
      if (!(l1 * l2 > 0.0)) continue;
      // Both ends must lie in front of the camera; a negative solution is the line in the opposite direction.
      const Vector3d middle = (l1 > 0.0 ? 0.5 : -0.5) * (l1 * segment.q1 + l2 * segment.q2);
      for (int i = first_part_[direction]; i < first_part_[direction + 1]; ++i) {
        const Vector3d position = parts_[i].length_m * middle - parts_[i].middle;
        if (!(position.z() > least_depth_m)) continue;
        const auto bit = static_cast<uint16_t>(1u << j);
        votes_.push_back({static_cast<float>(position.x()), static_cast<float>(position.y()),
                          static_cast<float>(position.z()), bit, bit, 1});
      }
    }
  }
  num_votes_ += static_cast<int>(votes_.size());
  // Ties in depth are broken by a fixed order, so that the result does not depend on a library's sort.
  std::sort(votes_.begin(), votes_.end(), [](const SingleVote& a, const SingleVote& b) {
    return a.z != b.z ? a.z < b.z : std::tie(a.x, a.y, a.voter) < std::tie(b.x, b.y, b.voter);
  });
}

// Counts, for each vote, the segments with a vote for the same position.
void PositionSearch::CountSupport() {
  const auto lateral_m = static_cast<float>(options_.vote_lateral_of_radius * model_.radius_m());
  const auto depth_factor = static_cast<float>(1.0 + options_.vote_depth_ratio);
  size_t num_pairs = 0;
  for (size_t i = 0; i < votes_.size(); ++i) {
    YieldPoint(i);
    SingleVote& vote = votes_[i];
    const float z_max = vote.z * depth_factor;
    size_t k = i + 1;
    for (; k < votes_.size() && votes_[k].z < z_max; ++k) {
      // The depths agree. The lateral distance is that of the two lines of sight at the depth of the first vote.
      SingleVote& other = votes_[k];
      const float dx = vote.z * other.x - other.z * vote.x, dy = vote.z * other.y - other.z * vote.y;
      if (std::max(std::abs(dx), std::abs(dy)) > lateral_m * other.z) continue;
      vote.AddSupporter(other.voter);
      other.AddSupporter(vote.voter);
    }
    num_pairs += k - i - 1;
  }
  // Comparing votes that cluster at one depth takes time, which is counted as additional votes.
  num_votes_ += static_cast<int>(num_pairs / kPairsPerVote);
}

// Stores the best supported positions. Votes within half the agreement limits of a stored position are duplicates of
// it.
void PositionSearch::KeepBest(int rotation) {
  const auto lateral_m = static_cast<float>(0.5 * options_.vote_lateral_of_radius * model_.radius_m());
  const auto depth_ratio = static_cast<float>(0.5 * options_.vote_depth_ratio);
  for (int taken = 0; taken < kPositionsPerRotation && !votes_.empty(); ++taken) {
    YieldPoint();
    // Among equally supported votes the first one is taken, which is the nearest to the camera.
    const SingleVote place = *std::max_element(
        votes_.begin(), votes_.end(), [](const SingleVote& a, const SingleVote& b) { return a.support < b.support; });
    if (place.support == 0) return;
    positions_.push_back({Vector3d(place.x, place.y, place.z), rotation, place.support});
    for (SingleVote& vote : votes_) {
      const bool is_near = std::abs(vote.z - place.z) < depth_ratio * place.z &&
                           std::abs(vote.x - place.x) < lateral_m && std::abs(vote.y - place.y) < lateral_m;
      if (is_near) vote.support = 0;
    }
  }
}

double PositionSearch::ExpectedVotes() const {
  const double voters = static_cast<double>(std::min(segments_.size(), static_cast<size_t>(options_.max_voters)));
  return 1.0 + kFittingDirections * voters * model_.mean_view_size() / static_cast<double>(model_.directions().size());
}

void PositionSearch::Vote(const Matrix3d& rotation) {
  YieldPoint();
  Prepare(rotation);
  CastVotes();
  CountSupport();
  rotations_.push_back(rotation);
  KeepBest(static_cast<int>(rotations_.size()) - 1);
}

bool PositionSearch::Project(const Vector3d& position) {
  const double near_m = kMinDepthOfRadius * model_.radius_m();
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

double PositionSearch::Cost(const Vector3d& position, double cap) {
  if (!Project(position)) return cap;
  const double radius_px = model_.radius_m() * camera_.fx_px / position.z();
  const auto weight = [](double sigma1, double sigma2) { return 1.0 / (sigma1 * sigma1 + sigma2 * sigma2); };
  const FitWeights weights = {weight(options_.end_point_sigma_px, kAcrossSigmaOfRadius * radius_px),
                              weight(options_.end_point_along_sigma_px, kAlongSigmaOfRadius * radius_px),
                              options_.max_across_cost(), options_.short_cost};
  std::fill(covered_px_.begin(), covered_px_.end(), 0.0);
  double cost = 0.0;
  for (size_t j = 0; j < segments_.size(); ++j) {
    double least = options_.unexplained_cost, overlap_px = 0.0;
    int matched = -1;
    for (const int direction : fitting_[j]) {
      for (int i = first_part_[direction]; i < first_part_[direction + 1]; ++i) {
        SegmentFit fit;
        if (!FitSegment(segments_[j], a_px_[i], b_px_[i], weights, least, fit)) continue;
        least = fit.cost;
        overlap_px = fit.overlap_px;
        matched = i;
      }
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

void PositionSearch::Score(int max_scored, BestCandidates& best) {
  std::stable_sort(positions_.begin(), positions_.end(),
                   [](const Position& a, const Position& b) { return a.support > b.support; });
  if (positions_.size() > static_cast<size_t>(max_scored)) positions_.resize(max_scored);
  // Ties in support are processed rotation by rotation, so that a rotation is seldom prepared twice.
  int prepared = -1;
  for (const Position& position : positions_) {
    YieldPoint();
    if (position.rotation != prepared) Prepare(rotations_[position.rotation]);
    prepared = position.rotation;
    const double cost = Cost(position.position, best.cap());
    if (cost < best.cap()) best.Add({{rotations_[position.rotation], position.position}, cost});
  }
  positions_.clear();
  rotations_.clear();
}

}  // namespace evpose

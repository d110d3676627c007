// SPDX-License-Identifier: Apache-2.0

// Bounds over a cube of axis-angle vectors r = r_0 + d, |d_i| <= h, with u = R_0 v, c = u x n.
//
// Published (LOPET, Sec. III-B, the upper bound E_U, after Hartley and Kahl 2009): angle(R_r v, R_0 v) <= |d| <=
// sqrt(3) h = mu, so that a pair is possible only if |n . u| <= sin(eps + mu).
//
// First order, sharper for small cubes: along d(s) = s d, 0 <= s <= 1, let g(s) = n . R(s) v and let w(s) = J(r_0 + s
// d) d be the angular velocity, J the left Jacobian of SO(3). Then g' = w . (R v x n), and with |w| <= |d|,
//   |g''| <= |w'| + |w|^2 <= |d|^2 / 2 + |d|^2:
// w(s) = int_0^1 exp(t r) d dt has the derivative int_0^1 w_t x exp(t r) d dt along d with |w_t| <= t |d|, hence |w'|
// <= |d|^2 int t dt = |d|^2 / 2. By Taylor |g(1) - n . u - d . J^T c| <= 3/4 |d|^2 <= 9/4 h^2, and a pair is possible
// only if |n . u| <= sin(eps) + h |J(r_0)^T c|_1 + 9/4 h^2. The 1-norm is between h and sqrt(3) h times |J^T c| <= 1,
// so that this bound does not lose the factor between the cube and the ball around it.
//
// Symmetry: E(RQ) = E(R) for Q in the group of the directions, so that the maximum is attained by the rotation with the
// smallest angle of its class. A cube of half-width h, in which every rotation has an angle >= |r_0| - mu, is skipped
// if some Q has angle(R_0 Q) + mu < |r_0| - mu: each of its rotations R has an RQ with a smaller angle. For directions
// that are mapped onto each other only approximately, eps of the upper bound grows by the deviation.
#include "core/baselines/first_pose/rotation_bnb.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/baselines/first_pose/rotation_count.h"
#include "core/geometry/rigid_transform.h"
#include "core/initialization/direction_symmetries.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kSqrt3 = 1.7320508075688772;
// Cubes are halved at most this often: their side is then 2e-5 rad, far below any noise.
constexpr int kMaxLevel = 18;
constexpr double kRounding = 1e-12;  // bound of the rounding errors of the sums below

struct Cube {
  uint32_t x = 0, y = 0, z = 0;  // position among the 2^level cubes of each axis
  int16_t level = 0;
  int16_t upper = 0;  // upper bound of E in the cube

  // One of the eight cubes of half the side, with this cube's bound.
  Cube Child(uint32_t i) const {
    return {2 * x + (i & 1), 2 * y + (i >> 1 & 1), 2 * z + (i >> 2), static_cast<int16_t>(level + 1), upper};
  }
};

// The candidate directions of each normal.
struct Problem {
  std::vector<Eigen::Vector3d> normals;
  std::vector<Eigen::Vector3d> directions;
  bool is_matched = false;  // true: normal j belongs to direction j only
  std::vector<Eigen::Matrix3d> symmetries = {Eigen::Matrix3d::Identity()};
  double slack_rad = 0.0;  // largest deviation of the symmetries

  size_t First(size_t j) const { return is_matched ? j : 0; }
  size_t Last(size_t j) const { return is_matched ? j + 1 : directions.size(); }
  int Size() const { return static_cast<int>(normals.size()); }
};

// The direction nearest to perpendicular, and |n . R v| for it.
struct NearestDirection {
  size_t index = 0;
  double cosine = 2.0;
};

NearestDirection Nearest(const Problem& problem, size_t j, const Eigen::Vector3d& turned_normal) {
  NearestDirection nearest;
  for (size_t k = problem.First(j); k < problem.Last(j); ++k) {
    const double cosine = std::abs(turned_normal.dot(problem.directions[k]));
    if (cosine < nearest.cosine) nearest = {k, cosine};
  }
  return nearest;
}

int Count(const Problem& problem, const Eigen::Matrix3d& rotation, double max_cosine) {
  int count = 0;
  for (size_t j = 0; j < problem.normals.size(); ++j) {
    count += Nearest(problem, j, rotation.transpose() * problem.normals[j]).cosine <= max_cosine;
  }
  return count;
}

// Performs one Gauss-Newton step on the sum of (n . R v)^2 over the normals within `max_cosine` of perpendicular.
Eigen::Matrix3d LeastSquaresStep(const Problem& problem, const Eigen::Matrix3d& rotation, double max_cosine) {
  // Regularises the rotation about an axis that no line determines; a hundredth of the weight of a line.
  Eigen::Matrix3d hessian = 0.01 * max_cosine * Eigen::Matrix3d::Identity();
  Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
  for (size_t j = 0; j < problem.normals.size(); ++j) {
    const Eigen::Vector3d& normal = problem.normals[j];
    const NearestDirection nearest = Nearest(problem, j, rotation.transpose() * normal);
    if (nearest.cosine > max_cosine) continue;
    const Eigen::Vector3d u = rotation * problem.directions[nearest.index];
    const Eigen::Vector3d c = u.cross(normal);
    hessian += c * c.transpose();
    gradient += normal.dot(u) * c;
  }
  return ExpSo3(-hessian.ldlt().solve(gradient)) * rotation;
}

class BranchAndBound {
 public:
  BranchAndBound(const Problem& problem, const RotationBnbOptions& options);

  // For certificates: the search ends as soon as more than `count` is known to be possible.
  void StopAbove(int count) { stop_above_ = count; }
  void Offer(const Eigen::Matrix3d& rotation);
  // Searches until the bounds are equal or the budget is spent.
  void Search();
  // Finds the other rotations that reach the maximum.
  void ExplorePlateau();

  int lower_bound() const { return best_; }
  int upper_bound() const;
  RotationBnbResult Result() const;

 private:
  struct Level {
    double half_width;
    double reach;       // mu: largest angle between a rotation of the cube and that of its centre
    double ball_limit;  // sin(eps + mu); above 1 if every pair is possible
  };

  Eigen::Vector3d Centre(const Cube& cube) const;
  bool IsSkipped(const Eigen::Vector3d& centre, double reach, const Eigen::Matrix3d& rotation) const;
  bool MayHoldInlier(size_t j, const Eigen::Vector3d& turned_normal, const Eigen::Matrix3d& gradient_map,
                     const Level& level) const;
  // Computes E of the centre and the upper bound of the cube; the latter stops once it is below `needed`.
  std::pair<int, int> Bounds(const Eigen::Vector3d& centre, const Eigen::Matrix3d& rotation, const Level& level,
                             int needed) const;
  void Branch(const Cube& cube);
  void Consider(Cube cube);
  void Refine(const Eigen::Matrix3d& rotation);
  bool IsKnown(const Eigen::Matrix3d& rotation, double within_rad) const;
  void ExploreChildren(const Cube& cube, std::vector<Cube>& queue);

  const Problem& problem_;
  const RotationBnbOptions& options_;
  double max_cosine_ = 0.0;    // sin(eps)
  double upper_cosine_ = 0.0;  // sin(eps + slack)
  std::vector<Level> levels_;
  std::vector<std::vector<Cube>> open_;  // by upper bound; last in, first out, which keeps the lists short
  std::vector<Cube> ties_;               // cubes that can at best equal the incumbent
  int unresolved_ = 0;                   // largest upper bound of a cube that is too small to be split
  int best_ = 0;
  int stop_above_ = 0;
  bool has_all_ = false;
  int64_t branches_ = 0;
  std::vector<Eigen::Matrix3d> rotations_;
};

BranchAndBound::BranchAndBound(const Problem& problem, const RotationBnbOptions& options)
    : problem_(problem), options_(options), open_(problem.normals.size() + 1), stop_above_(problem.Size()) {
  max_cosine_ = DeterministicSinCos(options.inlier_rad).sin;
  const double upper_rad = options.inlier_rad + problem.slack_rad;
  upper_cosine_ = DeterministicSinCos(upper_rad).sin + kRounding;
  double half_width = kPi;
  for (int i = 0; i <= kMaxLevel; ++i, half_width *= 0.5) {
    const double reach = std::min(kSqrt3 * half_width, kPi);
    const double limit = upper_rad + reach < 0.5 * kPi ? DeterministicSinCos(upper_rad + reach).sin + kRounding : 2.0;
    levels_.push_back({half_width, reach, limit});
  }
  Offer(Eigen::Matrix3d::Identity());
  open_[problem.normals.size()].push_back({0, 0, 0, 0, static_cast<int16_t>(problem.normals.size())});
}

Eigen::Vector3d BranchAndBound::Centre(const Cube& cube) const {
  const double h = levels_[cube.level].half_width;
  return {(2.0 * cube.x + 1.0) * h - kPi, (2.0 * cube.y + 1.0) * h - kPi, (2.0 * cube.z + 1.0) * h - kPi};
}

// Whether a cube lies outside the ball, or contains no rotation with the smallest angle of its class.
bool BranchAndBound::IsSkipped(const Eigen::Vector3d& centre, double reach, const Eigen::Matrix3d& rotation) const {
  const double margin = reach + 1e-9 + 4.0 * problem_.slack_rad;
  const double smallest = centre.norm() - margin;
  if (smallest > kPi) return true;
  const double limit = smallest - margin;
  if (problem_.symmetries.size() < 2 || limit <= 0.0) return false;
  const double min_trace = 1.0 + 2.0 * DeterministicSinCos(limit).cos;
  return std::any_of(problem_.symmetries.begin() + 1, problem_.symmetries.end(), [&](const Eigen::Matrix3d& q) {
    return rotation.cwiseProduct(q.transpose()).sum() > min_trace;  // trace(R Q)
  });
}

// `gradient_map` is J^T R_0: J^T (R_0 v x n) = J^T R_0 (v x R_0^T n).
bool BranchAndBound::MayHoldInlier(size_t j, const Eigen::Vector3d& turned_normal, const Eigen::Matrix3d& gradient_map,
                                   const Level& level) const {
  const double h = level.half_width;
  const double constant = upper_cosine_ + 2.25 * h * h;
  for (size_t k = problem_.First(j); k < problem_.Last(j); ++k) {
    const Eigen::Vector3d& v = problem_.directions[k];
    const double cosine = std::abs(turned_normal.dot(v));
    if (cosine > level.ball_limit) continue;
    if (cosine <= constant + h * (gradient_map * v.cross(turned_normal)).lpNorm<1>()) return true;
  }
  return false;
}

std::pair<int, int> BranchAndBound::Bounds(const Eigen::Vector3d& centre, const Eigen::Matrix3d& rotation,
                                           const Level& level, int needed) const {
  // If the remainder alone exceeds the bound of the ball, the first order cannot be sharper.
  const bool is_first_order = options_.uses_first_order_bound && level.half_width < 0.25;
  Eigen::Matrix3d gradient_map = Eigen::Matrix3d::Zero();
  if (is_first_order) gradient_map = LeftJacobianSo3(centre).transpose() * rotation;
  int lower = 0;
  int upper = problem_.Size();
  for (size_t j = 0; j < problem_.normals.size(); ++j) {
    const Eigen::Vector3d turned = rotation.transpose() * problem_.normals[j];
    const double cosine = Nearest(problem_, j, turned).cosine;
    lower += cosine <= max_cosine_;
    if (cosine <= upper_cosine_) continue;
    const bool is_possible =
        cosine <= level.ball_limit && (!is_first_order || MayHoldInlier(j, turned, gradient_map, level));
    if (is_possible) continue;
    if (--upper < needed) return {lower, upper};
  }
  return {lower, upper};
}

bool BranchAndBound::IsKnown(const Eigen::Matrix3d& rotation, double within_rad) const {
  if (within_rad <= 0.0) return false;
  const double min_trace = 1.0 + 2.0 * DeterministicSinCos(std::min(within_rad, kPi)).cos;
  for (const Eigen::Matrix3d& known : rotations_) {
    const Eigen::Matrix3d between = known.transpose() * rotation;
    for (const Eigen::Matrix3d& q : problem_.symmetries) {
      if (between.cwiseProduct(q.transpose()).sum() >= min_trace) return true;
    }
  }
  return false;
}

void BranchAndBound::Offer(const Eigen::Matrix3d& rotation) {
  const int count = Count(problem_, rotation, max_cosine_);
  if (count < best_) return;
  if (count > best_) {
    best_ = count;
    rotations_.clear();
    ties_.clear();  // they tied with a lower count
  }
  if (static_cast<int>(rotations_.size()) >= options_.max_rotations || IsKnown(rotation, options_.distinct_rad)) return;
  rotations_.push_back(rotation);
}

// Derives an incumbent from a centre that is nearly one: the least-squares rotation of its inliers.
void BranchAndBound::Refine(const Eigen::Matrix3d& rotation) {
  constexpr int kSteps = 8;  // each step may add inliers; with the same inliers two or three converge
  Eigen::Matrix3d refined = rotation;
  for (int i = 0; i < kSteps; ++i) refined = LeastSquaresStep(problem_, refined, 1.5 * max_cosine_);
  Offer(refined);
  Offer(rotation);
}

void BranchAndBound::Consider(Cube cube) {
  const Level& level = levels_[cube.level];
  const Eigen::Vector3d centre = Centre(cube);
  const Eigen::Matrix3d rotation = ExpSo3(centre);
  ++branches_;
  if (IsSkipped(centre, level.reach, rotation)) return;
  const auto [lower, upper] = Bounds(centre, rotation, level, best_);
  if (upper < best_) return;
  // There are few coarse cubes, and one of them is near every plateau.
  constexpr int kCoarseLevel = 6;
  if (lower > best_ || (lower + 1 >= best_ && cube.level <= kCoarseLevel)) Refine(rotation);
  cube.upper = static_cast<int16_t>(std::min<int>(upper, cube.upper));
  if (cube.upper > best_) {
    open_[cube.upper].push_back(cube);
  } else if (cube.upper == best_) {
    ties_.push_back(cube);
  }
}

void BranchAndBound::Branch(const Cube& cube) {
  if (cube.level == kMaxLevel) {
    unresolved_ = std::max<int>(unresolved_, cube.upper);
    return;
  }
  for (uint32_t i = 0; i < 8; ++i) Consider(cube.Child(i));
}

void BranchAndBound::Search() {
  for (int upper = problem_.Size(); upper > best_; --upper) {
    std::vector<Cube>& open = open_[upper];
    while (!open.empty() && best_ < upper && best_ <= stop_above_ && branches_ < options_.max_branches) {
      const Cube cube = open.back();
      open.pop_back();
      Branch(cube);
    }
    if (!open.empty() && best_ < upper) return;
  }
  // The remaining cubes can at best equal the incumbent.
  ties_.insert(ties_.end(), open_[best_].begin(), open_[best_].end());
  open_[best_].clear();
}

int BranchAndBound::upper_bound() const {
  int upper = std::max(best_, unresolved_);
  for (size_t i = best_ + 1; i < open_.size(); ++i) {
    if (!open_[i].empty()) upper = std::max(upper, static_cast<int>(i));
  }
  return upper;
}

void BranchAndBound::ExploreChildren(const Cube& cube, std::vector<Cube>& queue) {
  const Level& level = levels_[cube.level + 1];
  for (uint32_t i = 0; i < 8; ++i) {
    const Cube part = cube.Child(i);
    const Eigen::Vector3d centre = Centre(part);
    const Eigen::Matrix3d rotation = ExpSo3(centre);
    ++branches_;
    if (IsSkipped(centre, level.reach, rotation)) continue;
    // Twice the distance that separates two rotations, so that a cube with a known rotation near its centre is covered
    // early.
    if (IsKnown(rotation, 2.0 * options_.distinct_rad - level.reach)) continue;
    const auto [lower, upper] = Bounds(centre, rotation, level, best_);
    if (upper < best_) continue;
    if (lower >= best_) Refine(rotation);
    queue.push_back(part);
  }
}

// Breadth first: most cubes at the border of a plateau are covered by rotations found in their neighbours and need not
// be split to the smallest size.
void BranchAndBound::ExplorePlateau() {
  std::stable_sort(ties_.begin(), ties_.end(), [](const Cube& a, const Cube& b) { return a.level < b.level; });
  std::vector<Cube> queue;
  queue.swap(ties_);
  const int64_t max_branches = branches_ + options_.max_plateau_branches;
  for (size_t i = 0; i < queue.size(); ++i) {
    const Cube cube = queue[i];
    const bool is_full = static_cast<int>(rotations_.size()) >= options_.max_rotations;
    if (is_full || branches_ >= max_branches || cube.level == kMaxLevel) return;
    ExploreChildren(cube, queue);
  }
  has_all_ = true;
}

RotationBnbResult BranchAndBound::Result() const { return {best_, upper_bound(), rotations_, has_all_, branches_}; }

absl::Status CheckUnit(const char* name, absl::Span<const Eigen::Vector3d> vectors) {
  for (size_t i = 0; i < vectors.size(); ++i) {
    const double norm = vectors[i].norm();
    if (std::abs(norm - 1.0) <= 1e-6) continue;
    return absl::InvalidArgumentError(absl::StrCat(name, "[", i, "] has length ", norm, ", must have 1"));
  }
  return absl::OkStatus();
}

absl::StatusOr<Problem> MakeProblem(absl::Span<const Eigen::Vector3d> normals,
                                    absl::Span<const Eigen::Vector3d> directions, Correspondences correspondences,
                                    const RotationBnbOptions& options) {
  const bool is_matched = correspondences == Correspondences::kKnown;
  constexpr size_t kMaxNormals = 10'000;  // counts are kept in 16 bits
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_RETURN_IF_ERROR(CheckUnit("normals", normals));
  EVPOSE_RETURN_IF_ERROR(CheckUnit("directions", directions));
  if (normals.empty() || normals.size() > kMaxNormals) {
    return absl::InvalidArgumentError(
        absl::StrCat("normals: there are ", normals.size(), ", must be 1 to ", kMaxNormals));
  }
  if (directions.size() < 2) {
    return absl::InvalidArgumentError("directions: no rotation follows from fewer than two");
  }
  if (is_matched && directions.size() != normals.size()) {
    return absl::InvalidArgumentError(absl::StrCat("directions: there are ", directions.size(), ", must be ",
                                                   normals.size(), ", one for each normal"));
  }
  Problem problem;
  problem.normals.assign(normals.begin(), normals.end());
  problem.directions.assign(directions.begin(), directions.end());
  problem.is_matched = is_matched;
  if (options.uses_symmetry) {
    problem.symmetries = is_matched ? SignSymmetries(directions) : DirectionSymmetries(directions);
    problem.slack_rad = SymmetryDeviation(directions, problem.symmetries);
  }
  return problem;
}

}  // namespace

absl::Status RotationBnbOptions::Validate() const {
  const auto check_least = [](const char* field, double value, double least) {
    return CheckRange(field, value, least, std::numeric_limits<double>::infinity(), OpenEnds::kHigh);
  };
  EVPOSE_RETURN_IF_ERROR(CheckRange("rotation_bnb.inlier_rad", inlier_rad, 0.0, 0.5, OpenEnds::kBoth));
  EVPOSE_RETURN_IF_ERROR(check_least("rotation_bnb.max_branches", static_cast<double>(max_branches), 1));
  EVPOSE_RETURN_IF_ERROR(
      check_least("rotation_bnb.max_plateau_branches", static_cast<double>(max_plateau_branches), 0));
  EVPOSE_RETURN_IF_ERROR(check_least("rotation_bnb.max_rotations", max_rotations, 1));
  return CheckRange("rotation_bnb.distinct_rad", distinct_rad, 0.0, kPi, OpenEnds::kBoth);
}

absl::StatusOr<RotationBnbResult> MaximisePerpendicular(absl::Span<const Eigen::Vector3d> normals,
                                                        absl::Span<const Eigen::Vector3d> directions,
                                                        const RotationBnbOptions& options,
                                                        Correspondences correspondences) {
  EVPOSE_ASSIGN_OR_RETURN(const Problem problem, MakeProblem(normals, directions, correspondences, options));
  BranchAndBound search(problem, options);
  search.Search();
  if (search.lower_bound() == search.upper_bound()) search.ExplorePlateau();
  return search.Result();
}

absl::StatusOr<RotationCertificate> CertifyRotation(absl::Span<const Eigen::Vector3d> normals,
                                                    absl::Span<const Eigen::Vector3d> directions,
                                                    const Eigen::Matrix3d& camera_from_object,
                                                    const RotationBnbOptions& options) {
  EVPOSE_ASSIGN_OR_RETURN(const Problem problem, MakeProblem(normals, directions, Correspondences::kUnknown, options));
  const Eigen::Matrix3d error = camera_from_object.transpose() * camera_from_object - Eigen::Matrix3d::Identity();
  if (!(error.norm() <= 1e-6) || camera_from_object.determinant() < 0.0) {
    return absl::InvalidArgumentError("camera_from_object: not a rotation matrix");
  }
  RotationCertificate certificate;
  certificate.count = CountPerpendicular(normals, directions, camera_from_object, options.inlier_rad);
  BranchAndBound search(problem, options);
  search.Offer(camera_from_object);
  search.StopAbove(certificate.count);
  search.Search();
  const RotationBnbResult result = search.Result();
  certificate.upper_bound = result.upper_bound;
  certificate.branches = result.branches;
  if (result.lower_bound > certificate.count) {
    certificate.optimality = RotationOptimality::kNotMaximum;
    certificate.better = result.rotations.front();
  } else if (result.is_certified()) {
    certificate.optimality = RotationOptimality::kMaximum;
  }
  return certificate;
}

}  // namespace evpose

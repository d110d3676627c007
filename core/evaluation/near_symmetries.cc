// SPDX-License-Identifier: Apache-2.0
#include "core/evaluation/near_symmetries.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <utility>

#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/evaluation/oriented_samples.h"
#include "core/models/continuous_symmetry.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr size_t kMaxNear = 16;  // those of a cube with a mark, without the inverse rotations
// Rotations nearer to each other are the same, rad: the refinement ends within it. So are rotations that move no part
// by more than twice the tolerance against each other, as small ones about the axis of a long, thin object.
constexpr double kSameRad = 0.05;
// Angles that are no symmetry of common objects. Only the first, the golden section of a turn, is refined; on a gear
// the refinement may move it to the nearest tooth.
constexpr double kNoSymmetryRad = 2.4;
constexpr std::array<double, 3> kFurtherRad = {0.93, 1.49, 2.89};
// Reach of the refinement, relative to the diameter: first, and by how much it shrinks. The first one covers an axis
// that the difference itself tilts by 7 degrees.
constexpr double kFirstReach = 0.06, kShrink = 0.6;
constexpr int kIterations = 6;
// Samples of the edges and of the surface: those that decide whether a rotation is refined, those from which it is
// refined, and those that are counted.
constexpr size_t kTried = 64, kRefined = 400, kCounted = 8000;
// Share of the tried samples that must have a counterpart within the first reach.
constexpr double kPromising = 0.7;

struct Similarity {
  double differing = 0.0;  // share, by weight
  double sum2_m2 = 0.0;    // of the distances of the others
  size_t matched = 0;      // their number
};

// The edges or the surface of a model.
class SampledPart {
 public:
  SampledPart(std::vector<OrientedSample> samples, bool is_surface, double spacing_m, double diameter_m)
      : index_(std::move(samples), is_surface, kFirstReach * diameter_m), spacing_m_(spacing_m) {}

  bool empty() const { return index_.samples().empty(); }
  absl::Span<const OrientedSample> samples() const { return index_.samples(); }

  // Calls `visit(moved sample, counterpart or null)` for at most `count` samples, evenly spread.
  template <typename Visit>
  void Match(const RigidTransform& motion, double reach_m, size_t count, const Visit& visit) const {
    const absl::Span<const OrientedSample> all = samples();
    const size_t used = std::min(count, all.size());
    for (size_t i = 0; i < used; ++i) {
      const OrientedSample& sample = all[i * all.size() / used];
      const OrientedSample moved = {motion * sample.point, motion.rotation * sample.direction, sample.weight};
      visit(moved, index_.Nearest(moved, reach_m));
    }
  }

  // Share of the samples that have a counterpart.
  double RoughShare(const RigidTransform& motion, double reach_m) const {
    size_t matched = 0, tried = 0;
    Match(motion, reach_m, kTried, [&](const OrientedSample&, const OrientedSample* nearest) {
      ++tried;
      matched += nearest != nullptr ? 1 : 0;
    });
    return tried > 0 ? static_cast<double>(matched) / static_cast<double>(tried) : 1.0;
  }

  // Adds the normal equations of the motion [translation, rotation] that brings moved samples onto their counterparts,
  // all samples together with the weight given. Residuals: across an edge, or along the normal of the surface.
  void AddEquations(const RigidTransform& motion, double reach_m, double weight, Matrix6d& information,
                    Vector6d& right_side) const {
    Matrix6d sum = Matrix6d::Zero();
    Vector6d rhs = Vector6d::Zero();
    size_t matched = 0;
    Match(motion, reach_m, kRefined, [&](const OrientedSample& moved, const OrientedSample* nearest) {
      if (nearest == nullptr) return;
      Eigen::Matrix<double, 3, 6> jacobian;
      jacobian << Matrix3d::Identity(), -Hat(moved.point);
      const Matrix3d across = index_.Across(*nearest);
      sum += jacobian.transpose() * across * jacobian;
      rhs += jacobian.transpose() * across * (nearest->point - moved.point);
      ++matched;
    });
    if (matched == 0) return;
    information += weight / static_cast<double>(matched) * sum;
    right_side += weight / static_cast<double>(matched) * rhs;
  }

  // Counts what has no counterpart under the motion.
  Similarity Compare(const RigidTransform& motion, double tolerance_m) const {
    Similarity result;
    double all = 0.0, same = 0.0;
    // The nearest sample is at most half a spacing away along an edge, and about as far in a surface.
    const double reach_m = std::hypot(tolerance_m, spacing_m_);
    Match(motion, reach_m, kCounted, [&](const OrientedSample& moved, const OrientedSample* nearest) {
      all += moved.weight;
      if (nearest == nullptr) return;
      const double distance_m = (index_.Across(*nearest) * (nearest->point - moved.point)).norm();
      if (distance_m > tolerance_m) return;
      same += moved.weight;
      ++result.matched;
      result.sum2_m2 += distance_m * distance_m;
    });
    if (all > 0.0) result.differing = (all - same) / all;
    return result;
  }

 private:
  OrientedIndex index_;
  double spacing_m_;
};

class NearSymmetrySearch {
 public:
  NearSymmetrySearch(const ObjectModel& model, double contour_share, const NearSymmetryOptions& options)
      : model_(model),
        options_(options),
        contour_share_(contour_share),
        edges_(SampleEdges(model), false, EdgeSpacing(model), model.diameter_m),
        surface_(SampleSurface(model), true, SurfaceSpacing(model), model.diameter_m) {
    Vector3d sum = Vector3d::Zero();
    const SampledPart& of_centre = surface_.empty() ? edges_ : surface_;
    for (const OrientedSample& sample : of_centre.samples()) sum += sample.point;
    if (!of_centre.empty()) centre_ = sum / static_cast<double>(of_centre.samples().size());
  }

  std::vector<NearSymmetry> Run() {
    if (edges_.empty() && surface_.empty()) return {};
    const std::vector<Vector3d> axes = CandidateAxes(model_, edges_.samples(), surface_.samples());
    std::vector<Vector3d> others;
    for (const Vector3d& axis : axes) {
      if (const auto any = TestAnyAngle(axis)) {
        Add(*any);
      } else {
        others.push_back(axis);
      }
    }
    for (const double degrees : {180.0, 120.0, 90.0, 72.0, 144.0, 60.0, 45.0, 135.0, 36.0, 108.0, 30.0, 150.0}) {
      for (const Vector3d& axis : others) {
        if (const auto near = Test(axis, degrees / kDegreesPerRadian)) Add(*near);
      }
    }
    std::stable_sort(found_.begin(), found_.end(), [](const NearSymmetry& a, const NearSymmetry& b) {
      return a.differing_share < b.differing_share;
    });
    if (found_.size() > kMaxNear) found_.resize(kMaxNear);
    return std::move(found_);
  }

 private:
  // nullopt if the rotation, refined, is a symmetry, or too much of the object differs.
  std::optional<NearSymmetry> Test(const Vector3d& axis, double angle_rad) const {
    RigidTransform motion = RotationAbout(centre_, ExpSo3(angle_rad * axis));
    if (IsSymmetry(motion.rotation)) return std::nullopt;
    double reach_m = kFirstReach * model_.diameter_m;
    if (Weighted(edges_.RoughShare(motion, reach_m), surface_.RoughShare(motion, reach_m)) < kPromising) {
      return std::nullopt;
    }
    for (int i = 0; i < kIterations; ++i) {
      motion = Improved(motion, reach_m);
      reach_m = std::max(kShrink * reach_m, 2.0 * options_.tolerance_ratio * model_.diameter_m);
    }
    if (IsSymmetry(motion.rotation)) return std::nullopt;
    return Measure(motion);
  }

  // Tests several rotations about the axis. Returns the one that differs most; nullopt if one of them is not near.
  std::optional<NearSymmetry> TestAnyAngle(const Vector3d& axis) const {
    const std::optional<NearSymmetry> first = Test(axis, kNoSymmetryRad);
    if (!first) return std::nullopt;
    NearSymmetry least = *first;
    // The point of the refined axis that is nearest to the centre: it moves along the axis alone.
    const auto& [rotation, translation_m] = first->object_from_object;
    const Vector3d& unit = first->axis;
    const Matrix3d along = unit * unit.transpose(), across = Matrix3d::Identity() - along;
    const Vector3d point =
        (Matrix3d::Identity() - rotation + along).inverse() * (across * translation_m + along * centre_);
    for (const double angle_rad : kFurtherRad) {
      const std::optional<NearSymmetry> further = Measure(RotationAbout(point, ExpSo3(angle_rad * unit)));
      if (!further) return std::nullopt;
      if (further->differing_share > least.differing_share) least = *further;
    }
    least.is_any_angle = true;
    return least;
  }

  // The mean of values of edges and of the surface.
  double Weighted(double of_edges, double of_surface) const {
    return (1.0 - contour_share_) * of_edges + contour_share_ * of_surface;
  }

  bool IsSymmetry(const Matrix3d& rotation) const {
    return AreSame(NearestEquivalent(RigidTransform(), model_, {rotation, Vector3d::Zero()}).rotation, rotation);
  }

  bool AreSame(const Matrix3d& a, const Matrix3d& b) const {
    return RotationAngle(a, b) <= kSameRad ||
           LargestMovement(a - b) <= 2.0 * options_.tolerance_ratio * model_.diameter_m;
  }

  // The largest distance between the positions of a sample that two rotations about the centre give.
  double LargestMovement(const Matrix3d& difference) const {
    double largest_m = 0.0;
    for (const SampledPart* part : {&edges_, &surface_}) {
      for (const OrientedSample& sample : part->samples()) {
        largest_m = std::max(largest_m, (difference * (sample.point - centre_)).norm());
      }
    }
    return largest_m;
  }

  RigidTransform Improved(const RigidTransform& motion, double reach_m) const {
    Matrix6d information = Matrix6d::Zero();
    Vector6d right_side = Vector6d::Zero();
    edges_.AddEquations(motion, reach_m, Weighted(1.0, 0.0), information, right_side);
    surface_.AddEquations(motion, reach_m, Weighted(0.0, 1.0), information, right_side);
    // No motion along a direction without information.
    constexpr double kDamping = 1e-6;
    const double length2 = model_.diameter_m * model_.diameter_m;
    information.topLeftCorner<3, 3>().diagonal().array() += kDamping;
    information.bottomRightCorner<3, 3>().diagonal().array() += kDamping * length2;
    const Vector6d step = information.ldlt().solve(right_side);
    const Matrix3d turn = ExpSo3(step.tail<3>());
    RigidTransform improved = RigidTransform{turn, step.head<3>()} * motion;
    improved.rotation = improved.Quaternion().toRotationMatrix();
    return improved;
  }

  std::optional<NearSymmetry> Measure(const RigidTransform& motion) const {
    const double tolerance_m = options_.tolerance_ratio * model_.diameter_m;
    const RigidTransform inverse = motion.Inverse();
    const Similarity edges[] = {edges_.Compare(motion, tolerance_m), edges_.Compare(inverse, tolerance_m)};
    const Similarity surface[] = {surface_.Compare(motion, tolerance_m), surface_.Compare(inverse, tolerance_m)};
    NearSymmetry near;
    near.differing_edges = 0.5 * (edges[0].differing + edges[1].differing);
    near.differing_contours = 0.5 * (surface[0].differing + surface[1].differing);
    near.differing_share = Weighted(near.differing_edges, near.differing_contours);
    if (near.differing_share > options_.max_differing_share) return std::nullopt;
    double sum2_m2 = 0.0;
    size_t matched = 0;
    for (const Similarity& similarity : {edges[0], edges[1], surface[0], surface[1]}) {
      sum2_m2 += similarity.sum2_m2;
      matched += similarity.matched;
    }
    if (matched == 0) return std::nullopt;
    near.displacement_ratio = std::sqrt(sum2_m2 / static_cast<double>(matched)) / model_.diameter_m;
    const Vector3d rotation_rad = LogSo3(motion.rotation);
    near.angle_rad = rotation_rad.norm();
    near.axis = rotation_rad.normalized();
    near.object_from_object = motion;
    Eigen::Index largest = 0;
    near.axis.cwiseAbs().maxCoeff(&largest);
    if (near.axis[largest] < 0.0) {
      near.axis = -near.axis;
      near.object_from_object = inverse;
    }
    return near;
  }

  // Adds `near`, unless an earlier entry equals it up to a symmetry of the model, or up to a rotation about an axis of
  // any angle.
  void Add(const NearSymmetry& near) {
    constexpr double kAlongAxis = 0.995, kAcrossAxis = 0.1;  // 6 degrees
    for (const NearSymmetry& other : found_) {
      if (IsSame(near.object_from_object, other.object_from_object)) return;
      if (IsSame(near.object_from_object.Inverse(), other.object_from_object)) return;
      if (other.is_any_angle && std::abs(near.axis.dot(other.axis)) > kAlongAxis) return;
      // Turned about that axis, too, all half turns across it are the same.
      if (near.is_any_angle || other.is_any_angle) continue;
      const auto is_across = [](const Vector3d& axis, const NearSymmetry& any) {
        return any.is_any_angle && std::abs(axis.dot(any.axis)) < kAcrossAxis;
      };
      for (const NearSymmetry& any : found_) {
        if (is_across(near.axis, any) && is_across(other.axis, any)) return;
      }
    }
    found_.push_back(near);
  }

  bool IsSame(const RigidTransform& a, const RigidTransform& b) const {
    return AreSame(NearestEquivalent(a, model_, b).rotation, b.rotation);
  }

  const ObjectModel& model_;
  const NearSymmetryOptions options_;
  const double contour_share_;
  const SampledPart edges_;
  const SampledPart surface_;
  Vector3d centre_ = Vector3d::Zero();
  std::vector<NearSymmetry> found_;
};

}  // namespace

absl::Status NearSymmetryOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("tolerance_ratio", tolerance_ratio, 1e-3, 0.05));
  return CheckRange("max_differing_share", max_differing_share, 0.0, 0.5);
}

absl::StatusOr<std::vector<NearSymmetry>> FindNearSymmetries(const ObjectModel& model, double contour_share,
                                                             const NearSymmetryOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_RETURN_IF_ERROR(CheckRange("contour_share", contour_share, 0.0, 1.0));
  if (!(model.diameter_m > 0.0)) return std::vector<NearSymmetry>();
  return NearSymmetrySearch(model, contour_share, options).Run();
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/models/symmetry.h"

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <map>
#include <memory>
#include <numbers>
#include <optional>
#include <utility>

#include "absl/strings/str_format.h"
#include "core/geometry/half_turn.h"
#include "core/models/symmetry_lines.h"
#include "core/models/symmetry_surface.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// Models with more lines and curves are not searched: objects of so many edges have hardly any symmetry.
constexpr size_t kMaxLines = 8192;
// Largest number of symmetries: that of a prism of 2048 sides, which differs from a cylinder by 1e-6 of its radius.
constexpr size_t kMaxSymmetries = 4096;
// Limit of the searches for the image of one line, which take some seconds.
constexpr int64_t kMaxComparisons = 5'000'000;
// Comparisons of two rotations, and points of the surface that are searched: some seconds each. A search of a prism of
// 1365 sides takes a tenth of the former; one test of a rotation takes up to 28,672 of the latter.
constexpr int64_t kMaxRotationComparisons = 20'000'000;
constexpr int64_t kMaxSurfaceSamples = 1'000'000;
// Angle, rad, of the power of a rotation that is tested, too: the golden section of a turn is no common symmetry.
constexpr double kLargeAngle = 2.4;
// Lines from which a rotation is refined; all lines are compared once before it is accepted.
constexpr size_t kMaxRefiningLines = 64;

// Largest distance, in units of the tolerance, between a line and its image under a rotation from two points before it
// is refined: the error of two points grows towards the other end of the object.
constexpr double kRoughTolerance = 8.0;
// Rotations whose images of the outermost point are at most this far apart are the same.
constexpr double kSameRotation = 1.5;
// A rotation from two points that is this near to a known one is not refined: the result would be the known one.
constexpr double kKnownRotation = 0.1;
// Largest distance of the image of a point of a ring from a ring.
constexpr double kOnOutline = 2.0;
// Maximum distance for the product of two rotations that are each within one tolerance.
constexpr double kProductTolerance = 2.0;

// Two points of the model, whose images determine a rotation about the centre, and the possible images of each.
struct TwoPoints {
  Vector3d p, q;
  std::vector<Vector3d> images_of_p, images_of_q;
};

// Columns: the direction of p, the perpendicular to it in the plane of p and q, and the normal of that plane.
Matrix3d Frame(const Vector3d& p, const Vector3d& q) {
  Matrix3d frame;
  frame.col(0) = p.normalized();
  frame.col(2) = p.cross(q).normalized();
  frame.col(1) = frame.col(2).cross(frame.col(0));
  return frame;
}

// The rotation that maps one set of vectors onto the other with the least sum of squares, from the sum of to * from^T
// (Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976).
Matrix3d BestRotation(const Matrix3d& sum) {
  const Eigen::JacobiSVD<Matrix3d> svd(sum, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const double sign = svd.matrixU().determinant() * svd.matrixV().determinant() < 0.0 ? -1.0 : 1.0;
  return svd.matrixU() * Vector3d(1.0, 1.0, sign).asDiagonal() * svd.matrixV().transpose();
}

// The ends of the segments without those that are within the tolerance of another one, sorted by x.
std::vector<Vector3d> DistinctEnds(absl::Span<const ModelLine> segments, double tolerance_m) {
  std::vector<Vector3d> ends;
  for (const ModelLine& segment : segments) {
    ends.push_back(segment.p1);
    ends.push_back(segment.p2);
  }
  const auto less = [](const Vector3d& a, const Vector3d& b) { return a.x() < b.x(); };
  std::stable_sort(ends.begin(), ends.end(), less);
  std::vector<Vector3d> distinct;
  for (const Vector3d& end : ends) {
    const auto first = std::lower_bound(distinct.begin(), distinct.end(), end - Vector3d(tolerance_m, 0, 0), less);
    const auto is_same = [&](const Vector3d& other) { return (other - end).norm() <= tolerance_m; };
    if (std::none_of(first, distinct.end(), is_same)) distinct.push_back(end);
  }
  return distinct;
}

std::vector<Vector3d> PointsAtRadius(const std::vector<Vector3d>& points, double radius_m, double tolerance_m) {
  std::vector<Vector3d> found;
  for (const Vector3d& point : points) {
    if (std::abs(point.norm() - radius_m) <= tolerance_m) found.push_back(point);
  }
  return found;
}

// Returns the point with the fewest others at its distance from the centre, among those with a large lever: the
// distance from the centre, or from an axis, over which the point determines a rotation.
size_t RarestPoint(const std::vector<Vector3d>& points, const std::vector<double>& lever_m, double tolerance_m) {
  constexpr double kFarEnough =
      0.3;  // relative to the largest lever; a shorter one magnifies errors more than three times
  std::vector<double> radii;
  for (const Vector3d& point : points) radii.push_back(point.norm());
  std::sort(radii.begin(), radii.end());
  const double least_m = kFarEnough * *std::max_element(lever_m.begin(), lever_m.end());
  size_t rarest = 0, fewest = points.size() + 1;
  for (size_t i = 0; i < points.size(); ++i) {
    if (lever_m[i] < least_m) continue;
    const double radius = points[i].norm();
    const size_t count = std::upper_bound(radii.begin(), radii.end(), radius + tolerance_m) -
                         std::lower_bound(radii.begin(), radii.end(), radius - tolerance_m);
    if (count >= fewest) continue;
    fewest = count;
    rarest = i;
  }
  return rarest;
}

// nullopt if all points lie on one axis through the centre: a rotation about it leaves them in place.
std::optional<TwoPoints> ChooseTwoPoints(const std::vector<Vector3d>& points, double tolerance_m) {
  if (points.empty()) return std::nullopt;
  std::vector<double> lever_m;
  for (const Vector3d& point : points) lever_m.push_back(point.norm());
  TwoPoints two;
  two.p = points[RarestPoint(points, lever_m, 2.0 * tolerance_m)];
  const Vector3d axis = two.p.normalized();
  for (size_t i = 0; i < points.size(); ++i) lever_m[i] = axis.cross(points[i]).norm();
  if (*std::max_element(lever_m.begin(), lever_m.end()) <= kRoughTolerance * tolerance_m) return std::nullopt;
  two.q = points[RarestPoint(points, lever_m, 2.0 * tolerance_m)];
  two.images_of_p = PointsAtRadius(points, two.p.norm(), 2.0 * tolerance_m);
  two.images_of_q = PointsAtRadius(points, two.q.norm(), 2.0 * tolerance_m);
  return two;
}

// Rotations that are searched by their distance, in a time that hardly depends on their number.
class RotationSet {
 public:
  void Add(const Matrix3d& rotation) {
    by_projection_.emplace(Projection(rotation), rotations_.size());
    rotations_.push_back(rotation);
  }

  // Whether the Frobenius norm of the difference to a rotation of the set is at most `distance`. Adds the number of
  // compared rotations to `comparisons`.
  bool Contains(const Matrix3d& rotation, double distance, int64_t& comparisons) const {
    const double projection = Projection(rotation);
    const auto end = by_projection_.upper_bound(projection + distance);
    for (auto entry = by_projection_.lower_bound(projection - distance); entry != end; ++entry) {
      ++comparisons;
      if ((rotations_[entry->second] - rotation).squaredNorm() <= distance * distance) return true;
    }
    return false;
  }

  const std::vector<Matrix3d>& rotations() const { return rotations_; }

 private:
  // The scalar product with a matrix of norm below 1, so that projections differ by less than the matrices. It is
  // oblique to all axes, so that few rotations of a group have nearly the same projection.
  static double Projection(const Matrix3d& rotation) {
    constexpr double kDirection[] = {0.41, -0.23, 0.31, 0.19, 0.37, -0.29, -0.43, 0.17, 0.35};
    double sum = 0.0;
    for (int i = 0; i < 9; ++i) sum += kDirection[i] * rotation(i / 3, i % 3);
    return sum;
  }

  std::vector<Matrix3d> rotations_;
  std::multimap<double, size_t> by_projection_;
};

// Completes the group by products of accepted rotations, so that only few rotations of a large group are tested in
// full.
class GroupSearch {
 public:
  GroupSearch(const ObjectModel& model, double tolerance_m)
      : model_(model),
        tolerance_m_(tolerance_m),
        surface_tolerance_m_(tolerance_m + (model.curves.empty() ? 0.0 : AllowedSagitta(model))),
        lines_(model, kRoughTolerance * tolerance_m) {
    group_.Add(Matrix3d::Identity());
    for (const ModelLine& segment : lines_.segments()) {
      radius_m_ = std::max({radius_m_, segment.p1.norm(), segment.p2.norm()});
    }
  }

  void Run() {
    const std::vector<Vector3d> ends = DistinctEnds(lines_.segments(), 0.5 * tolerance_m_);
    const std::optional<TwoPoints> two = ChooseTwoPoints(ends, tolerance_m_);
    if (!two.has_value()) return RunAboutAxis();
    const Matrix3d from = Frame(two->p, two->q).transpose();
    const double distance_m = (two->p - two->q).norm();
    for (const Vector3d& p : two->images_of_p) {
      for (const Vector3d& q : two->images_of_q) {
        if (std::abs((p - q).norm() - distance_m) > 4.0 * tolerance_m_) continue;
        if (was_cut_short_) return;
        Consider(Frame(p, q) * from);
      }
    }
  }

  const Vector3d& centre() const { return lines_.centre(); }
  const std::vector<Matrix3d>& group() const { return group_.rotations(); }
  const SymmetryWork& work() const { return work_; }
  bool was_cut_short() const { return was_cut_short_; }

 private:
  // Finds the symmetries of a model all of whose segments lie on one axis, as those of a fluted vase. A symmetry that
  // leaves the axis maps the lobes of each ring onto each other: it is a rotation by a whole number of lobes. One that
  // turns the axis over maps a lobe of one ring onto some lobe of another.
  void RunAboutAxis() {
    Vector3d axis = Vector3d::Zero();
    for (const ModelLine& segment : lines_.segments()) {
      for (const Vector3d& end : {segment.p1, segment.p2}) axis = end.norm() > axis.norm() ? end : axis;
    }
    if (!(axis.norm() > tolerance_m_)) return;
    axis.normalize();
    std::vector<double> fewest;
    for (size_t i = 0; i < lines_.segments().size(); ++i) {
      const std::vector<double> lobes = lines_.LobesOf(i, axis, tolerance_m_);
      if (!lobes.empty() && (fewest.empty() || lobes.size() < fewest.size())) fewest = lobes;
    }
    for (size_t order = fewest.size(); order >= 2; --order) {
      const double step_rad = 2.0 * std::numbers::pi / static_cast<double>(order);
      if (fewest.size() % order != 0 || !IsSymmetryAboutAxis(axis, step_rad)) continue;
      for (size_t k = 1; k < order; ++k) group_.Add(ExpSo3(static_cast<double>(k) * step_rad * axis));
      break;
    }
    if (!fewest.empty()) FindFlip(axis, fewest.front());
  }

  bool IsSymmetryAboutAxis(const Vector3d& axis, double angle_rad) {
    const double large_rad = angle_rad * std::max(1.0, std::round(kLargeAngle / angle_rad));
    return Maps(ExpSo3(large_rad * axis)) && Maps(ExpSo3(angle_rad * axis));
  }

  bool Maps(const Matrix3d& rotation) { return MapsAllLines(rotation) && MapsSurface(rotation); }

  void FindFlip(const Vector3d& axis, double lobe_rad) {
    const Vector3d first = axis.unitOrthogonal(), second = axis.cross(first);
    for (size_t i = 0; i < lines_.segments().size(); ++i) {
      for (const double other_rad : lines_.LobesOf(i, axis, tolerance_m_)) {
        if (was_cut_short_) return;
        const auto [sin, cos] = DeterministicSinCos(0.5 * (lobe_rad + other_rad));
        const Vector3d across = cos * first + sin * second;
        const Matrix3d half_turn = HalfTurn(across);
        if (!Maps(half_turn)) continue;
        const std::vector<Matrix3d> upright = group_.rotations();
        for (const Matrix3d& rotation : upright) group_.Add(half_turn * rotation);
        return;
      }
    }
  }

  void Consider(const Matrix3d& rough) {
    if (IsIn(group_, rough, kKnownRotation)) return;
    const std::optional<Matrix3d> rotation = Refine(rough, {kRoughTolerance, kRoughTolerance}, 1.0);
    if (!rotation.has_value() || IsIn(group_, *rotation, kSameRotation)) return;
    const std::optional<Matrix3d> power = LargePower(*rotation);
    if (!power.has_value() || !MapsSurface(*power) || !MapsSurface(*rotation)) return;
    if (MapsAllLines(*rotation)) AddGenerator(*rotation);
  }

  bool MapsSurface(const Matrix3d& rotation) {
    if (surface_ == nullptr) surface_ = std::make_unique<CentredSurface>(model_, lines_.centre(), surface_tolerance_m_);
    const bool is_mapped = surface_->IsMappedOntoItself(rotation, kMaxSurfaceSamples, work_.surface_samples, witness_);
    was_cut_short_ |= work_.surface_samples >= kMaxSurfaceSamples;
    return is_mapped;
  }

  // A rotation by a small angle moves a small part near the axis by less than the tolerance, so that the part does not
  // contradict it. A power of the rotation by about kLargeAngle, which is a symmetry if the rotation is, does so.
  // Returns the refined power, the rotation itself if its angle is large, and nullopt if the power maps lines off
  // lines.
  std::optional<Matrix3d> LargePower(const Matrix3d& rotation) {
    // Radians: from here on the power is not needed, because the rotation moves every part by about its distance from
    // the axis.
    constexpr double kSmallAngle = 1.0;  // rad
    const double angle = RotationAngle(rotation, Matrix3d::Identity());
    if (angle >= kSmallAngle || angle * radius_m_ <= tolerance_m_) return rotation;
    // Binary exponentiation. Each product is refined, so that errors do not add up.
    Matrix3d power = Matrix3d::Identity(), square = rotation;
    for (auto exponent = static_cast<uint64_t>(std::lround(kLargeAngle / angle)); exponent > 0; exponent /= 2) {
      if (exponent % 2 == 1) {
        const std::optional<Matrix3d> product = Refine(power * square, {kProductTolerance}, kProductTolerance);
        if (!product.has_value()) return std::nullopt;
        power = *product;
      }
      if (exponent == 1) break;
      const std::optional<Matrix3d> product = Refine(square * square, {kProductTolerance}, kProductTolerance);
      if (!product.has_value()) return std::nullopt;
      square = *product;
    }
    return power;
  }

  // Whether the set contains the rotation, up to a distance of that many tolerances at the outermost point.
  bool IsIn(const RotationSet& set, const Matrix3d& rotation, double tolerances) {
    // The Frobenius norm of the difference of two rotations is sqrt(2) times the angle between them, if it is small.
    const bool is_in =
        set.Contains(rotation, std::sqrt(2.0) * tolerances * tolerance_m_ / radius_m_, work_.rotation_comparisons);
    was_cut_short_ |= work_.rotation_comparisons >= kMaxRotationComparisons;
    return is_in;
  }

  // Refines a rotation in rounds: each pairs lines that are at most so many tolerances apart, and computes the best
  // rotation for the pairs. Uses a sample if there are many lines. nullopt if a line has no partner, or has none within
  // `tolerances` at the end.
  std::optional<Matrix3d> Refine(Matrix3d rotation, std::initializer_list<double> rounds, double tolerances) {
    for (const double allowed : rounds) {
      const std::optional<Matrix3d> sum = SumOfPairs(rotation, allowed);
      if (!sum.has_value()) return std::nullopt;
      rotation = BestRotation(*sum);
    }
    if (!SumOfPairs(rotation, tolerances).has_value()) return std::nullopt;
    return rotation;
  }

  // The sum of to * from^T over the ends of paired lines; nullopt if a line has no partner.
  std::optional<Matrix3d> SumOfPairs(const Matrix3d& rotation, double allowed) {
    const absl::Span<const ModelLine> segments = lines_.segments();
    const size_t count = std::min(segments.size(), kMaxRefiningLines);
    Matrix3d sum = Matrix3d::Zero();
    for (size_t i = 0; i < count; ++i) {
      const size_t segment = i * segments.size() / count;
      const auto match = Compare(rotation, segment, allowed);
      if (!match.has_value()) return std::nullopt;
      const ModelLine &from = segments[segment], &to = segments[match->index];
      sum += (match->is_reversed ? to.p2 : to.p1) * from.p1.transpose();
      sum += (match->is_reversed ? to.p1 : to.p2) * from.p2.transpose();
    }
    return sum;
  }

  bool MapsAllLines(const Matrix3d& rotation) {
    for (size_t i = 0; i < lines_.segments().size(); ++i) {
      const auto match = Compare(rotation, i, 1.0);
      if (!match.has_value() || !MapsOutline(rotation, i, match->index)) return false;
    }
    return true;
  }

  // Whether the rotated points of a ring lie on the ring that has the same axis and radius.
  bool MapsOutline(const Matrix3d& rotation, size_t from, size_t to) {
    const absl::Span<const Vector3d> points = lines_.outline(from), ring = lines_.outline(to);
    if (points.empty() != ring.empty()) return false;
    const double allowed_m = kOnOutline * tolerance_m_;
    for (const Vector3d& point : points) {
      if (++work_.line_comparisons > kMaxComparisons) {
        was_cut_short_ = true;
        return false;
      }
      const Vector3d image = rotation * point;
      bool is_near = false;
      for (size_t i = 0; i + 1 < ring.size() && !is_near; ++i) {
        const Vector3d along = ring[i + 1] - ring[i], offset = image - ring[i];
        const double length2 = along.squaredNorm();
        const double position = length2 > 0.0 ? std::clamp(offset.dot(along) / length2, 0.0, 1.0) : 0.0;
        is_near = (offset - position * along).squaredNorm() <= allowed_m * allowed_m;
      }
      if (!is_near) return false;
    }
    return true;
  }

  std::optional<CentredSegments::Match> Compare(const Matrix3d& rotation, size_t segment, double tolerances) {
    if (++work_.line_comparisons > kMaxComparisons) {
      was_cut_short_ = true;
      return std::nullopt;
    }
    return lines_.Find(rotation, segment, tolerances * tolerance_m_);
  }

  // Adds all products of the group and a rotation that it does not contain. If a product does not map the lines onto
  // lines, because tolerances have added up, the group stays as it is.
  void AddGenerator(const Matrix3d& rotation) {
    RotationSet grown = group_;
    work_.rotation_comparisons += static_cast<int64_t>(grown.rotations().size());
    std::vector<Matrix3d> generators = generators_;
    generators.push_back(rotation);
    for (size_t i = 0; i < grown.rotations().size(); ++i) {
      for (const Matrix3d& generator : generators) {
        if (was_cut_short_) return;
        const Matrix3d product = grown.rotations()[i] * generator;
        if (IsIn(grown, product, kSameRotation)) continue;
        const std::optional<Matrix3d> refined = Refine(product, {kProductTolerance}, kProductTolerance);
        if (!refined.has_value()) return;
        if (grown.rotations().size() >= kMaxSymmetries) {
          was_cut_short_ = true;
          return;
        }
        grown.Add(*refined);
      }
    }
    group_ = std::move(grown);
    generators_ = std::move(generators);
  }

  const ObjectModel& model_;
  const double tolerance_m_;
  const double surface_tolerance_m_;  // the chords of one facet need not be mapped onto those of another
  const CentredSegments lines_;
  double radius_m_ = 0.0;
  size_t witness_ = 0;                       // sample of the surface that has contradicted a rotation
  std::unique_ptr<CentredSurface> surface_;  // built for the first rotation that needs it; most models have none
  RotationSet group_;                        // the identity first
  std::vector<Matrix3d> generators_;
  SymmetryWork work_;
  bool was_cut_short_ = false;
};

std::vector<RigidTransform> AboutCentre(const std::vector<Matrix3d>& rotations, const Vector3d& centre) {
  std::vector<RigidTransform> motions;
  for (const Matrix3d& rotation : rotations) motions.push_back(RotationAbout(centre, rotation));
  motions[0] = RigidTransform();  // exactly; the centre would leave rounding errors
  return motions;
}

void AddNotice(std::string notice, std::vector<std::string>* notices) {
  if (notices != nullptr) notices->push_back(std::move(notice));
}

}  // namespace

std::vector<RigidTransform> FindSymmetries(const ObjectModel& model, double tolerance_ratio,
                                           std::vector<std::string>* notices, SymmetryWork* work) {
  if (model.continuous_symmetry.has_value()) return {};
  const double tolerance_m = tolerance_ratio * model.diameter_m;
  if (!(tolerance_m > 0.0)) return {RigidTransform()};
  if (model.lines.size() + model.curves.size() > kMaxLines) {
    AddNotice(absl::StrFormat("symmetries not searched: more than %d lines", kMaxLines), notices);
    return {RigidTransform()};
  }
  const auto note_if_cut_short = [notices](bool was_cut_short, size_t count) {
    if (!was_cut_short) return;
    AddNotice(absl::StrFormat("the search for symmetries ended early; the object may have more than %d", count),
              notices);
  };
  if (model.lines.empty() && model.curves.empty()) {
    const SurfaceGroup group = FindSurfaceGroup(model, tolerance_m, kMaxSurfaceSamples);
    if (work != nullptr) *work = {.surface_samples = group.num_samples};
    note_if_cut_short(group.was_cut_short, group.rotations.size());
    return AboutCentre(group.rotations, group.centre);
  }
  GroupSearch search(model, tolerance_m);
  search.Run();
  if (work != nullptr) *work = search.work();
  note_if_cut_short(search.was_cut_short(), search.group().size());
  return AboutCentre(search.group(), search.centre());
}

RigidTransform NearestEquivalent(const RigidTransform& camera_from_object, absl::Span<const RigidTransform> symmetries,
                                 const RigidTransform& reference) {
  // Traces that differ by less are equal: the choice between equivalent poses must not depend on rounding errors.
  constexpr double kRounding = 1e-9;
  const RigidTransform* nearest = nullptr;
  double largest_trace = 0.0;
  for (const RigidTransform& symmetry : symmetries) {
    const Matrix3d rotation = camera_from_object.rotation * symmetry.rotation;
    const double trace = reference.rotation.cwiseProduct(rotation).sum();
    if (nearest != nullptr && trace <= largest_trace + kRounding) continue;
    nearest = &symmetry;
    largest_trace = trace;
  }
  return nearest == nullptr ? camera_from_object : camera_from_object * *nearest;
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/first_pose/pose_determinacy.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/SVD>
#include <algorithm>
#include <array>
#include <optional>
#include <set>

#include "core/baselines/first_pose/line_match.h"
#include "core/experiments/first_pose/pose_comparison.h"
#include "core/geometry/half_turn.h"

namespace evpose {
namespace {

using Eigen::Vector3d;

// Points closer than this, relative to the diameter of the model, are equal.
constexpr double kSamePointRatio = 1e-3;
// Two images are equal if the ends of their segments agree within this number of standard deviations.
constexpr double kSameLookSigmas = 2.0;
constexpr double kNumSigmas = 3.0;     // the tolerances of a right pose are at least this many standard deviations
constexpr int kMirrorIterations = 30;  // bounds the time of the descent to the mirrored pose

struct EndPoints {
  int line = 0;
  std::array<Vector3d, 2> object;  // end points of the visible part
  std::array<Vector3d, 2> bearing;
};

std::vector<EndPoints> EndPointsOf(const ObjectModel& model, const RigidTransform& pose,
                                   absl::Span<const VisibleSegment> visible) {
  std::vector<EndPoints> ends;
  for (const VisibleSegment& segment : visible) {
    const ModelLine& line = model.lines[segment.line];
    EndPoints e{
        segment.line, {line.p1 + segment.begin * (line.p2 - line.p1), line.p1 + segment.end * (line.p2 - line.p1)}, {}};
    for (int i = 0; i < 2; ++i) {
      const Vector3d point = pose * e.object[i];
      e.bearing[i] = point / point.z();
    }
    ends.push_back(e);
  }
  return ends;
}

std::optional<LineNormalEquations> Linearise(const CameraModel& camera, const RigidTransform& pose,
                                             const std::vector<EndPoints>& ends) {
  LineNormalEquations equations;
  for (const EndPoints& e : ends) {
    const auto line = ProjectLine(camera, pose, e.object[0], e.object[1]);
    if (!line) return std::nullopt;
    for (const Vector3d& bearing : e.bearing) equations.Add(*line, bearing);
  }
  return equations;
}

// Minimises the sum of squares locally by Levenberg-Marquardt; returns pose and cost.
std::pair<RigidTransform, double> Refine(const CameraModel& camera, RigidTransform pose,
                                         const std::vector<EndPoints>& ends) {
  double damping = 1e-3;
  std::optional<LineNormalEquations> equations = Linearise(camera, pose, ends);
  for (int i = 0; equations && i < kMirrorIterations; ++i) {
    Matrix6d hessian = equations->hessian;
    hessian.diagonal() *= 1.0 + damping;
    const RigidTransform next = Perturb(pose, -hessian.ldlt().solve(equations->gradient));
    const auto next_equations = Linearise(camera, next, ends);
    const bool is_better = next_equations && next_equations->cost_px2 < equations->cost_px2;
    damping *= is_better ? 0.1 : 10.0;
    if (!is_better) continue;
    pose = next;
    equations = next_equations;
  }
  return {pose, equations ? equations->cost_px2 : std::numeric_limits<double>::infinity()};
}

double LargestSigma(const Eigen::Matrix3d& covariance) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance, Eigen::EigenvaluesOnly);
  return std::sqrt(std::max(0.0, solver.eigenvalues().maxCoeff()));
}

// The pose with inverted depths about the centre of the visible points: the plane of these points keeps its image under
// weak perspective.
RigidTransform MirrorPose(const RigidTransform& pose, const std::vector<EndPoints>& ends) {
  Eigen::Matrix3Xd points(3, 2 * ends.size());
  for (size_t i = 0; i < ends.size(); ++i) {
    points.col(2 * i) = ends[i].object[0];
    points.col(2 * i + 1) = ends[i].object[1];
  }
  const Vector3d middle = points.rowwise().mean();
  points.colwise() -= middle;
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(points * points.transpose(), Eigen::ComputeFullU);
  const Vector3d plane_normal = svd.matrixU().col(2);
  const Vector3d middle_camera = pose * middle;
  const Vector3d sight = middle_camera.normalized();
  const Eigen::Matrix3d rotation = Reflection(sight) * pose.rotation * Reflection(plane_normal);
  return {rotation, middle_camera - rotation * middle};
}

bool SamePoint(const Vector3d& a, const Vector3d& b, double tolerance) {
  return (a - b).squaredNorm() < tolerance * tolerance;
}

// Whether the end points are equal, in either order.
bool SameEnds(const std::array<Vector3d, 2>& a, const std::array<Vector3d, 2>& b, double tolerance) {
  return (SamePoint(a[0], b[0], tolerance) && SamePoint(a[1], b[1], tolerance)) ||
         (SamePoint(a[0], b[1], tolerance) && SamePoint(a[1], b[0], tolerance));
}

// Returns the rigid motion that maps line a to c and line b to d, end by end; nullopt if they do not fit.
std::optional<RigidTransform> MotionBetween(const std::array<Vector3d, 4>& from, const std::array<Vector3d, 4>& to,
                                            double tolerance_m) {
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < i; ++j) {
      if (std::abs((from[i] - from[j]).norm() - (to[i] - to[j]).norm()) > tolerance_m) return std::nullopt;
    }
  }
  Eigen::Matrix<double, 3, 4> source, target;
  for (int i = 0; i < 4; ++i) {
    source.col(i) = from[i];
    target.col(i) = to[i];
  }
  const Eigen::Matrix4d motion = Eigen::umeyama(source, target, /*with_scaling=*/false);
  const RigidTransform transform{motion.topLeftCorner<3, 3>(), motion.topRightCorner<3, 1>()};
  for (int i = 0; i < 4; ++i) {
    if (!SamePoint(transform * from[i], to[i], tolerance_m)) return std::nullopt;
  }
  return transform;
}

bool MapsOntoLine(const ObjectModel& model, const RigidTransform& motion, const ModelLine& line, double tolerance_m) {
  const std::array<Vector3d, 2> moved = {motion * line.p1, motion * line.p2};
  return std::any_of(model.lines.begin(), model.lines.end(), [&](const ModelLine& other) {
    return SameEnds(moved, {other.p1, other.p2}, tolerance_m);
  });
}

// Returns the longest line and the line with the largest extent perpendicular to it.
std::pair<int, int> BaseLines(const ObjectModel& model, const std::set<int>& lines) {
  const auto extent = [&](int i) -> Vector3d { return model.lines[i].p2 - model.lines[i].p1; };
  const int first =
      *std::max_element(lines.begin(), lines.end(), [&](int i, int j) { return extent(i).norm() < extent(j).norm(); });
  const int second = *std::max_element(lines.begin(), lines.end(), [&](int i, int j) {
    return extent(first).cross(extent(i)).norm() < extent(first).cross(extent(j)).norm();
  });
  return {first, second};
}

}  // namespace

PoseDeterminacy::PoseDeterminacy(const ObjectModel& model, const CameraModel& camera,
                                 const VisibilityTester& visibility, double noise_px)
    : model_(model), camera_(camera), visibility_(visibility), noise_px_(noise_px) {}

bool PoseDeterminacy::IsDetermined(const RigidTransform& camera_from_object,
                                   absl::Span<const VisibleSegment> visible) const {
  if (visible.size() < 3) return false;
  return BoundAllowsErrors(camera_from_object, visible) && MirrorIsDistinguished(camera_from_object, visible) &&
         NothingLooksTheSame(camera_from_object, visible);
}

bool PoseDeterminacy::BoundAllowsErrors(const RigidTransform& pose, absl::Span<const VisibleSegment> visible) const {
  const auto equations = Linearise(camera_, pose, EndPointsOf(model_, pose, visible));
  if (!equations) return false;
  const Eigen::LDLT<Matrix6d> ldlt(equations->hessian);
  if (ldlt.info() != Eigen::Success || !ldlt.isPositive() || ldlt.rcond() < 1e-12) return false;
  const Matrix6d covariance = noise_px_ * noise_px_ * ldlt.solve(Matrix6d::Identity());
  const double translation_m = kNumSigmas * LargestSigma(covariance.topLeftCorner<3, 3>());
  const double rotation_rad = kNumSigmas * LargestSigma(covariance.bottomRightCorner<3, 3>());
  return translation_m <= kRightTranslationRatio * pose.translation_m.z() && rotation_rad <= kRightRotationRad;
}

bool PoseDeterminacy::IsEquivalent(const RigidTransform& pose, const RigidTransform& truth) const {
  const auto is_near = [&](const RigidTransform& other) {
    return RotationAngle(pose.rotation, other.rotation) < kRightRotationRad &&
           (pose.translation_m - other.translation_m).norm() < kRightTranslationRatio * truth.translation_m.z();
  };
  return is_near(truth) || std::any_of(model_.symmetries.begin(), model_.symmetries.end(),
                                       [&](const RigidTransform& symmetry) { return is_near(truth * symmetry); });
}

bool PoseDeterminacy::MirrorIsDistinguished(const RigidTransform& pose,
                                            absl::Span<const VisibleSegment> visible) const {
  const std::vector<EndPoints> ends = EndPointsOf(model_, pose, visible);
  const auto [mirror, cost_px2] = Refine(camera_, MirrorPose(pose, ends), ends);
  // Of two poses that differ by chi^2, the wrong one is more likely with probability Q(chi / 2).
  const double needed_px = 2.0 * kNumSigmas * noise_px_;
  if (cost_px2 >= needed_px * needed_px || IsEquivalent(mirror, pose)) return true;
  std::set<int> shown, shown_by_mirror;
  for (const VisibleSegment& segment : visible) shown.insert(segment.line);
  for (const VisibleSegment& segment : visibility_.VisibleSegments(camera_, mirror)) {
    shown_by_mirror.insert(segment.line);
  }
  return shown != shown_by_mirror;
}

bool PoseDeterminacy::LooksTheSame(const RigidTransform& pose, const RigidTransform& truth,
                                   absl::Span<const VisibleSegment> visible) const {
  const std::vector<VisibleSegment> other = visibility_.VisibleSegments(camera_, pose);
  if (other.size() != visible.size()) return false;
  const std::vector<EndPoints> ours = EndPointsOf(model_, truth, visible);
  const std::vector<EndPoints> theirs = EndPointsOf(model_, pose, other);
  const double tolerance = kSameLookSigmas * noise_px_ / camera_.fx_px;
  return std::all_of(theirs.begin(), theirs.end(), [&](const EndPoints& their) {
    return std::any_of(ours.begin(), ours.end(),
                       [&](const EndPoints& our) { return SameEnds(their.bearing, our.bearing, tolerance); });
  });
}

bool PoseDeterminacy::NothingLooksTheSame(const RigidTransform& pose, absl::Span<const VisibleSegment> visible) const {
  std::set<int> lines;
  for (const VisibleSegment& segment : visible) lines.insert(segment.line);
  const auto [first, second] = BaseLines(model_, lines);
  const ModelLine &a = model_.lines[first], &b = model_.lines[second];
  const double tolerance_m = kSamePointRatio * model_.diameter_m;
  for (const ModelLine& c : model_.lines) {
    if (std::abs((c.p2 - c.p1).norm() - (a.p2 - a.p1).norm()) > tolerance_m) continue;
    for (const ModelLine& d : model_.lines) {
      for (int turned = 0; turned < 4; ++turned) {
        const bool turn_c = (turned & 1) != 0, turn_d = (turned & 2) != 0;
        const auto motion = MotionBetween(
            {a.p1, a.p2, b.p1, b.p2},
            {turn_c ? c.p2 : c.p1, turn_c ? c.p1 : c.p2, turn_d ? d.p2 : d.p1, turn_d ? d.p1 : d.p2}, tolerance_m);
        if (!motion) continue;
        const RigidTransform other = pose * motion->Inverse();
        const auto maps = [&](int i) { return MapsOntoLine(model_, *motion, model_.lines[i], tolerance_m); };
        if (IsEquivalent(other, pose) || !std::all_of(lines.begin(), lines.end(), maps)) continue;
        if (LooksTheSame(other, pose, visible)) return false;
      }
    }
  }
  return true;
}

}  // namespace evpose

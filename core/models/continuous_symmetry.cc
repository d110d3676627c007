// SPDX-License-Identifier: Apache-2.0
#include "core/models/continuous_symmetry.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

#include "absl/strings/str_format.h"
#include "absl/types/span.h"
#include "core/geometry/half_turn.h"
#include "core/models/slippage.h"
#include "core/models/symmetry.h"
#include "core/models/symmetry_rings.h"
#include "core/models/symmetry_surface.h"

namespace evpose {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// Slippage ratio below which a surface may be symmetric. Tessellated surfaces of revolution have up to 0.02 by their
// facets, a prism of 32 sides 0.05; of other parts, plates and links begin at 0.17.
constexpr double kMaxSlippage = 0.05;
// Relative to the diameter, as for discrete symmetries.
constexpr double kRotationTolerance = 1e-3;
// More samples than a surface has: the test of a model is never cut short.
constexpr int64_t kMaxSamples = 1'000'000;
// A model is reported as nearly symmetric if at most this share of the length of its lines contradicts it; a flat plate
// slips about its normal, too, but all its lines contradict.
constexpr double kNearlyBroken = 0.5;
// Each of them tests the whole surface, so that more take more time. With fewer, a prism whose number of sides fits
// them by chance could pass for a round object.
constexpr int kNumRotations = 7;
// A closed surface whose greatest and least distance from its centre differ by at most so much, relative to the
// diameter (6 px at 300 px), is reported as nearly a sphere.
constexpr double kNearlySphere = 0.02;

// Seven rotations by multiples of the golden angle: by no common fraction of a turn, and none by a small angle. For a
// sphere about several axes.
std::array<Matrix3d, kNumRotations> IrrationalRotations(const Vector3d& axis, bool is_sphere) {
  const double golden_rad = std::numbers::pi * (3.0 - std::sqrt(5.0));
  const std::array<Vector3d, 3> oblique = {Vector3d(1, 2, 3).normalized(), Vector3d(3, -1, 2).normalized(),
                                           Vector3d(-2, 3, 1).normalized()};
  std::array<Matrix3d, kNumRotations> rotations;
  for (int k = 0; k < kNumRotations; ++k)
    rotations[k] = ExpSo3((k + 1) * golden_rad * (is_sphere ? oblique[k % 3] : axis));
  return rotations;
}

// Tests whether groups of rotations map the model onto itself.
class Confirmation {
 public:
  explicit Confirmation(const ObjectModel& model)
      : model_(model),
        tolerance_m_(kRotationTolerance * model.diameter_m),
        surface_tolerance_m_(tolerance_m_ + AllowedSagitta(model)) {}

  bool IsSphere(const Vector3d& centre) const {
    if (!model_.lines.empty() || !model_.curves.empty()) return false;
    int64_t samples = 0;
    return CentredSurface(model_, centre, surface_tolerance_m_)
        .IsMappedOntoItself(IrrationalRotations(Vector3d::Zero(), true), kMaxSamples, samples);
  }

  // Adds a notice if the model is nearly symmetric.
  std::optional<ContinuousSymmetry> Axis(const Vector3d& centre, const Vector3d& direction,
                                         std::vector<std::string>* notices) const {
    // One tolerance for the lines and one for the axis.
    const AxialRings rings(model_, centre, direction, 2.0 * tolerance_m_);
    const bool has_rings = rings.broken_ratio() == 0.0;
    if (rings.broken_ratio() > kNearlyBroken) return std::nullopt;
    const CentredSurface surface(model_, centre, surface_tolerance_m_);
    int64_t samples = 0;
    if (!has_rings || !surface.IsMappedOntoItself(IrrationalRotations(direction, false), kMaxSamples, samples)) {
      AddNotice(has_rings ? "surface contradicts" : "lines contradict", direction, notices);
      return std::nullopt;
    }
    ContinuousSymmetry symmetry = {ContinuousSymmetry::Kind::kAxis, centre, direction, false};
    const Vector3d across = direction.unitOrthogonal();
    const Matrix3d half_turn = HalfTurn(across);
    samples = 0;
    symmetry.is_flippable =
        rings.AreFlippable() && surface.IsMappedOntoItself(absl::MakeConstSpan(&half_turn, 1), kMaxSamples, samples);
    return symmetry;
  }

 private:
  static void AddNotice(const char* contradiction, const Vector3d& axis, std::vector<std::string>* notices) {
    if (notices == nullptr) return;
    notices->push_back(
        absl::StrFormat("nearly symmetric about the axis (%.3f, %.3f, %.3f), but its %s it: the rotation about the "
                        "axis is estimated from small parts",
                        axis.x(), axis.y(), axis.z(), contradiction));
  }

  const ObjectModel& model_;
  const double tolerance_m_;
  const double surface_tolerance_m_;
};

// The sign of an eigenvector is arbitrary: the largest component becomes positive. Components that are rounding errors
// of single precision become zero.
Vector3d Canonical(Vector3d direction) {
  constexpr double kRounding = 1e-6;
  int largest = 0;
  direction.cwiseAbs().maxCoeff(&largest);
  if (direction[largest] < 0.0) direction = -direction;
  for (double& component : direction) component = std::abs(component) < kRounding ? 0.0 : component;
  return direction.normalized();
}

// Adds a notice if the surface is that of a sphere up to a small part of its size.
void NoteNearlySphere(const ObjectModel& model, const Vector3d& centre, std::vector<std::string>* notices) {
  if (notices == nullptr || !model.lines.empty() || !model.curves.empty()) return;
  double least_m = model.diameter_m, greatest_m = 0.0;
  for (const Vector3d& vertex : model.vertices) {
    const double radius_m = (vertex - centre).norm();
    least_m = std::min(least_m, radius_m);
    greatest_m = std::max(greatest_m, radius_m);
  }
  if (greatest_m - least_m > kNearlySphere * model.diameter_m) return;
  notices->push_back(absl::StrFormat(
      "nearly a sphere: its rotation is estimated from deviations of at most %.2g m between the least and the greatest "
      "radius",
      greatest_m - least_m));
}

std::optional<ContinuousSymmetry> FindConfirmed(const ObjectModel& model, const SurfaceMoments& moments,
                                                std::vector<std::string>* notices) {
  SlippageAxis axis = FindSlippageAxis(moments, Matrix3d::Zero());
  if (!(axis.ratios[0] < kMaxSlippage)) return std::nullopt;
  const Confirmation confirmation(model);
  if (axis.ratios[1] < kMaxSlippage) {
    if (axis.ratios[2] < kMaxSlippage && confirmation.IsSphere(moments.centroid)) {
      return ContinuousSymmetry{ContinuousSymmetry::Kind::kSphere, moments.centroid, Vector3d::Zero(), false};
    }
    // A ball with a line has the axis of the line, if any.
    axis = FindSlippageAxis(moments, LineSlippage(model, moments));
  }
  return confirmation.Axis(moments.centroid + moments.radius_m * axis.point, Canonical(axis.direction), notices);
}

// The trace of reference^T R, the larger the nearer.
double Nearness(const RigidTransform& pose, const RigidTransform& reference) {
  return reference.rotation.cwiseProduct(pose.rotation).sum();
}

}  // namespace

std::optional<ContinuousSymmetry> FindContinuousSymmetry(const ObjectModel& model, std::vector<std::string>* notices) {
  if (model.triangles.empty() || !(model.diameter_m > 0.0)) return std::nullopt;
  const SurfaceMoments moments = MomentsOf(model);
  if (!(moments.radius_m > 0.0)) return std::nullopt;
  const std::optional<ContinuousSymmetry> symmetry = FindConfirmed(model, moments, notices);
  if (!symmetry.has_value()) NoteNearlySphere(model, moments.centroid, notices);
  return symmetry;
}

FreeDirections FreeDirectionsAt(const ContinuousSymmetry& symmetry, const RigidTransform& camera_from_object) {
  const Matrix3d& rotation = camera_from_object.rotation;
  const Vector3d arm = rotation * symmetry.centre;
  FreeDirections directions(6, symmetry.kind == ContinuousSymmetry::Kind::kAxis ? 1 : 3);
  for (int i = 0; i < directions.cols(); ++i) {
    const Vector3d axis = directions.cols() == 1 ? Vector3d(rotation * symmetry.axis) : Vector3d(Vector3d::Unit(i));
    directions.col(i) << arm.cross(axis), axis;
  }
  return directions;
}

RigidTransform AboutCentre(const ContinuousSymmetry& symmetry, const Matrix3d& rotation) {
  return RotationAbout(symmetry.centre, rotation);
}

RigidTransform NearestWithoutFlip(const RigidTransform& camera_from_object, const ContinuousSymmetry& symmetry,
                                  const RigidTransform& reference) {
  const Matrix3d relative = reference.rotation.transpose() * camera_from_object.rotation;
  if (symmetry.kind == ContinuousSymmetry::Kind::kSphere) {
    return camera_from_object * AboutCentre(symmetry, relative.transpose());
  }
  const Vector3d& axis = symmetry.axis;
  // core/models/README.md, equation (7).
  const double along = axis.dot(relative * axis);
  const double x = relative.trace() - along;
  const double y = axis.dot(
      Vector3d(relative(1, 2) - relative(2, 1), relative(2, 0) - relative(0, 2), relative(0, 1) - relative(1, 0)));
  const double length = std::sqrt(x * x + y * y);
  // All angles are equally near if the axes are opposite.
  if (!(length > 1e-9)) return camera_from_object;
  const double cos = x / length, sin = y / length;
  const Matrix3d spin = cos * Matrix3d::Identity() + sin * Hat(axis) + (1.0 - cos) * axis * axis.transpose();
  return camera_from_object * AboutCentre(symmetry, spin);
}

RigidTransform NearestEquivalent(const RigidTransform& camera_from_object, const ContinuousSymmetry& symmetry,
                                 const RigidTransform& reference) {
  // Traces that differ by less are equal: the choice must not depend on rounding errors.
  constexpr double kRounding = 1e-9;
  const RigidTransform upright = NearestWithoutFlip(camera_from_object, symmetry, reference);
  if (!symmetry.is_flippable) return upright;
  const Vector3d across = symmetry.axis.unitOrthogonal();
  const Matrix3d half_turn = HalfTurn(across);
  const RigidTransform turned =
      NearestWithoutFlip(camera_from_object * AboutCentre(symmetry, half_turn), symmetry, reference);
  return Nearness(turned, reference) > Nearness(upright, reference) + kRounding ? turned : upright;
}

RigidTransform NearestEquivalent(const RigidTransform& camera_from_object, const ObjectModel& model,
                                 const RigidTransform& reference) {
  if (model.continuous_symmetry) return NearestEquivalent(camera_from_object, *model.continuous_symmetry, reference);
  return NearestEquivalent(camera_from_object, model.symmetries, reference);
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// The globally best rotation of an object whose image lines are not known by name: the branch and bound of the source
// paper (LOPET, Sec. III-B "Initial Pose Estimation"; core/initialization/README.md), with a proof in hand: equal
// bounds.
//
// It maximises E(R) of CountPerpendicular over all rotations. The objective counts: it has plateaus, and E(RQ) = E(R)
// for every symmetry Q of the set of directions (24 for a box), so that a rotation alone says neither which of the
// parallel lines is which, nor which of the equivalent rotations is right. The translation must decide.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"

namespace evpose {

struct RotationBnbOptions {
  // Radians: how far from perpendicular a normal and a rotated direction may be. The value of the paper's code.
  double inlier_rad = 0.0299;
  // Cubes whose bounds are computed, at most: about a third of a microsecond each for ten lines and three directions.
  int64_t max_branches = 2'000'000;
  // Cubes explored after the bounds have met, to find the other rotations that reach the maximum.
  int64_t max_plateau_branches = 50'000;
  // Rotations returned, at most: more than the plateaus seen for ten lines of a box.
  int max_rotations = 16;
  // Radians: rotations closer than this, modulo the symmetry of the directions, are one. Two inlier bands: a plateau is
  // about as wide.
  double distinct_rad = 0.06;
  // Search one of each class of rotations that the directions cannot tell apart. Off: the whole ball, as published.
  bool use_symmetry = true;
  // The first-order bound beside the published one (rotation_bnb.cc). Off: the published bound alone.
  bool use_first_order_bound = true;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

struct RotationBnbResult {
  // The maximum of E lies in [lower_bound, upper_bound]; `rotations` reach the lower one.
  int lower_bound = 0;
  int upper_bound = 0;
  // camera_from_object, distinct modulo the symmetry of the directions (DirectionSymmetries), in the order in which
  // they were found: the rest of each class is R Q. Each is the least-squares rotation of its inliers where that keeps
  // the count.
  std::vector<Eigen::Matrix3d> rotations;
  // True when every rotation that reaches the maximum is within twice distinct_rad of one in `rotations`, modulo the
  // symmetry of the directions.
  bool has_all_rotations = false;
  int64_t branches = 0;

  // The maximum is known: no rotation explains more lines.
  bool is_certified() const { return lower_bound == upper_bound; }
};

// Best-first search. `normals`: unit normals n_j of the planes through the camera's centre and the image lines, camera
// frame; `directions`: unit directions v_k of the model's lines (UniqueDirections), object frame. Deterministic.
// Errors, INVALID_ARGUMENT: options; no normal; fewer than two directions; a vector that is not of unit length.
absl::StatusOr<RotationBnbResult> MaximisePerpendicular(absl::Span<const Eigen::Vector3d> normals,
                                                        absl::Span<const Eigen::Vector3d> directions,
                                                        const RotationBnbOptions& options);

// The same with known correspondences: normal j belongs to directions[j] (as many as normals). The symmetries are then
// those that turn each direction into itself or its opposite (SignSymmetries).
absl::StatusOr<RotationBnbResult> MaximisePerpendicularMatches(absl::Span<const Eigen::Vector3d> normals,
                                                               absl::Span<const Eigen::Vector3d> directions,
                                                               const RotationBnbOptions& options);

enum class RotationVerdict {
  kMaximum,     // no rotation explains more lines
  kNotMaximum,  // `better` does
  kUnknown,     // the budget of branches ran out
};

struct RotationCertificate {
  RotationVerdict verdict = RotationVerdict::kUnknown;
  int count = 0;                                         // E of the rotation in question
  int upper_bound = 0;                                   // no rotation has more
  Eigen::Matrix3d better = Eigen::Matrix3d::Identity();  // with kNotMaximum
  int64_t branches = 0;
};

// Whether a rotation that was found otherwise attains the global maximum of E. Faster than the search: only cubes that
// could hold a better one are split. Errors as above, and for a matrix that is no rotation (to 1e-6).
absl::StatusOr<RotationCertificate> CertifyRotation(absl::Span<const Eigen::Vector3d> normals,
                                                    absl::Span<const Eigen::Vector3d> directions,
                                                    const Eigen::Matrix3d& camera_from_object,
                                                    const RotationBnbOptions& options);

}  // namespace evpose

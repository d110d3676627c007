// SPDX-License-Identifier: Apache-2.0

// Globally best rotation of an object for image lines without correspondences: the branch and bound search of the paper
// (LOPET, Sec. III-B "Initial Pose Estimation"; core/initialization/README.md). Equal bounds prove the maximum.
//
// It maximises E(R) of CountPerpendicular over all rotations. The objective is a count: it has plateaus, and E(RQ) =
// E(R) for every symmetry Q of the set of directions (24 for a box). A rotation alone therefore determines neither the
// correspondences among parallel lines nor the right one of the equivalent rotations; the translation must decide.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"

namespace evpose {

// inlier_rad is a value of the paper and not tuned. The limits of the work are validated by rotation_bnb_test: the
// maximum of nine lines of a box is certified, and all its rotations are found. `evpose bench initialization` runs with
// the defaults (core/experiments/RESULTS.md, The first pose).
struct RotationBnbOptions {
  // Radians: largest deviation from a right angle between a normal and a rotated direction. The value of the released
  // code of the paper.
  double inlier_rad = 0.0299;
  // Maximum number of cubes for which bounds are computed; a cube takes about a third of a microsecond for ten lines
  // and three directions.
  int64_t max_branches = 2'000'000;
  // Cubes explored after the bounds are equal, to find the other rotations that reach the maximum.
  int64_t max_plateau_branches = 50'000;
  // Maximum number of returned rotations: more than the plateaus observed for ten lines of a box.
  int max_rotations = 16;
  // Radians: rotations closer than this, modulo the symmetry of the directions, are treated as one: two inlier bands,
  // the width of a plateau.
  double distinct_rad = 0.06;
  // Restricts the search to one rotation of each class that the directions cannot distinguish; false: the whole ball,
  // as published.
  bool uses_symmetry = true;
  // Uses the first-order bound beside the published one (rotation_bnb.cc); false: the published bound alone.
  bool uses_first_order_bound = true;

  // INVALID_ARGUMENT names the field.
  absl::Status Validate() const;
};

struct RotationBnbResult {
  // The maximum of E lies in [lower_bound, upper_bound]; `rotations` reach the lower one.
  int lower_bound = 0;
  int upper_bound = 0;
  // camera_from_object, distinct modulo the symmetry of the directions (DirectionSymmetries), in the order in which
  // they were found: the other members of each class are R Q. Each is the least-squares rotation of its inliers, unless
  // that reduces the count.
  std::vector<Eigen::Matrix3d> rotations;
  // True when every rotation that reaches the maximum is within twice distinct_rad of one in `rotations`, modulo the
  // symmetry of the directions.
  bool has_all_rotations = false;
  int64_t branches = 0;

  // Whether the maximum is proved: no rotation explains more lines.
  bool is_certified() const { return lower_bound == upper_bound; }
};

enum class Correspondences {
  kUnknown,  // a normal may belong to any direction
  kKnown,    // normal j belongs to directions[j] (equal numbers)
};

// Searches best first. `normals`: unit normals n_j of the planes through the centre of the camera and the image lines,
// camera frame; `directions`: unit directions v_k of the model lines (UniqueDirections), object frame. With known
// correspondences the symmetries are those that map each direction to itself or its opposite (SignSymmetries).
// Deterministic.
// INVALID_ARGUMENT: invalid options, no normal, fewer than two directions, or a vector that is not of unit length.
absl::StatusOr<RotationBnbResult> MaximisePerpendicular(absl::Span<const Eigen::Vector3d> normals,
                                                        absl::Span<const Eigen::Vector3d> directions,
                                                        const RotationBnbOptions& options,
                                                        Correspondences correspondences = Correspondences::kUnknown);

enum class RotationOptimality {
  kMaximum,     // no rotation explains more lines
  kNotMaximum,  // RotationCertificate::better explains more
  kUnknown,     // the budget of branches ran out
};

struct RotationCertificate {
  RotationOptimality optimality = RotationOptimality::kUnknown;
  int count = 0;                                         // E of the tested rotation
  int upper_bound = 0;                                   // no rotation has more
  Eigen::Matrix3d better = Eigen::Matrix3d::Identity();  // a rotation with a larger E, for kNotMaximum
  int64_t branches = 0;
};

// Tests whether a rotation attains the global maximum of E. Faster than the search: only cubes that may contain a
// better rotation are split. Errors as above, and INVALID_ARGUMENT for a matrix that is not a rotation (to 1e-6).
absl::StatusOr<RotationCertificate> CertifyRotation(absl::Span<const Eigen::Vector3d> normals,
                                                    absl::Span<const Eigen::Vector3d> directions,
                                                    const Eigen::Matrix3d& camera_from_object,
                                                    const RotationBnbOptions& options);

}  // namespace evpose

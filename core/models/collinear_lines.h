// SPDX-License-Identifier: Apache-2.0

// Joins lines that are parts of one straight line.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <string>
#include <vector>

#include "absl/types/span.h"
#include "core/models/object_model.h"

namespace evpose {

// Maximum distance of a line from the straight line that it is part of, relative to the model's size: that within
// which RepairMesh() merges points. Edges of a mesh are joined with the same tolerance.
inline constexpr double kCollinearTolerance = 1e-5;
// Normals with at least this cosine are one in the list of a line: 0.1 degree, above the rounding errors of small
// faces.
inline constexpr double kSameNormalCosine = 0.9999985;
// Normals of a line, most. More faces do not meet at an edge of an object, and all are compared in pairs.
inline constexpr size_t kMaxFaceNormals = 32;

// Whether a normal of the list has more than that cosine to `normal`.
bool ContainsNormal(const Eigen::Vector3d& normal, absl::Span<const Eigen::Vector3d> normals, double cosine);

// Whether each normal of either list has one within 25 degrees in the other. The faces of a noisy mesh are rough, and
// creases turn by more.
bool HaveMatchingNormals(absl::Span<const Eigen::Vector3d> a, absl::Span<const Eigen::Vector3d> b);

// Joins lines that are parts of one straight line: returns a line from end to end of each group with the normals of all
// members, in the order of the first lines of the groups. Two lines belong together if they overlap by at least
// `min_overlap_m` (if negative, a gap up to its magnitude is allowed) and, with `same_faces`, have matching normals. If
// a line of a group is farther than twice the tolerance from the joined line, the group stays as it is: many lines that
// each turn a little form a curve. A gap must not exceed the tolerance. Lines near each other are compared, 30 million
// pairs at most; the rest then stays as it is.
std::vector<ModelLine> JoinCollinear(absl::Span<const ModelLine> lines, double tolerance_m, double min_overlap_m,
                                     bool same_faces);

// Merges lines that overlap, among them duplicates and parts of longer lines; `notices` say how many were merged.
void MergeOverlapping(double tolerance_m, std::vector<ModelLine>& lines, std::vector<std::string>& notices);

}  // namespace evpose

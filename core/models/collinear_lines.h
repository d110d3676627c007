// SPDX-License-Identifier: Apache-2.0

// Lines that are parts of one straight line.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/types/span.h"
#include "core/models/object_model.h"

namespace evpose {

// Lines within this of one straight line are parts of it, of the model's size: as edges of a mesh are joined.
inline constexpr double kCollinearTolerance = 1e-5;
// Normals that count as one in a line's list. 0.1 degree.
inline constexpr double kSameNormalCosine = 0.9999985;

bool HasItsLike(const Eigen::Vector3d& normal, absl::Span<const Eigen::Vector3d> normals, double cosine);

// Whether each normal of either has its like, within 25 degrees, in the other: the faces of a noisy model are rough,
// and creases turn by more.
bool LookTheSameWay(absl::Span<const Eigen::Vector3d> a, absl::Span<const Eigen::Vector3d> b);

// Indices of lines of one straight line, each group in ascending order, the groups in the order of their first. Lines
// belong together when they overlap by at least `min_overlap_m` (negative: when the gap is no longer than that), and,
// where `same_faces` says so, look the same way. Compares all pairs.
std::vector<std::vector<uint32_t>> GroupCollinear(absl::Span<const ModelLine> lines, double tolerance_m,
                                                  double min_overlap_m, bool same_faces);

// The line from one end of a group to the other, with the normals of all its members. None when they do not lie within
// the tolerance of it: many lines that hardly turn are a curve.
std::optional<ModelLine> JoinCollinear(absl::Span<const ModelLine> lines, absl::Span<const uint32_t> group,
                                       double tolerance_m);

// Makes one of lines that overlap, the same line twice and a part of another included; `notices` say how many went.
void MergeOverlapping(double tolerance_m, std::vector<ModelLine>& lines, std::vector<std::string>& notices);

}  // namespace evpose

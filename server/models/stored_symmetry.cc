// SPDX-License-Identifier: Apache-2.0
#include "server/models/stored_symmetry.h"

namespace evpose::server {

storage::v1::ContinuousSymmetry ToStored(const ContinuousSymmetry& symmetry) {
  storage::v1::ContinuousSymmetry stored;
  stored.set_is_sphere(symmetry.kind == ContinuousSymmetry::Kind::kSphere);
  stored.mutable_centre()->Add(symmetry.centre.begin(), symmetry.centre.end());
  stored.mutable_axis()->Add(symmetry.axis.begin(), symmetry.axis.end());
  stored.set_is_flippable(symmetry.is_flippable);
  return stored;
}

template <typename Message>
std::optional<ContinuousSymmetry> SymmetryOf(const Message& message) {
  const storage::v1::ContinuousSymmetry& stored = message.continuous_symmetry();
  if (stored.centre_size() != 3 || stored.axis_size() != 3) return std::nullopt;
  ContinuousSymmetry symmetry;
  symmetry.kind = stored.is_sphere() ? ContinuousSymmetry::Kind::kSphere : ContinuousSymmetry::Kind::kAxis;
  for (int i = 0; i < 3; ++i) {
    symmetry.centre[i] = stored.centre(i);
    symmetry.axis[i] = stored.axis(i);
  }
  symmetry.is_flippable = stored.is_flippable();
  return symmetry;
}

template std::optional<ContinuousSymmetry> SymmetryOf(const storage::v1::ModelSummary& message);
template std::optional<ContinuousSymmetry> SymmetryOf(const storage::v1::PreparedModel& message);

}  // namespace evpose::server

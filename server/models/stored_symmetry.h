// SPDX-License-Identifier: Apache-2.0

// Continuous symmetries, serialized (proto/evpose/storage/v1/model.proto).
#pragma once

#include <optional>

#include "core/models/object_model.h"
#include "evpose/storage/v1/model.pb.h"

namespace evpose::server {

storage::v1::ContinuousSymmetry ToStored(const ContinuousSymmetry& symmetry);
// Returns the stored symmetry of a message, equal to the bit; nullopt if it is absent or incomplete.
template <typename Message>  // ModelSummary or PreparedModel
std::optional<ContinuousSymmetry> SymmetryOf(const Message& message);

}  // namespace evpose::server

// SPDX-License-Identifier: Apache-2.0

// Models as they are derived from their files, serialized (proto/evpose/storage/v1/model.proto).
#pragma once

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "core/models/object_model.h"

namespace evpose::server {

// To be raised with every change of core/models or core/mesh that alters the result of ParseObjectModel().
inline constexpr uint32_t kPreparationVersion = 5;

std::string EncodePreparedModel(const ObjectModel& model);
// Returns the encoded model, equal to the bit. Errors: DATA_LOSS.
absl::StatusOr<ObjectModel> DecodePreparedModel(absl::string_view encoded);

}  // namespace evpose::server

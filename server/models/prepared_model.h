// SPDX-License-Identifier: Apache-2.0

// Models as they are derived from their files, serialized (proto/evpose/storage/v1/model.proto).
#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "core/models/object_model.h"

namespace evpose::server {

// Returns the encoding of the model, with its views if it has them.
std::string EncodePreparedModel(const ObjectModel& model);
// Returns bytes that give a model these views when they are appended to the encoding of the model without views.
std::string EncodePreparedViews(const SearchViews& views);
// Returns the encoded model, equal to the bit. Errors: DATA_LOSS.
absl::StatusOr<ObjectModel> DecodePreparedModel(absl::string_view encoded);

}  // namespace evpose::server

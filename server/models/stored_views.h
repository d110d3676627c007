// SPDX-License-Identifier: Apache-2.0

// The views of models, serialized (proto/evpose/storage/v1/model.proto).
#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "core/models/search_views.h"
#include "evpose/storage/v1/model.pb.h"

namespace evpose::server {

storage::v1::SearchViews ToStored(const SearchViews& views);
// Returns the stored views, equal to the bit. Whether they are views of a certain model is checked where they are used.
// Errors: DATA_LOSS if there are more views than of any model, or if the numbers of parts do not agree.
absl::StatusOr<std::shared_ptr<const SearchViews>> ViewsOf(const storage::v1::SearchViews& stored);

}  // namespace evpose::server

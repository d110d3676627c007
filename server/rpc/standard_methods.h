// SPDX-License-Identifier: Apache-2.0

// The rules that the standard methods List and Delete share for all resources.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace evpose::server {

// The status of a call that deletes a resource (AIP-135): with allow_missing, NOT_FOUND is OK.
absl::Status DeletionStatus(const absl::Status& status, bool allow_missing);

// The number of resources on a page (AIP-158): 50 if the request gives none, at most 1000. Error: INVALID_ARGUMENT for
// a size below 0.
absl::StatusOr<size_t> PageSize(int32_t page_size);

// The name of the resource after which the page starts; empty for the first page. `prefix` is the collection with its
// slash. Error: INVALID_ARGUMENT for a token that no earlier page gave.
absl::StatusOr<std::string> PageStart(const std::string& page_token, const std::string& prefix);

}  // namespace evpose::server

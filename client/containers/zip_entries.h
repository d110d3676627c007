// SPDX-License-Identifier: Apache-2.0

// The files in a ZIP archive, stored or deflated.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "client/containers/npy_array.h"

namespace evpose::client {

inline constexpr std::string_view kZipMagic("PK\x03\x04", 4);

// The names of the files that end with `suffix`, at most 64 of them. INVALID_ARGUMENT with the path if the archive is
// damaged.
absl::StatusOr<std::vector<std::string>> ListZipEntries(const std::string& path, std::string_view suffix);

// Reads a file from its beginning; each has its own position. INVALID_ARGUMENT with the path if it is missing,
// encrypted or compressed in another way. The function returns DATA_LOSS with both names for damaged data: where they
// cannot be decompressed, or at their end if they do not have their checksum.
absl::StatusOr<ReadBytes> OpenZipEntry(const std::string& path, const std::string& name);

}  // namespace evpose::client

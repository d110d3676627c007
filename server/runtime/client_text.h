// SPDX-License-Identifier: Apache-2.0

// Text that clients choose: names, identifiers.
#pragma once

#include <string>

#include "absl/strings/string_view.h"

namespace evpose::server {

// Bytes of a client's text that messages and the log repeat: more than every valid name has. An error with long texts
// would exceed the limit of gRPC's metadata, so that the client would see another error.
inline constexpr size_t kMaxNameBytes = 100;

// Returns the first kMaxNameBytes of `text`, with "..." if that is not all of it. Bytes other than printable ASCII,
// quotes and backslashes are escaped, so that the result is valid UTF-8 and safe for terminals.
std::string Shortened(absl::string_view text);

// True for valid UTF-8 without characters that control a terminal or change the direction or the lines of a text.
bool IsPlainText(absl::string_view text);

}  // namespace evpose::server

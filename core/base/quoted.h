// SPDX-License-Identifier: Apache-2.0

// Words of untrusted files in error texts.
#pragma once

#include <cstddef>
#include <string>

#include "absl/strings/string_view.h"

namespace evpose {

// A hostile file may have a word of megabytes.
inline constexpr size_t kMaxQuoted = 40;

// The first `max_bytes` bytes of the word, with escapes for those that are not printable ASCII.
std::string Escaped(absl::string_view word, size_t max_bytes = kMaxQuoted);
// The same in single quotes.
std::string Quoted(absl::string_view word);

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// Counted nouns in texts for users, in the singular or plural.
#pragma once

#include <cstdint>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"

namespace evpose {

// "1 line", "2 lines"; with `plural`, where it is not the singular with an s: "2 symmetries".
inline std::string Counted(uint64_t count, absl::string_view singular, absl::string_view plural = "") {
  if (count == 1) return absl::StrCat("1 ", singular);
  return plural.empty() ? absl::StrCat(count, " ", singular, "s") : absl::StrCat(count, " ", plural);
}

}  // namespace evpose

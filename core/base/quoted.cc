// SPDX-License-Identifier: Apache-2.0
#include "core/base/quoted.h"

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"

namespace evpose {

std::string Escaped(absl::string_view word, size_t max_bytes) { return absl::CHexEscape(word.substr(0, max_bytes)); }

std::string Quoted(absl::string_view word) { return absl::StrCat("'", Escaped(word), "'"); }

}  // namespace evpose

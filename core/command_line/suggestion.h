// SPDX-License-Identifier: Apache-2.0

// Finds the name that a misspelled one was probably meant to be.
#pragma once

#include <string>
#include <vector>

#include "absl/strings/string_view.h"

namespace evpose {

// Returns the name that differs least from `word`: by at most a third of its characters inserted, removed, replaced or
// exchanged with the next one, or by the end that `word` lacks. Returns an empty text if there is none.
std::string NearestName(absl::string_view word, const std::vector<std::string>& names);

}  // namespace evpose

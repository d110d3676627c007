// SPDX-License-Identifier: Apache-2.0

// Finds the name that a misspelled one was probably meant to be.
#pragma once

#include <string>
#include <vector>

#include "absl/strings/string_view.h"

namespace evpose {

// Returns the name that differs least from `word`: at most a third of its characters, or one in a short word, are
// inserted, removed, replaced or exchanged with the next one, or `word` is the beginning of the name. Returns an empty
// text if there is no such name.
std::string NearestName(absl::string_view word, const std::vector<std::string>& names);

}  // namespace evpose

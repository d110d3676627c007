// SPDX-License-Identifier: Apache-2.0

// Breaks text into lines of a limited width.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"

namespace evpose {

// Breaks prose at its spaces into lines of at most `width` characters. A longer word has a line of its own. Returns no
// line for a text without words.
std::vector<std::string> WrapWords(absl::string_view text, size_t width);

// Breaks a command of the shell in the same way, but not inside quotes: all lines except the last end in " \", and all
// lines except the first begin with two spaces. The lines are the same command.
std::vector<std::string> WrapCommand(absl::string_view command, size_t width);

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// The text that `evpose` prints without a command: the commands with which a newcomer begins.
#pragma once

#include <cstddef>
#include <string>

namespace evpose::client {

// Text with lines of at most `width` characters. The commands work in this order as they are printed.
std::string FirstSteps(size_t width);

}  // namespace evpose::client

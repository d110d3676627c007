// SPDX-License-Identifier: Apache-2.0

// Manual pages (man(7)) from the help of commands.
#pragma once

#include <string>
#include <vector>

#include "core/command_line/help_page.h"

namespace evpose {

// "evpose-sessions-list"
std::string ManPageName(const HelpPage& page);

// The manual page of a command. `see_also` are names with their sections, "evpose(1)". The text depends on its
// arguments alone; it has no date, so that builds are reproducible.
std::string FormatManPage(const HelpPage& page, int section, const std::string& version,
                          const std::vector<std::string>& see_also);

}  // namespace evpose

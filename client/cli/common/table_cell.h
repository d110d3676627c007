// SPDX-License-Identifier: Apache-2.0

// Tables of numbers as text.
#pragma once

#include <algorithm>
#include <cmath>
#include <ostream>
#include <string>
#include <vector>

#include "absl/strings/str_format.h"

namespace evpose::client {

// A number in a table; "-" for NaN and infinity.
inline std::string Cell(double value, int decimals) {
  return std::isfinite(value) ? absl::StrFormat("%.*f", decimals, value) : "-";
}

// Prints columns as wide as their widest cells; the first one is left-aligned, numbers are right-aligned. Each line
// begins with `indent`.
inline void PrintTable(const std::vector<std::vector<std::string>>& lines, const char* indent, std::ostream& out) {
  std::vector<size_t> widths(lines.front().size(), 0);
  for (const auto& line : lines) {
    for (size_t i = 0; i < line.size(); ++i) widths[i] = std::max(widths[i], line[i].size());
  }
  for (const auto& line : lines) {
    out << indent << absl::StrFormat("%-*s", widths[0], line[0]);
    for (size_t i = 1; i < line.size(); ++i) out << absl::StrFormat("  %*s", widths[i], line[i]);
    out << "\n";
  }
}

}  // namespace evpose::client

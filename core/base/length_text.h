// SPDX-License-Identifier: Apache-2.0

// Lengths in texts for users.
#pragma once

#include <string>

namespace evpose {

// The unit in which a length is printed.
struct LengthUnit {
  const char* name;
  double metres;
};
LengthUnit UnitOfLength(double length_m);
// "0.2 m", "3.5 mm", "1.414 micrometres"
std::string FormatLength(double length_m);

}  // namespace evpose

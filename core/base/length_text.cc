// SPDX-License-Identifier: Apache-2.0
#include "core/base/length_text.h"

#include "absl/strings/str_format.h"

namespace evpose {

LengthUnit UnitOfLength(double length_m) {
  if (length_m >= 1e4) return {"km", 1e3};
  if (length_m >= 0.01 || length_m <= 0.0) return {"m", 1.0};
  return length_m >= 1e-4 ? LengthUnit{"mm", 1e-3} : LengthUnit{"micrometres", 1e-6};
}

std::string FormatLength(double length_m) {
  const LengthUnit unit = UnitOfLength(length_m);
  return absl::StrFormat("%.4g %s", length_m / unit.metres, unit.name);
}

}  // namespace evpose

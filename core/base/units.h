// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <numbers>

namespace evpose {

inline constexpr double kDegreesPerRadian = 180.0 / std::numbers::pi;

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// How many lines determine a pose.
#pragma once

namespace evpose {

// A line gives two equations, and a pose has six unknowns.
inline constexpr int kLinesOfAPose = 3;

}  // namespace evpose

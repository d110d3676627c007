// SPDX-License-Identifier: Apache-2.0

// What detection and tracking share of Tukey's bisquare.
#pragma once

namespace evpose {

// Residuals beyond this many sigma have no weight: 95 % efficiency under the normal distribution (method.md 2.6).
inline constexpr double kTukeyEfficient = 4.685;

}  // namespace evpose

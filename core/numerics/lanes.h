// SPDX-License-Identifier: Apache-2.0

// Four numbers side by side. The compiler makes vector instructions of them where the processor has some; every lane is
// rounded as a number by itself, so that the bits are the same on every machine.
#pragma once

#include <bit>
#include <cstdint>

namespace evpose {

inline constexpr int kNumLanes = 4;
using Lanes = float __attribute__((vector_size(16)));
// Of lanes that compare true all bits are set, of others none.
using LaneMask = int32_t __attribute__((vector_size(16)));
inline constexpr LaneMask kAllLanes = {-1, -1, -1, -1};

inline Lanes AllLanes(double value) {
  const auto all = static_cast<float>(value);
  return Lanes{all, all, all, all};
}

inline Lanes Select(LaneMask mask, Lanes if_true, Lanes if_false) {
  const LaneMask bits = (mask & std::bit_cast<LaneMask>(if_true)) | (~mask & std::bit_cast<LaneMask>(if_false));
  return std::bit_cast<Lanes>(bits);
}
// The lanes where the mask is set; 0 elsewhere.
inline Lanes Only(LaneMask mask, Lanes lanes) { return std::bit_cast<Lanes>(mask & std::bit_cast<LaneMask>(lanes)); }

inline Lanes Abs(Lanes lanes) { return std::bit_cast<Lanes>(std::bit_cast<LaneMask>(lanes) & 0x7fffffff); }

inline double SumOf(Lanes lanes) {
  return (static_cast<double>(lanes[0]) + lanes[1]) + (static_cast<double>(lanes[2]) + lanes[3]);
}

// exp(-x) for x >= 0, to 4e-6 of it; not less than exp(-64).
inline Lanes NegativeExp(Lanes x) {
  constexpr float kLog2E = 1.44269504f;
  constexpr float kLeast = -64.0f * kLog2E;
  // Added and taken away it rounds to a whole number, which meanwhile stands in the lowest bits.
  constexpr float kRound = 12582912.0f;
  const Lanes power = x * -kLog2E;
  const Lanes bounded = Select(power > kLeast, power, AllLanes(kLeast));
  const Lanes shifted = bounded + kRound;
  const Lanes rest = bounded - (shifted - kRound);
  const LaneMask whole = std::bit_cast<LaneMask>(shifted) - std::bit_cast<int32_t>(kRound);
  // 2^rest by its series, rest from -1/2 to 1/2.
  const Lanes series =
      1.0f + rest * (0.69314718f +
                     rest * (0.24022651f + rest * (0.055504109f + rest * (0.0096181291f + rest * 0.0013333558f))));
  constexpr int kExponentBit = 23;
  return std::bit_cast<Lanes>(std::bit_cast<LaneMask>(series) + (whole << kExponentBit));
}

}  // namespace evpose

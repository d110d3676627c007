// SPDX-License-Identifier: Apache-2.0

// Vectors of four floats. The compiler uses vector instructions where the processor has them; each lane is rounded like
// a scalar, so that the bits are the same on every machine.
#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>

namespace evpose {

inline constexpr int kNumLanes = 4;  // the narrowest vector registers, those of SSE2 and NEON, hold as many
using Lanes = float __attribute__((vector_size(16)));
// The result of a comparison: all bits of a lane are set if it is true, else none.
using LaneMask = int32_t __attribute__((vector_size(16)));
inline constexpr LaneMask kAllLanes = {-1, -1, -1, -1};

inline Lanes AllLanes(double value) {
  const auto all = static_cast<float>(value);
  return Lanes{all, all, all, all};
}

// `if_true` in the lanes of the mask, `if_false` in the others.
inline Lanes Select(LaneMask mask, Lanes if_true, Lanes if_false) {
  const LaneMask bits = (mask & std::bit_cast<LaneMask>(if_true)) | (~mask & std::bit_cast<LaneMask>(if_false));
  return std::bit_cast<Lanes>(bits);
}
// `lanes` in the lanes of the mask, 0 in the others.
inline Lanes Only(LaneMask mask, Lanes lanes) { return std::bit_cast<Lanes>(mask & std::bit_cast<LaneMask>(lanes)); }

inline Lanes Abs(Lanes lanes) { return std::bit_cast<Lanes>(std::bit_cast<LaneMask>(lanes) & 0x7fffffff); }

// The sum in double precision, in a fixed order.
inline double SumOf(Lanes lanes) {
  return (static_cast<double>(lanes[0]) + lanes[1]) + (static_cast<double>(lanes[2]) + lanes[3]);
}

// SumOf() of each of several vectors, four at a time: their lanes are transposed, so that each addition works on the
// sums of four vectors.
template <size_t N>
[[gnu::always_inline]] inline std::array<double, N> SumsOf(const std::array<Lanes, N>& all) {
  using Doubles = double __attribute__((vector_size(32)));
  std::array<double, N> sums;
  size_t i = 0;
  for (; i + 4 <= N; i += 4) {
    const Lanes low01 = __builtin_shufflevector(all[i], all[i + 1], 0, 4, 1, 5);
    const Lanes high01 = __builtin_shufflevector(all[i], all[i + 1], 2, 6, 3, 7);
    const Lanes low23 = __builtin_shufflevector(all[i + 2], all[i + 3], 0, 4, 1, 5);
    const Lanes high23 = __builtin_shufflevector(all[i + 2], all[i + 3], 2, 6, 3, 7);
    const Lanes lane0 = __builtin_shufflevector(low01, low23, 0, 1, 4, 5);
    const Lanes lane1 = __builtin_shufflevector(low01, low23, 2, 3, 6, 7);
    const Lanes lane2 = __builtin_shufflevector(high01, high23, 0, 1, 4, 5);
    const Lanes lane3 = __builtin_shufflevector(high01, high23, 2, 3, 6, 7);
    const Doubles four = (__builtin_convertvector(lane0, Doubles) + __builtin_convertvector(lane1, Doubles)) +
                         (__builtin_convertvector(lane2, Doubles) + __builtin_convertvector(lane3, Doubles));
    for (size_t k = 0; k < 4; ++k) sums[i + k] = four[k];
  }
  for (; i < N; ++i) sums[i] = SumOf(all[i]);
  return sums;
}

// exp(-x) for x >= 0, but not less than exp(-64); relative error below 8e-6 (core/numerics/README.md, section 1).
inline Lanes NegativeExp(Lanes x) {
  constexpr float kLog2E = 1.44269504f;
  constexpr float kLeast = -64.0f * kLog2E;  // exp(-64) = 1.6e-28 is far above the smallest normal float
  // 1.5 * 2^23: a float of this size has no fraction bits, so that adding it rounds to an integer, which stands in the
  // low bits of the sum.
  constexpr float kRound = 12582912.0f;
  const Lanes power = x * -kLog2E;
  const Lanes bounded = Select(power > kLeast, power, AllLanes(kLeast));
  const Lanes shifted = bounded + kRound;
  const Lanes rest = bounded - (shifted - kRound);
  const LaneMask whole = std::bit_cast<LaneMask>(shifted) - std::bit_cast<int32_t>(kRound);
  // 2^rest by its Taylor polynomial of degree 5, |rest| <= 1/2.
  const Lanes series =
      1.0f + rest * (0.69314718f +
                     rest * (0.24022651f + rest * (0.055504109f + rest * (0.0096181291f + rest * 0.0013333558f))));
  constexpr int kExponentBit = 23;  // the lowest bit of the exponent of a float
  return std::bit_cast<Lanes>(std::bit_cast<LaneMask>(series) + (whole << kExponentBit));
}

}  // namespace evpose

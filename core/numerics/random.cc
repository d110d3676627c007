// SPDX-License-Identifier: Apache-2.0
#include "core/numerics/random.h"

#include <algorithm>
#include <bit>
#include <cmath>

namespace evpose {

Random::Random(uint64_t seed) {
  for (uint64_t& word : state_) {
    word = HashNumber(seed);
    seed += kSplitMix64Increment;
  }
}

uint64_t Random::NextU64() {
  const uint64_t result = std::rotl(state_[1] * 5, 7) * 9;
  const uint64_t shifted = state_[1] << 17;
  state_[2] ^= state_[0];
  state_[3] ^= state_[1];
  state_[1] ^= state_[2];
  state_[0] ^= state_[3];
  state_[2] ^= shifted;
  state_[3] = std::rotl(state_[3], 45);
  return result;
}

double Random::Uniform() { return static_cast<double>(NextU64() >> 11) * 0x1.0p-53; }

double Random::Uniform(double low, double high) { return low + (high - low) * Uniform(); }

uint64_t Random::UniformInt(uint64_t bound) {
  // Draws below 2^64 mod `bound` are rejected: the number of the others is a multiple of `bound`.
  const uint64_t remainder = -bound % bound;
  uint64_t draw = NextU64();
  while (draw < remainder) draw = NextU64();
  return draw % bound;
}

// Marsaglia's polar method (SIAM Review 6, 1964): two numbers from each accepted point of the unit disc.
double Random::Normal() {
  if (has_spare_normal_) {
    has_spare_normal_ = false;
    return spare_normal_;
  }
  double x = 0.0;
  double y = 0.0;
  double radius2 = 0.0;
  do {
    x = Uniform(-1.0, 1.0);
    y = Uniform(-1.0, 1.0);
    radius2 = x * x + y * y;
  } while (radius2 >= 1.0 || radius2 == 0.0);
  const double scale = std::sqrt(-2.0 * std::log(radius2) / radius2);
  spare_normal_ = y * scale;
  has_spare_normal_ = true;
  return x * scale;
}

double Random::Exponential(double rate) { return -std::log1p(-Uniform()) / rate; }

uint32_t Random::Poisson(double mean) {
  // The number of arrivals of a process with rate 1 until `mean` (Knuth, The Art of Computer Programming 2, 3.4.1), in
  // blocks, so that exp(-mean) does not underflow.
  constexpr double kBlock = 500.0;
  uint32_t count = 0;
  for (double rest = mean; rest > 0.0; rest -= kBlock) {
    const double limit = std::exp(-std::min(rest, kBlock));
    for (double product = Uniform(); product > limit; product *= Uniform()) ++count;
  }
  return count;
}

}  // namespace evpose

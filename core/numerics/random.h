// SPDX-License-Identifier: Apache-2.0

// Random numbers with a fixed algorithm: the same seed gives the same integers and uniform numbers with every standard
// library. Normal(), Exponential() and Poisson() use the logarithm and exponential of the C library, which may differ
// in their last bit; they serve simulation and tests, not the estimation of poses.
#pragma once

#include <array>
#include <cstdint>

namespace evpose {

// SplitMix64's increment and output function (Steele, Lea and Flood, "Fast splittable pseudorandom number generators",
// OOPSLA 2014): a bijection; its bits look random for consecutive numbers.
inline constexpr uint64_t kSplitMix64Increment = 0x9e3779b97f4a7c15ull;
inline uint64_t HashNumber(uint64_t number) {
  uint64_t z = number + kSplitMix64Increment;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
  return z ^ (z >> 31);
}

// xoshiro256** (Blackman and Vigna, "Scrambled linear pseudorandom number generators", 2018), seeded by SplitMix64 as
// they recommend.
class Random {
 public:
  explicit Random(uint64_t seed);

  uint64_t NextU64();
  double Uniform();                         // [0, 1), a multiple of 2^-53
  double Uniform(double low, double high);  // [low, high)
  uint64_t UniformInt(uint64_t bound);      // [0, bound), all equally probable; bound > 0
  double Normal();                          // mean 0, standard deviation 1
  double Exponential(double rate);          // mean 1 / rate
  uint32_t Poisson(double mean);

 private:
  std::array<uint64_t, 4> state_;
  double spare_normal_ = 0.0;
  bool has_spare_normal_ = false;
};

}  // namespace evpose

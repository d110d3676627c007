// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/pixel_response.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "core/numerics/random.h"

namespace evpose {
namespace {

constexpr double kDark = 0.01;

PixelState StateAt(const PixelResponse& response, float light, float threshold) {
  PixelState state;
  state.input = state.output = state.memory = static_cast<float>(response.LogLight(light));
  state.threshold_on = state.threshold_off = threshold;
  return state;
}

TEST(DeterministicLogTest, EqualsTheStandardLibrary) {
  for (double x = 1e-6; x < 1e6; x *= 1.0173) EXPECT_NEAR(DeterministicLog(x), std::log(x), 1e-12 + 1e-15 * x) << x;
}

TEST(PixelResponseTest, WithoutLowPassEventsAreAtTheCrossingsOfTheLogarithm) {
  PixelResponse response(0.0, 1.0, kDark, 0.0, 0.0);
  PixelState state = StateAt(response, 0.1f, 0.25f);
  std::vector<Crossing> crossings;
  response.Advance(state, 0.1f, 0.9f, 10'000, crossings);
  ASSERT_EQ(crossings.size(), 8u);  // log(0.91 / 0.11) / 0.25 = 8.45
  for (size_t k = 0; k < crossings.size(); ++k) {
    const double light = 0.11 * std::exp(0.25 * static_cast<double>(k + 1)) - kDark;
    // Time error: 0.003 of the logarithm, times the light, divided by the slope of the light.
    EXPECT_NEAR(crossings[k].t_us, 10'000 * (light - 0.1) / 0.8, 0.003 * (light + kDark) * 10'000 / 0.8) << k;
    EXPECT_TRUE(crossings[k].is_on);
  }
  EXPECT_EQ(state.t_us, 10'000u);
}

TEST(PixelResponseTest, StepThroughTheLowPassIsTimedExactly) {
  constexpr double kBandwidthHz = 1000.0;
  const double tau_us = 1e6 / (2.0 * std::numbers::pi * kBandwidthHz);
  PixelResponse response(kBandwidthHz, 1.0, kDark, 0.0, 0.0);
  PixelState state = StateAt(response, 0.8f, 0.3f);
  state.input = static_cast<float>(response.LogLight(0.2f));  // the light decreases at this time
  const double step = state.output - state.input;
  std::vector<Crossing> crossings;
  response.Advance(state, 0.2f, 0.2f, 5000, crossings);
  ASSERT_EQ(crossings.size(), static_cast<size_t>(step / 0.3));
  for (size_t k = 0; k < crossings.size(); ++k) {
    EXPECT_NEAR(crossings[k].t_us, -tau_us * std::log(1.0 - 0.3 * static_cast<double>(k + 1) / step), 0.01);
    EXPECT_FALSE(crossings[k].is_on);
  }
}

// Numerical integration of the same pixel in steps of 1/50 us.
struct SteppedPixel {
  double output, memory, held_us;
  void Run(const PixelResponse& response, double light_from, double light_to, double begin_us, double length_us,
           double tau_us, double threshold, double refractory_us, double leak_per_us,
           std::vector<Crossing>& crossings) {
    constexpr double kDt = 0.02;
    const auto steps = static_cast<int>(std::lround(length_us / kDt));
    for (int i = 0; i < steps; ++i) {
      const double t = begin_us + (i + 1) * kDt;
      const double share = (i + 0.5) / steps;
      const double input = response.LogLight(static_cast<float>(light_from + share * (light_to - light_from)));
      output += (input - output) * (1.0 - std::exp(-kDt / tau_us));
      memory -= leak_per_us * kDt;
      if (t < held_us) continue;
      if (held_us >= 0.0) memory = output;
      held_us = kNotHeld;
      if (std::abs(output - memory) < threshold) continue;
      crossings.push_back({t, output > memory});
      held_us = t + refractory_us;
    }
  }
};

TEST(PixelResponseTest, EqualsABruteForceIntegration) {
  constexpr double kBandwidthHz = 800.0;
  constexpr double kRefractoryUs = 120.0;
  constexpr double kLeakPerUs = 1e-4;  // much more than that of a sensor, so that it has an effect within the test
  constexpr float kThreshold = 0.2f;
  PixelResponse response(kBandwidthHz, 1.0, kDark, kRefractoryUs, kLeakPerUs);
  const double tau_us = 1e6 / (2.0 * std::numbers::pi * kBandwidthHz);
  PixelState state = StateAt(response, 0.3f, kThreshold);
  SteppedPixel reference = {state.output, state.memory, kNotHeld};
  Random random(7);
  std::vector<Crossing> crossings;
  std::vector<Crossing> expected;
  float light = 0.3f;
  for (int i = 0; i < 60; ++i) {
    const auto next = static_cast<float>(random.Uniform(0.05, 1.0));
    const auto length_us = static_cast<uint32_t>(random.Uniform(50.0, 900.0));
    reference.Run(response, light, next, state.t_us, length_us, tau_us, kThreshold, kRefractoryUs, kLeakPerUs,
                  expected);
    response.Advance(state, light, next, state.t_us + length_us, crossings);
    light = next;
  }
  ASSERT_GT(expected.size(), 50u);
  ASSERT_EQ(crossings.size(), expected.size());
  for (size_t k = 0; k < expected.size(); ++k) {
    EXPECT_EQ(crossings[k].is_on, expected[k].is_on) << k;
    EXPECT_NEAR(crossings[k].t_us, expected[k].t_us, 4.0) << k;
  }
}

TEST(PixelResponseTest, IsSlowerInTheDark) {
  PixelResponse response(1000.0, 0.1, kDark, 0.0, 0.0);
  const auto first_us = [&response](float from, float to) {
    PixelState state = StateAt(response, from, 0.3f);
    state.input = static_cast<float>(response.LogLight(to));
    std::vector<Crossing> crossings;
    response.Advance(state, to, to, 20'000, crossings);
    return crossings.at(0).t_us;
  };
  // The same contrast, a factor of two, in the dark and in the light.
  EXPECT_GT(first_us(0.01f, 0.03f), 4.0 * first_us(0.49f, 0.99f));
}

TEST(PixelResponseTest, IsInactiveInTheRefractoryTimeAndMemorisesAtItsEnd) {
  PixelResponse response(0.0, 1.0, kDark, 2000.0, 0.0);
  PixelState state = StateAt(response, 0.1f, 0.25f);
  std::vector<Crossing> crossings;
  for (uint32_t t = 1; t <= 10; ++t) {
    response.Advance(state, 0.1f + 0.08f * (t - 1), 0.1f + 0.08f * t, 1000 * t, crossings);
  }
  ASSERT_GE(crossings.size(), 2u);
  for (size_t k = 1; k < crossings.size(); ++k) {
    const auto log_at = [](double t_us) { return std::log(kDark + 0.1 + 0.8 * t_us / 10'000); };
    EXPECT_GE(crossings[k].t_us - crossings[k - 1].t_us, 2000.0);
    EXPECT_NEAR(log_at(crossings[k].t_us) - log_at(crossings[k - 1].t_us + 2000.0), 0.25, 2e-3);
  }
}

TEST(PixelResponseTest, LeakReachesTheThresholdAtTheComputedTime) {
  PixelResponse response(1000.0, 1.0, kDark, 0.0, 0.25 * 2e-6);
  PixelState state = StateAt(response, 0.5f, 0.25f);
  EXPECT_NEAR(response.NextLeakUs(state), 500'000.0, 1.0);
  response.Rest(state, 100'000);
  EXPECT_NEAR(response.NextLeakUs(state), 500'000.0, 1.0);
  std::vector<Crossing> crossings;
  response.Advance(state, 0.5f, 0.5f, 1'600'000, crossings);
  ASSERT_EQ(crossings.size(), 3u);
  EXPECT_NEAR(crossings[0].t_us, 500'000.0, 2.0);
  EXPECT_NEAR(crossings[2].t_us, 1'500'000.0, 6.0);
  const PixelResponse tight(1000.0, 1.0, kDark, 0.0, 0.0);
  EXPECT_EQ(tight.NextLeakUs(state), std::numeric_limits<double>::infinity());
}

}  // namespace
}  // namespace evpose

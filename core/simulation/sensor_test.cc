// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/sensor.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <vector>

namespace evpose {
namespace {

constexpr int kSensorWidth = 80;
constexpr int kSensorHeight = 50;
constexpr size_t kNumPixels = size_t{kSensorWidth} * kSensorHeight;
constexpr SensorGeometry kGeometry = {kSensorWidth, kSensorHeight};
constexpr PixelRect kWholeSensor = {0, 0, kSensorWidth, kSensorHeight};
constexpr PixelRect kNothing = {};

SensorOptions Quiet() {
  SensorOptions options;
  options.leak_hz = options.shot_noise_hz = options.hot_pixel_ratio = 0.0;
  return options;
}

// A picture with light 0.9 in a bar from x0 to x1 and 0.1 elsewhere.
std::vector<float> Bar(double x0, double x1) {
  std::vector<float> picture(kNumPixels);
  for (int y = 0; y < kSensorHeight; ++y) {
    for (int x = 0; x < kSensorWidth; ++x) {
      const double covered = std::min(x1, x + 0.5) - std::max(x0, x - 0.5);
      picture[y * kSensorWidth + x] = static_cast<float>(0.1 + 0.8 * std::max(0.0, covered));
    }
  }
  return picture;
}

// A bar 12 px wide that moves from the left to the right by `px` at 1 px/ms.
std::vector<Event> MovingBar(const SensorOptions& options, double px, uint64_t seed, SensorCounts* counts = nullptr) {
  constexpr double kBegin = 10.2;
  constexpr double kWidthPx = 12.0;
  EventSensor sensor(options, kGeometry, Bar(kBegin, kBegin + kWidthPx), seed);
  std::vector<Event> events;
  constexpr double kStepPx = 0.25;
  for (int i = 1; i <= static_cast<int>(px / kStepPx); ++i) {
    const double x = kBegin + kStepPx * i;
    sensor.Advance(int64_t{250} * i, Bar(x, x + kWidthPx), kWholeSensor, events);
  }
  if (counts != nullptr) *counts = sensor.counts();
  return events;
}

// The events of a constant picture during `seconds`.
std::vector<Event> Still(const SensorOptions& options, double seconds, float light, SensorCounts* counts = nullptr) {
  const std::vector<float> picture(kNumPixels, light);
  EventSensor sensor(options, kGeometry, picture, 9);
  std::vector<Event> events;
  const int steps = static_cast<int>(seconds * 500);
  for (int i = 1; i <= steps; ++i) sensor.Advance(int64_t{2000} * i, picture, kNothing, events);
  if (counts != nullptr) *counts = sensor.counts();
  return events;
}

TEST(EventSensorTest, ABrightBarIsOnInFrontAndOffBehind) {
  SensorOptions options = Quiet();
  options.refractory_us = 0.0;
  const std::vector<Event> events = MovingBar(options, 30.0, 1);
  std::map<int, int> per_polarity;
  for (const Event& event : events) {
    const double front = 10.2 + 12.0 + event.t_us * 1e-3;
    const double back = 10.2 + event.t_us * 1e-3;
    const double edge = event.polarity == 1 ? front : back;
    EXPECT_NEAR(event.x, edge, 1.6) << event.t_us;
    ++per_polarity[event.polarity];
  }
  // An edge produces log(0.91 / 0.11) / 0.28 = 7.5 events per pixel.
  const double swept = 30.0 * kSensorHeight;
  EXPECT_NEAR(per_polarity[1], 7.5 * swept, 1.0 * swept);
  EXPECT_NEAR(per_polarity[0], 7.5 * swept, 1.0 * swept);
}

TEST(EventSensorTest, UnequalThresholdsGiveUnequalNumbers) {
  SensorOptions options = Quiet();
  options.threshold_off = 2.0 * options.threshold_on;
  options.refractory_us = 0.0;
  std::map<int, double> per_polarity;
  for (const Event& event : MovingBar(options, 30.0, 1)) ++per_polarity[event.polarity];
  EXPECT_NEAR(per_polarity[1] / per_polarity[0], 2.0, 0.2);
}

TEST(EventSensorTest, NoChangeNoEvents) { EXPECT_TRUE(Still(Quiet(), 1.0, 0.3f).empty()); }

TEST(EventSensorTest, APixelKeepsItsRefractoryTime) {
  SensorOptions options = Quiet();
  options.refractory_us = 700.0;
  options.shot_noise_hz = 300.0;
  options.hot_pixel_ratio = 0.05;
  options.hot_pixel_hz = 2000.0;
  options.noise_ratio = 0.5;
  std::map<std::pair<int, int>, int64_t> last_us;
  const std::vector<Event> events = MovingBar(options, 20.0, 1);
  ASSERT_GT(events.size(), 3000u);
  for (const Event& event : events) {
    const auto [place, is_first] = last_us.try_emplace({event.x, event.y}, event.t_us);
    if (!is_first) {
      ASSERT_GE(event.t_us - place->second, 700);
    }
    place->second = event.t_us;
  }
}

TEST(EventSensorTest, LeakRateIsTheNominalOne) {
  SensorOptions options = Quiet();
  options.leak_hz = 2.0;
  SensorCounts counts;
  const std::vector<Event> events = Still(options, 3.0, 0.3f, &counts);
  EXPECT_EQ(counts.noise_events, events.size());
  double number = 0.0;  // number in the last two seconds, because the memories start at random levels
  for (const Event& event : events) {
    ASSERT_EQ(event.polarity, 1);
    number += event.t_us >= 1'000'000 ? 1.0 : 0.0;
  }
  const double nominal = 2.0 * 2.0 * kSensorWidth * kSensorHeight;
  EXPECT_NEAR(number, nominal, 0.02 * nominal);
}

TEST(EventSensorTest, ShotNoiseRateIsTheNominalOneAndFallsWithLight) {
  SensorOptions options = Quiet();
  options.shot_noise_hz = 4.0;
  const double nominal = 4.0 * 2.0 * kSensorWidth * kSensorHeight;
  const std::vector<Event> dark = Still(options, 2.0, 0.0f);
  EXPECT_NEAR(static_cast<double>(dark.size()), nominal, 5.0 * std::sqrt(nominal));
  EXPECT_NEAR(static_cast<double>(Still(options, 2.0, 1.0f).size()), 0.25 * nominal, 5.0 * std::sqrt(nominal));
  double on = 0.0;
  for (const Event& event : dark) on += event.polarity;
  EXPECT_NEAR(on / static_cast<double>(dark.size()), 0.5, 0.02);
}

TEST(EventSensorTest, HotPixelsAreFewAndFast) {
  SensorOptions options = Quiet();
  options.hot_pixel_ratio = 0.005;
  options.hot_pixel_hz = 100.0;
  std::map<std::pair<int, int>, int> per_pixel;
  const std::vector<Event> events = Still(options, 4.0, 0.3f);
  for (const Event& event : events) ++per_pixel[{event.x, event.y}];
  const double number = 0.005 * kSensorWidth * kSensorHeight;  // 20 hot pixels
  EXPECT_LE(static_cast<double>(per_pixel.size()), number);
  EXPECT_GE(static_cast<double>(per_pixel.size()), 0.8 * number);
  EXPECT_NEAR(static_cast<double>(events.size()), number * 100.0 * 4.0, 0.15 * number * 100.0 * 4.0);
}

TEST(EventSensorTest, NoiseShareIsThatOfTheOptions) {
  for (const double ratio : {0.1, 0.4}) {
    SensorOptions options = Quiet();
    options.shot_noise_hz = 2.0;  // included in the noise share
    options.noise_ratio = ratio;
    SensorCounts counts;
    const std::vector<Event> events = MovingBar(options, 30.0, 1, &counts);
    EXPECT_EQ(counts.events, events.size());
    EXPECT_NEAR(static_cast<double>(counts.noise_events) / counts.events, ratio, 0.02);
  }
}

TEST(EventSensorTest, FloodsComeInTheMiddleOfTheirPeriodAtTheirRate) {
  SensorOptions options = Quiet();
  options.flood_hz = 2e5;
  options.flood_s = 0.05;
  options.flood_period_s = 0.4;
  SensorCounts counts;
  const std::vector<Event> events = Still(options, 1.2, 0.3f, &counts);
  // Three floods of 10000 events; a few of them are suppressed by refractory pixels.
  EXPECT_NEAR(static_cast<double>(events.size()), 30'000.0, 1500.0);
  EXPECT_EQ(counts.noise_events, events.size());
  for (const Event& event : events) {
    EXPECT_GE(event.t_us % 400'000, 200'000);
    EXPECT_LT(event.t_us % 400'000, 250'000);
  }
}

TEST(EventSensorTest, ThresholdMismatchSpreadsTheNumberOfEventsPerPixel) {
  const auto spread = [](double mismatch) {
    SensorOptions options = Quiet();
    options.threshold_on = options.threshold_off = 0.1;
    options.refractory_us = 0.0;
    options.bandwidth_hz = 0.0;
    options.threshold_mismatch_ratio = mismatch;
    std::map<int, double> per_row;
    for (const Event& event : MovingBar(options, 10.0, 1)) {
      if (event.x == 26 && event.polarity == 1) ++per_row[event.y];
    }
    double sum = 0.0, squares = 0.0;
    for (const auto& [row, n] : per_row) {
      sum += n;
      squares += n * n;
    }
    const double mean = sum / kSensorHeight;
    return std::sqrt(squares / kSensorHeight - mean * mean);
  };
  EXPECT_LT(spread(0.0), 0.8);  // 20 to 22 events per pixel
  EXPECT_GT(spread(0.15), 2.0);
}

TEST(EventSensorTest, IsDeterministicBySeed) {
  const SensorOptions options;
  EXPECT_EQ(MovingBar(options, 5.0, 1), MovingBar(options, 5.0, 1));
  EXPECT_NE(MovingBar(options, 5.0, 1), MovingBar(options, 5.0, 2));
}

TEST(EventSensorTest, PixelsBehindTheChangeSettle) {
  // The light changes in one step; the output of a slow low pass continues to change for a long time.
  SensorOptions options = Quiet();
  options.bandwidth_hz = 50.0;  // a time constant of 3.2 ms
  options.dark_bandwidth_ratio = 1.0;
  options.refractory_us = 0.0;
  EventSensor sensor(options, kGeometry, std::vector<float>(kNumPixels, 0.1f), 4);
  const std::vector<float> brighter(kNumPixels, 0.9f);
  std::vector<Event> events;
  sensor.Advance(100, brighter, kWholeSensor, events);
  const size_t at_once = events.size();
  for (int i = 1; i <= 60; ++i) sensor.Advance(100 + 1000 * i, brighter, kNothing, events);
  EXPECT_GT(events.size(), 5 * at_once);
  // On average half an event less than the contrast divided by the threshold, because the remainder is uniformly
  // distributed.
  EXPECT_NEAR(static_cast<double>(events.size()) / (kNumPixels), std::log(0.91 / 0.11) / 0.28 - 0.5, 0.1);
}

}  // namespace
}  // namespace evpose

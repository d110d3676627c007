// SPDX-License-Identifier: Apache-2.0
#include "core/calibration/sensor_calibration.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "core/numerics/random.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

// Passages of a sensor with this profile. Each has the error that its number of events implies, and the model error of
// its line and direction.
struct Passages {
  SensorProfile sensor;
  double slowest_px_per_s = 50.0;
  double fastest_px_per_s = 1500.0;
  double line_error_px = 0.02;
  int num_lines = 20;
  int per_line = 30;
  double kappa = 1.0;
};

CalibrationRecording Make(const Passages& wanted, uint64_t seed) {
  Random random(seed);
  CalibrationRecording recording{"made", {}};
  for (int line = 0; line < 2 * wanted.num_lines; ++line) {
    const double line_error_px = wanted.line_error_px * random.Normal();
    const double sign = line % 4 < 2 ? 1.0 : -1.0;
    const double contrast = random.Uniform(0.4, 2.5);
    for (int i = 0; i < wanted.per_line; ++i) {
      EdgePassage passage;
      passage.model_line = line / 2;
      passage.direction = line % 2 == 0 ? 1.0 : -1.0;
      passage.speed_px_per_s =
          wanted.slowest_px_per_s * std::pow(wanted.fastest_px_per_s / wanted.slowest_px_per_s, random.Uniform(0, 1));
      const double turns = random.Uniform(0.0, 1.0);
      // n' = n / (1 - n x): n is the counted number, x the dead time per event.
      const double thresholds = std::max(0.3, contrast / wanted.sensor.contrast_threshold - turns);
      const double taken = 1.0 - LiveAreaPx2(wanted.sensor, 1.0, 1.0, passage.speed_px_per_s);
      passage.rates.events_per_px2 = thresholds / (1.0 + thresholds * taken);
      passage.rates.reversals_per_px2 = passage.rates.recent_reversals_per_px2 = turns;
      passage.rates.kappa = wanted.kappa * sign;
      passage.num_events = 400.0;
      passage.spread_px = 0.5;
      passage.residual_px =
          ExpectedResidualPx(wanted.sensor, passage) + line_error_px + 0.5 * std::sqrt(20.0 / 400.0) * random.Normal();
      recording.passages.push_back(passage);
    }
  }
  return recording;
}

TEST(SensorCalibration, FindsTheConstantsWithinTheirStandardErrors) {
  Passages wanted;
  wanted.sensor = {"other", 0.5, 0.9, 0.18, 100.0, 300.0};
  int within = 0;
  constexpr int kSeeds = 12;
  for (uint64_t seed = 0; seed < kSeeds; ++seed) {
    const CalibrationRecording recording = Make(wanted, seed);
    const auto fit = CalibrateSensor({&recording, 1}, {});
    ASSERT_TRUE(fit.ok()) << fit.status();
    const auto check = [&](const char* what, double value, double truth, double error) {
      EXPECT_GT(error, 0.0) << what;
      EXPECT_LT(std::abs(value - truth), 4.0 * error) << what << ", seed " << seed;
      within += std::abs(value - truth) < error;
    };
    check("blur", fit->profile.blur_px, 0.9, fit->blur_error_px);
    check("threshold", fit->profile.contrast_threshold, 0.18, fit->contrast_threshold_error);
    check("latency", fit->profile.latency_us, 300.0, fit->latency_error_us);
    check("refractory time", fit->profile.refractory_us, 100.0, fit->refractory_error_us);
    EXPECT_LT(fit->fitted_rms_px, fit->initial_rms_px);
    EXPECT_LT(fit->initial_rms_px, fit->uncorrected_rms_px);
    EXPECT_NEAR(fit->profile.pixel_noise_px, 0.5, 1e-9);
    EXPECT_EQ(fit->fitted_times, FittedTimes::kBoth);
    EXPECT_TRUE(fit->warnings.empty());
  }
  // 68 % of a normal distribution: the standard errors are neither too small nor too large.
  EXPECT_GT(within, 4 * kSeeds * 45 / 100);
  EXPECT_LT(within, 4 * kSeeds * 90 / 100);
}

TEST(SensorCalibration, KeepsTheLatencyAtOneSpeedWithAWarning) {
  Passages wanted;
  wanted.slowest_px_per_s = 280.0;
  wanted.fastest_px_per_s = 320.0;
  wanted.sensor.blur_px = 0.7;
  const CalibrationRecording recording = Make(wanted, 1);
  SensorCalibrationOptions options;
  options.initial.latency_us = 77.0;
  const auto fit = CalibrateSensor({&recording, 1}, options);
  ASSERT_TRUE(fit.ok()) << fit.status();
  EXPECT_EQ(fit->fitted_times, FittedTimes::kNone);
  EXPECT_EQ(fit->profile.latency_us, 77.0);
  EXPECT_EQ(fit->profile.refractory_us, options.initial.refractory_us);
  ASSERT_EQ(fit->warnings.size(), 1u);
  EXPECT_THAT(fit->warnings[0], HasSubstr("latency_us stays at 77"));
  EXPECT_NEAR(fit->profile.blur_px, 0.7, 0.1);
}

TEST(SensorCalibration, KeepsARefractoryTimeThatSlowMotionDoesNotDetermine) {
  Passages wanted;
  wanted.slowest_px_per_s = 5.0;
  wanted.fastest_px_per_s = 40.0;
  const CalibrationRecording recording = Make(wanted, 1);
  SensorCalibrationOptions options;
  options.initial.refractory_us = 77.0;
  const auto fit = CalibrateSensor({&recording, 1}, options);
  ASSERT_TRUE(fit.ok()) << fit.status();
  EXPECT_EQ(fit->fitted_times, FittedTimes::kLatency);
  EXPECT_EQ(fit->profile.refractory_us, 77.0);
  EXPECT_EQ(fit->refractory_error_us, 0.0);
  EXPECT_GT(fit->latency_error_us, 0.0);
  ASSERT_EQ(fit->warnings.size(), 1u);
  EXPECT_THAT(fit->warnings[0], HasSubstr("refractory_us stays at 77: the recordings do not determine it"));
}

TEST(SensorCalibration, RejectsDataThatDoNotDetermineTheConstants) {
  const auto message = [](const Passages& wanted) {
    const CalibrationRecording recording = Make(wanted, 1);
    const auto fit = CalibrateSensor({&recording, 1}, {});
    EXPECT_EQ(fit.status().code(), absl::StatusCode::kFailedPrecondition);
    return std::string(fit.status().message());
  };
  Passages few_lines;
  few_lines.num_lines = 2;
  few_lines.per_line = 200;
  EXPECT_THAT(message(few_lines), HasSubstr("too little"));
  Passages little_motion;
  little_motion.per_line = 1;
  EXPECT_THAT(message(little_motion), HasSubstr("more motion"));
  Passages stripes;
  stripes.kappa = 0.2;
  EXPECT_THAT(message(stripes), HasSubstr("too little"));
  Passages rough;
  rough.line_error_px = 2.0;
  EXPECT_THAT(message(rough), ::testing::AnyOf(HasSubstr("do not determine"), HasSubstr("no sensor explains")));
  EXPECT_THAT(std::string(CalibrateSensor({}, {}).status().message()), HasSubstr("too little"));
}

TEST(SensorCalibration, OptionsNameTheField) {
  SensorCalibrationOptions options;
  options.min_kappa = 2.0;
  EXPECT_THAT(std::string(CalibrateSensor({}, options).status().message()), HasSubstr("min_kappa"));
  options = {};
  options.initial.blur_px = -1.0;
  EXPECT_THAT(std::string(CalibrateSensor({}, options).status().message()), HasSubstr("blur_px"));
}

}  // namespace
}  // namespace evpose

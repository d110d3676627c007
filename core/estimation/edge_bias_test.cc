// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/edge_bias.h"

#include <gtest/gtest.h>

#include "core/estimation/ideal_events_testing.h"

namespace evpose {
namespace {

using testing::MakeCamera;
using testing::MakePose;

class EdgeBiasTest : public ::testing::Test {
 protected:
  EdgeBiasTest() {
    state_.camera_from_object = MakePose({0.0, 0.0, 1.0}, {0.0, 0.0, 0.0});
    state_.twist[0] = 0.2;  // 200 px/s to the right
    Project();
  }
  void Project() { ProjectLines(camera_, state_, tracked_, lines_); }
  void Correct(const EdgeBias& bias) {
    std::vector<HalfOffsets> offsets;
    bias.FindOffsets(tracked_, offsets);
    bias.Correct(offsets, absl::MakeSpan(lines_));
  }
  // Expected distance of an event at the middle of the line, along the motion, pixels.
  double ExpectedAlongMotion(const EdgeBias& bias) {
    Correct(bias);
    const Eigen::Vector3d middle = BearingOf(camera_, lines_[0].PointAt(0.5));
    const double sign = -middle.dot(lines_[0].a_dot) > 0.0 ? 1.0 : -1.0;
    return sign * (lines_[0].a - lines_[0].a_expected).dot(middle);
  }
  // Learns from a window of 10 ms, in which the line of 100 px sweeps 200 px^2.
  void Learn(EdgeBias& bias, double off, double on, double reversals = 0.0) {
    const std::vector<EdgeCounts> counts = {{{off, on}, {0.5 * reversals, 0.5 * reversals}}};
    bias.Learn(tracked_, lines_, counts, 0.01);
  }
  void MoveBack() {
    state_.twist[0] = -0.2;
    Project();
  }
  double OnEventsPx(double contrast, double hysteresis) const {
    return sensor_.blur_px * EdgeResponse::Get().MeanOfOnEvents(contrast, hysteresis);
  }
  double OffEventsPx(double contrast, double hysteresis) const {
    return sensor_.blur_px * EdgeResponse::Get().MeanOfOffEvents(contrast, hysteresis);
  }

  const CameraModel camera_ = MakeCamera(1280, 720, 1000.0);
  const std::vector<TrackedLine> tracked_ = {{0, {0.0, -0.05, 0.0}, {0.0, 0.05, 0.0}}};
  MotionState state_;
  std::vector<ImageLine> lines_;
  EdgeOptions options_;
  SensorProfile sensor_ = InTime();

  static SensorProfile InTime() {
    SensorProfile sensor;
    sensor.latency_us = 0.0;
    sensor.refractory_us = 0.0;
    return sensor;
  }
};

TEST_F(EdgeBiasTest, NothingIsAppliedBeforeTheContrastIsKnown) {
  EdgeBias bias(options_, sensor_, camera_);
  EXPECT_EQ(ExpectedAlongMotion(bias), 0.0);
  Learn(bias, 0.0, options_.min_events - 1.0);
  EXPECT_EQ(ExpectedAlongMotion(bias), 0.0);
}

TEST_F(EdgeBiasTest, AnEdgeShiftsToItsDarkerSide) {
  EdgeBias bias(options_, sensor_, camera_);
  Learn(bias, 0.0, 800.0);  // 4 events per px^2, all ON: the dark side is ahead
  const double contrast = 4.0 * sensor_.contrast_threshold;
  EXPECT_GT(OnEventsPx(contrast, 0.0), 0.1);
  EXPECT_NEAR(ExpectedAlongMotion(bias), OnEventsPx(contrast, 0.0), 2e-3);
  MoveBack();  // OFF events: the dark side is behind
  EXPECT_NEAR(ExpectedAlongMotion(bias), OffEventsPx(contrast, 0.0), 2e-3);
}

TEST_F(EdgeBiasTest, EventsAfterAPolarityReversalLag) {
  EdgeBias bias(options_, sensor_, camera_);
  Learn(bias, 0.0, 600.0, 200.0);  // 3 events per pixel, and one threshold for the reversal
  const double contrast = 4.0 * sensor_.contrast_threshold;
  EXPECT_LT(OnEventsPx(contrast, 0.25), OnEventsPx(contrast, 0.0) - 0.05);
  EXPECT_NEAR(ExpectedAlongMotion(bias), OnEventsPx(contrast, 0.25), 2e-3);
  // Without reversals for longer than they are remembered, the lag disappears; the contrast is unchanged.
  for (int i = 0; i < 20; ++i) Learn(bias, 0.0, 800.0);
  EXPECT_NEAR(ExpectedAlongMotion(bias), OnEventsPx(contrast, 0.0), 2e-3);
}

TEST_F(EdgeBiasTest, ALineMayLagOnOneOfItsHalvesOnly) {
  EdgeBias bias(options_, sensor_, camera_);
  bias.Learn(tracked_, lines_, std::vector<EdgeCounts>{{{0.0, 700.0}, {100.0, 0.0}}}, 0.01);
  Correct(bias);
  const auto expected_px = [&](double fraction) {
    return (lines_[0].a - lines_[0].a_expected).dot(BearingOf(camera_, lines_[0].PointAt(fraction)));
  };
  const double lag_px = std::abs(expected_px(0.25) - expected_px(0.75));
  const double contrast = 4.0 * sensor_.contrast_threshold;
  EXPECT_NEAR(lag_px, OnEventsPx(contrast, 0.0) - OnEventsPx(contrast, 0.25), 2e-3);
}

TEST_F(EdgeBiasTest, AnUnknownPreviousEventCountsHalf) {
  EdgeCounts counts;
  Observation event;
  event.polarity = 1;
  for (const PreviousPolarity previous :
       {PreviousPolarity::kUnknown, PreviousPolarity::kSame, PreviousPolarity::kOther}) {
    event.previous = previous;
    counts.Add(event, 1, 0.5);
  }
  EXPECT_DOUBLE_EQ(counts.polarity[1], 1.5);
  EXPECT_DOUBLE_EQ(counts.reversals[1], 0.75);
  EXPECT_EQ(counts.reversals[0], 0.0);
}

TEST_F(EdgeBiasTest, AStripeLagsButIsNotShifted) {
  EdgeBias bias(options_, sensor_, camera_);
  Learn(bias, 600.0, 600.0, 400.0);  // two edges, each with 3 events and a reversal per pixel
  const double contrast = 4.0 * sensor_.contrast_threshold;
  const double lag_px = 0.5 * (OnEventsPx(contrast, 0.25) + OffEventsPx(contrast, 0.25));
  EXPECT_LT(lag_px, -0.05);
  EXPECT_NEAR(ExpectedAlongMotion(bias), lag_px, 2e-3);
  MoveBack();
  EXPECT_NEAR(ExpectedAlongMotion(bias), lag_px, 2e-3);
}

TEST_F(EdgeBiasTest, EventsLostInTheRefractoryPeriodAreCorrected) {
  sensor_.refractory_us = 200.0;
  EdgeBias bias(options_, sensor_, camera_);
  Learn(bias, 0.0, 600.0);
  // During the dead time after each of the 3 events the edge moves by 0.04 px; it is 2 sqrt(pi) blurs wide.
  const double missed_ratio = 3.0 * 0.04 / (3.5449 * sensor_.blur_px);
  const double contrast = 3.0 / (1.0 - missed_ratio) * sensor_.contrast_threshold;
  EXPECT_NEAR(ExpectedAlongMotion(bias), OnEventsPx(contrast, 0.0), 2e-3);
  EXPECT_GT(LiveAreaPx2(sensor_, 1.0, 1e6, 1e6), 0.0);
}

TEST_F(EdgeBiasTest, LateTimeStampsDisplaceAgainstTheMotion) {
  sensor_.latency_us = 1000.0;
  EdgeBias bias(options_, sensor_, camera_);
  EXPECT_NEAR(ExpectedAlongMotion(bias), -0.2, 1e-9);  // 200 px/s times one millisecond, for every contrast
}

TEST_F(EdgeBiasTest, AtRestNothingIsLearnedAndNoLagIsExpected) {
  EdgeBias bias(options_, sensor_, camera_);
  Learn(bias, 0.0, 800.0);
  state_.twist[0] = 0.0;
  Project();
  Learn(bias, 5000.0, 0.0);
  const Eigen::Vector3d middle = BearingOf(camera_, lines_[0].PointAt(0.5));
  Correct(bias);
  // The shift towards the dark side, which does not depend on the direction, remains.
  const double contrast = 4.0 * sensor_.contrast_threshold;
  const double shift_px = 0.5 * (OnEventsPx(contrast, 0.0) - OffEventsPx(contrast, 0.0));
  EXPECT_NEAR(std::abs((lines_[0].a - lines_[0].a_expected).dot(middle)), shift_px, 1e-9);
}

}  // namespace
}  // namespace evpose

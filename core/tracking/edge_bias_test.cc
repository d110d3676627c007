#include "core/tracking/edge_bias.h"

#include <gtest/gtest.h>

#include "core/tracking/ideal_events.h"

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
  // Expected distance of an event at the line's middle, along the motion.
  double ExpectedAlongMotion(const EdgeBias& bias) {
    bias.Correct(tracked_, absl::MakeSpan(lines_));
    const Eigen::Vector3d middle = BearingOf(camera_, lines_[0].PointAt(0.5));
    const double sign = -middle.dot(lines_[0].a_dot) > 0.0 ? 1.0 : -1.0;
    return sign * (lines_[0].a - lines_[0].a_expected).dot(middle);
  }
  // A window of 10 ms: the line, 100 px long, sweeps 200 px^2.
  void Learn(EdgeBias& bias, double off, double on) {
    const std::vector<std::array<double, 2>> weights = {{off, on}};
    bias.Learn(tracked_, lines_, weights, 0.01, 1.0);
  }

  const CameraModel camera_ = MakeCamera(1280, 720, 1000.0);
  const std::vector<TrackedLine> tracked_ = {{0, {0.0, -0.05, 0.0}, {0.0, 0.05, 0.0}}};
  MotionState state_;
  std::vector<ImageLine> lines_;
  EdgeOptions options_;
  SensorProfile sensor_;
};

TEST_F(EdgeBiasTest, NothingIsAppliedBeforeTheContrastIsKnown) {
  EdgeBias bias(options_, sensor_, camera_);
  EXPECT_EQ(ExpectedAlongMotion(bias), 0.0);
  Learn(bias, 0.0, options_.min_events - 1.0);
  EXPECT_EQ(ExpectedAlongMotion(bias), 0.0);
}

TEST_F(EdgeBiasTest, AnEdgeLagsAndShiftsToItsDarkerSide) {
  EdgeBias bias(options_, sensor_, camera_);
  Learn(bias, 0.0, 800.0);  // 4 events per px^2, all ON: the dark side is ahead
  const double shift_px = 4.0 * sensor_.edge_shift_px_per_event;
  EXPECT_NEAR(ExpectedAlongMotion(bias), shift_px - sensor_.lag_px, 2e-3);
  // The same edge moving back: OFF events, the dark side is behind.
  state_.twist[0] = -0.2;
  Project();
  EXPECT_NEAR(ExpectedAlongMotion(bias), -shift_px - sensor_.lag_px, 2e-3);
}

TEST_F(EdgeBiasTest, TheShiftIsBounded) {
  EdgeBias bias(options_, sensor_, camera_);
  Learn(bias, 0.0, 50'000.0);
  EXPECT_NEAR(ExpectedAlongMotion(bias), sensor_.max_edge_shift_px - sensor_.lag_px, 2e-3);
}

TEST_F(EdgeBiasTest, AStripeLagsButIsNotShifted) {
  EdgeBias bias(options_, sensor_, camera_);
  Learn(bias, 400.0, 500.0);
  EXPECT_NEAR(ExpectedAlongMotion(bias), -sensor_.lag_px, 2e-3);
}

TEST_F(EdgeBiasTest, LateTimeStampsShowWhereTheLineWas) {
  sensor_.lag_px = 0.0;
  sensor_.latency_us = 1000.0;
  EdgeBias bias(options_, sensor_, camera_);
  EXPECT_NEAR(ExpectedAlongMotion(bias), -0.2, 1e-9);  // 200 px/s for a millisecond, whatever the contrast
}

TEST_F(EdgeBiasTest, AtRestNothingIsLearnedAndNoLagIsExpected) {
  EdgeBias bias(options_, sensor_, camera_);
  Learn(bias, 0.0, 800.0);
  state_.twist[0] = 0.0;
  Project();
  Learn(bias, 5000.0, 0.0);
  const Eigen::Vector3d middle = BearingOf(camera_, lines_[0].PointAt(0.5));
  bias.Correct(tracked_, absl::MakeSpan(lines_));
  EXPECT_NEAR(std::abs((lines_[0].a - lines_[0].a_expected).dot(middle)), 4.0 * sensor_.edge_shift_px_per_event, 1e-9);
}

}  // namespace
}  // namespace evpose

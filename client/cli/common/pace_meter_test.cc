// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/pace_meter.h"

#include <gtest/gtest.h>

namespace evpose::client {
namespace {

// The health of a session at 2 Mev/s.
SessionHealth Health(double sensor_s, double processing_s) {
  constexpr double kRateHz = 2e6;
  SessionHealth health;
  health.decoded_events = static_cast<uint64_t>(kRateHz * sensor_s);
  health.event_rate_hz = sensor_s > 0.0 ? kRateHz : 0.0;
  health.real_time_ratio = sensor_s > 0.0 ? processing_s / sensor_s : 0.0;
  return health;
}

TEST(PaceMeterTest, TimeOfTheSensorIsThatOfItsEvents) {
  EXPECT_EQ(SensorSeconds(SessionHealth()), 0.0);
  EXPECT_NEAR(SensorSeconds(Health(1.25, 1.0)), 1.25, 1e-9);
}

TEST(PaceMeterTest, AFirstSearchIsNotThePace) {
  PaceMeter meter;
  EXPECT_EQ(meter.Update(Health(0.0, 0.0)), "");
  EXPECT_EQ(meter.Update(Health(0.05, 1.0)), "") << "the search has taken a second";
  EXPECT_EQ(meter.Update(Health(0.75, 1.25)), "");
  EXPECT_EQ(meter.Update(Health(1.5, 1.5)), "can track 2.9 x real time") << "since the report after the search";
  EXPECT_EQ(meter.Update(Health(2.25, 1.75)), "can track 3.0 x real time");
}

TEST(PaceMeterTest, ASlowSecondLateInALongRunIsReported) {
  PaceMeter meter;
  double processing_s = 0.0;
  for (double sensor_s = 0.0; sensor_s < 1000.0; sensor_s += 0.5) meter.Update(Health(sensor_s, processing_s += 0.1));
  EXPECT_EQ(meter.Update(Health(1000.0, processing_s += 0.1)), "can track 5.0 x real time");
  EXPECT_EQ(meter.Update(Health(1000.5, processing_s += 1.0)), "can track 0.9 x real time: too slow");
  EXPECT_EQ(meter.Update(Health(1001.0, processing_s += 1.0)), "can track 0.5 x real time: too slow");
  EXPECT_EQ(meter.Update(Health(1001.5, processing_s += 0.1)), "can track 0.9 x real time: too slow");
  EXPECT_EQ(meter.Update(Health(1002.0, processing_s += 0.1)), "can track 5.0 x real time");
}

TEST(PaceMeterTest, ManyReportsInASecondAreJoined) {
  PaceMeter meter;
  std::string text;
  for (int i = 0; i <= 200; ++i) text = meter.Update(Health(0.01 * i, 0.2 * i));
  EXPECT_EQ(text, "can track 0.05 x real time: too slow");
}

TEST(PaceMeterTest, AStalledStreamIsNotSlow) {
  PaceMeter meter;
  meter.Update(Health(0.1, 0.1));
  EXPECT_EQ(meter.Update(Health(1.6, 2.6)), "can track 0.6 x real time: too slow");
  EXPECT_EQ(meter.Update(Health(1.6, 2.6)), "") << "no events have arrived";
  EXPECT_EQ(meter.Update(Health(1.6, 2.6)), "");
}

TEST(PaceMeterTest, AServerThatContinuesFromAnEarlierStateIsMeasuredAnew) {
  PaceMeter meter;
  meter.Update(Health(5.0, 1.0));
  EXPECT_EQ(meter.Update(Health(7.0, 2.0)), "can track 2.0 x real time");
  EXPECT_EQ(meter.Update(Health(6.0, 1.5)), "");
  EXPECT_EQ(meter.Update(Health(7.0, 3.5)), "can track 0.5 x real time: too slow");
}

}  // namespace
}  // namespace evpose::client

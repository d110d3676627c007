// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/tracking_scenarios.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>

namespace evpose {
namespace {

using ::testing::HasSubstr;

TEST(TrackingScenariosTest, CanBeSimulatedOnEveryPath) {
  std::set<std::string> names;
  for (const TrackingScenario& scenario : TrackingScenarios()) {
    EXPECT_TRUE(names.insert(scenario.name).second) << scenario.name;
    EXPECT_FALSE(scenario.description.empty()) << scenario.name;
    for (uint64_t path = 1; path <= 5; ++path) {
      const SimulationOptions run = TrackingRun(scenario, 1, path, 0);
      EXPECT_TRUE(run.Validate().ok()) << scenario.name << ": " << run.Validate();
    }
  }
  EXPECT_EQ(names.size(), 17u);
}

// The table of simulated events in the paper.
TEST(TrackingScenariosTest, SpeedsAreThePapers) {
  const struct {
    const char* name;
    double duration_s, speed, angular_speed;
  } rows[] = {{"normal", 20, 0.71, 0.32},
              {"fast", 10, 1.41, 0.63},
              {"faster", 5, 2.83, 1.26},
              {"constant-light", 10, 0.77, 0.18},
              {"changing-light", 10, 0.77, 0.18}};
  for (const auto& row : rows) {
    const TrackingScenario scenario = FindTrackingScenarios({row.name})->front();
    double length_m = 0.0, angle_rad = 0.0, seconds = 0.0;
    for (uint64_t path = 1; path <= 5; ++path) {
      const Trajectory truth = SimulatedTruth(TrackingRun(scenario, 1, path, 0));
      ASSERT_EQ(truth.size(), static_cast<size_t>(row.duration_s * 1000) + 1);
      for (size_t i = 1; i < truth.size(); ++i) {
        const RigidTransform& a = truth[i - 1].camera_from_object;
        const RigidTransform& b = truth[i].camera_from_object;
        length_m += (b.translation_m - a.translation_m).norm();
        angle_rad += RotationAngle(a.rotation, b.rotation);
      }
      seconds += row.duration_s;
    }
    EXPECT_NEAR(length_m / seconds, row.speed, 0.1 * row.speed) << row.name;
    EXPECT_NEAR(angle_rad / seconds, row.angular_speed, 0.2 * row.angular_speed) << row.name;
  }
}

TEST(TrackingScenariosTest, ARunHasItsSeedsAndDuration) {
  const TrackingScenario scenario = FindTrackingScenarios({"cube"})->front();
  const SimulationOptions run = TrackingRun(scenario, 3, 4, 250'000);
  EXPECT_EQ(run.seed, 3u);
  EXPECT_EQ(run.path_seed, 4u);
  EXPECT_EQ(run.duration_us, 250'000);
  EXPECT_EQ(TrackingRun(scenario, 3, 4, 0).duration_us, scenario.simulation.duration_us);
}

TEST(TrackingScenariosTest, NamesAreInTheTablesOrderAndMustBeKnown) {
  const auto some = FindTrackingScenarios({"cube", "normal"});
  ASSERT_TRUE(some.ok());
  ASSERT_EQ(some->size(), 2u);
  EXPECT_EQ((*some)[0].name, "normal");
  EXPECT_EQ((*some)[1].name, "cube");
  const absl::Status status = FindTrackingScenarios({"teapot"}).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(status.message()), HasSubstr("half-out"));
}

}  // namespace
}  // namespace evpose

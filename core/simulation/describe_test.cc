// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/describe.h"

#include <gtest/gtest.h>

#include <functional>
#include <set>
#include <vector>

namespace evpose {
namespace {

TEST(DescribeSimulationTest, EqualOptionsHaveEqualTexts) {
  SimulationOptions options;
  EXPECT_EQ(DescribeSimulation(options), DescribeSimulation(SimulationOptions()));
  options.path_seed = options.seed;  // the default
  EXPECT_EQ(DescribeSimulation(options), DescribeSimulation(SimulationOptions()));
}

TEST(DescribeSimulationTest, EveryChangeChangesTheText) {
  const std::vector<std::function<void(SimulationOptions&)>> changes = {
      [](auto& o) { o.scene.object = SimulatedObject::kBook; },
      [](auto& o) { o.scene.motion.speed_m_per_s += 1e-15; },
      [](auto& o) { o.scene.motion.profile = MotionProfile::kHalfOut; },
      [](auto& o) { o.scene.motion.view_angle_rad = 0.1; },
      [](auto& o) { o.scene.background.texture_rectangles = 40; },
      [](auto& o) { o.scene.background.texture_speed_px_per_s = 300.0; },
      [](auto& o) { o.scene.background.has_moving_edge = true; },
      [](auto& o) { o.scene.light.reaches_background = true; },
      [](auto& o) { o.scene.occluder.follows_object = true; },
      [](auto& o) { o.scene.lens_blur_px = 0.6; },
      [](auto& o) { o.sensor.flood_hz = 1.0; },
      [](auto& o) { o.sensor.threshold_off = 0.3; },
      [](auto& o) { o.camera.distortion[4] = 0.1; },
      [](auto& o) { o.camera.lens_model = LensModel::kFisheye; },
      [](auto& o) { o.camera.cx_px += 0.5; },
      [](auto& o) { o.t_begin_us += 1; },
      [](auto& o) { o.duration_us += 1; },
      [](auto& o) { o.max_step_px = 0.5; },
      [](auto& o) { o.seed = 2; },
      [](auto& o) { o.path_seed = 2; },
  };
  std::set<std::string> texts = {DescribeSimulation(SimulationOptions())};
  for (const auto& change : changes) {
    SimulationOptions options;
    change(options);
    texts.insert(DescribeSimulation(options));
  }
  EXPECT_EQ(texts.size(), changes.size() + 1);
}

}  // namespace
}  // namespace evpose

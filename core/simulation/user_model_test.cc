// SPDX-License-Identifier: Apache-2.0

// Simulations of models of the user.
#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <vector>

#include "core/base/temporary_directory_testing.h"
#include "core/simulation/describe.h"
#include "core/simulation/objects.h"
#include "core/simulation/simulate_testing.h"
#include "core/simulation/simulator.h"

namespace evpose {
namespace {

// The cube of the simulator, moved 5 m away from the origin of its file.
std::shared_ptr<const ObjectModel> FarCube(double size_m) {
  auto model = std::make_shared<ObjectModel>(MakeSceneObject(SimulatedObject::kCube, size_m).model);
  for (Eigen::Vector3d& vertex : model->vertices) vertex.x() += 5.0;
  for (ModelLine& line : model->lines) {
    line.p1.x() += 5.0;
    line.p2.x() += 5.0;
  }
  return model;
}

SimulationOptions ShortRun(double size_m = 0.2) {
  SimulationOptions options = *ModelSimulationPreset(FarCube(size_m), "vga");
  options.duration_us = 20'000;
  return options;
}

TEST(UserModelTest, EmitsEventsNearItsOutline) {
  const SimulationOptions options = ShortRun();
  const std::vector<Event> events = SimulatedEvents(options);
  ASSERT_GT(events.size(), 1000u);
  const RigidTransform pose = SimulatedTruth(options).front().camera_from_object;
  const Eigen::Vector2d centre = options.camera.Distort(options.camera.Project(pose * Eigen::Vector3d(5.0, 0.0, 0.0)));
  size_t near = 0;
  for (const Event& event : events) near += (Eigen::Vector2d(event.x, event.y) - centre).norm() < 90.0 ? 1 : 0;
  EXPECT_GT(static_cast<double>(near), 0.9 * static_cast<double>(events.size()));
}

TEST(UserModelTest, SameOptionsGiveTheSameEvents) {
  const std::vector<Event> events = SimulatedEvents(ShortRun());
  EXPECT_EQ(SimulatedEvents(ShortRun()), events);
  SimulationOptions other = ShortRun();
  other.path_seed = 7;
  EXPECT_NE(SimulatedEvents(other), events);
  EXPECT_GT(RotationAngle(SimulatedTruth(other).front().camera_from_object.rotation,
                          SimulatedTruth(ShortRun()).front().camera_from_object.rotation),
            0.1)
      << "the attitude must depend on the seed of the path";
}

TEST(UserModelTest, DistanceAndSpeedFollowFromTheSize) {
  const SimulationOptions small = ShortRun(0.002), large = ShortRun(20.0);
  EXPECT_NEAR(large.scene.motion.depth_m / small.scene.motion.depth_m, 1e4, 1.0);
  EXPECT_NEAR(large.scene.motion.speed_m_per_s / small.scene.motion.speed_m_per_s, 1e4, 1.0);
}

TEST(UserModelTest, DescriptionDependsOnTheModelAndItsFinish) {
  const SimulationOptions options = ShortRun();
  EXPECT_EQ(DescribeSimulation(options), DescribeSimulation(ShortRun()));
  EXPECT_NE(DescribeSimulation(options), DescribeSimulation(ShortRun(0.21)));
  SimulationOptions shiny = options;
  shiny.scene.finish.specular_ratio = 0.5;
  EXPECT_NE(DescribeSimulation(options), DescribeSimulation(shiny));
}

TEST(UserModelTest, ModelsWithoutFacesAreRefused) {
  ObjectModel lines = *FarCube(0.2);
  lines.triangles.clear();
  const auto options = ModelSimulationPreset(std::make_shared<const ObjectModel>(lines));
  ASSERT_FALSE(options.ok());
  EXPECT_EQ(options.status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(UserModelTest, WritesTheMeshWithoutTheLinesThatWereFoundInIt) {
  const TemporaryDirectory directory;
  SimulationOptions options = ShortRun();
  options.duration_us = 1000;
  ASSERT_TRUE(SimulateToDirectory(options, directory.path()).ok());
  const auto model = LoadObjectModel(directory.File("model.obj"));
  ASSERT_TRUE(model.ok()) << model.status();
  EXPECT_EQ(model->triangles.size(), options.scene.model->triangles.size());
  EXPECT_EQ(model->lines.size(), 12u);
  for (const ModelLine& line : model->lines) EXPECT_EQ(line.face_normals.size(), 2u);
}

}  // namespace
}  // namespace evpose

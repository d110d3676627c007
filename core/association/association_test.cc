// SPDX-License-Identifier: Apache-2.0
#include "core/association/association.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/estimation/ideal_events_testing.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

using testing::MakeCamera;
using testing::MakeCube;
using testing::MakePose;

std::vector<TrackedLine> AllLines(const ObjectModel& model) {
  std::vector<TrackedLine> lines;
  for (size_t k = 0; k < model.lines.size(); ++k) {
    lines.push_back({static_cast<int>(k), model.lines[k].p1, model.lines[k].p2});
  }
  return lines;
}

Observation ObservationAt(const CameraModel& camera, double u_px, double v_px, double tau_s, const TileGrid& grid) {
  Observation event;
  const Eigen::Vector3d bearing = BearingOf(camera, {u_px, v_px});
  event.bx = bearing.x();
  event.by = bearing.y();
  event.u_px = u_px;
  event.v_px = v_px;
  event.tau_s = tau_s;
  grid.GiveLines(event);
  return event;
}

TEST(TileGrid, FindsTheSameLinesAsASearchOfAllLines) {
  const CameraModel camera = MakeCamera(640, 480, 600.0);
  const auto cube = MakeCube(0.2);
  MotionState state;
  state.camera_from_object = MakePose({0.02, 0.01, 0.7}, {0.5, 0.4, 0.1});
  state.twist << 0.2, 0.1, -0.1, 1.0, 0.5, -1.0;
  std::vector<ImageLine> lines;
  const std::vector<TrackedLine> tracked = AllLines(*cube);
  ProjectLines(camera, state, tracked, lines);
  std::vector<uint16_t> all;
  for (size_t k = 0; k < lines.size(); ++k) all.push_back(static_cast<uint16_t>(k));

  constexpr double kGatePx = 5.0;
  TileGrid grid(camera);
  grid.Build(lines, kGatePx + 3.0);
  Random random(2);
  int found = 0;
  for (int i = 0; i < 20'000; ++i) {
    const Observation event =
        ObservationAt(camera, random.Uniform(-20, 660), random.Uniform(-20, 500), random.Uniform(-1e-3, 1e-3), grid);
    ASSERT_NE(grid.TileOf(event.u_px, event.v_px), TileGrid::kNoTile);
    const NearLines near = FindNearLines(event, lines.data(), kGatePx, 2.0);
    const NearLines reference = FindNearLines(event, all, lines.data(), kGatePx, 2.0);
    ASSERT_EQ(near.count, reference.count) << event.u_px << " " << event.v_px;
    for (int k = 0; k < near.count; ++k) {
      EXPECT_EQ(near.distance_px[k], reference.distance_px[k]);
    }
    found += near.count;
  }
  EXPECT_GT(found, 500);
}

TEST(TileGrid, RebuildingRemovesTheOldLines) {
  const CameraModel camera = MakeCamera(640, 480, 600.0);
  const auto cube = MakeCube(0.2);
  MotionState state;
  state.camera_from_object = MakePose({0.0, 0.0, 0.7}, {0.5, 0.4, 0.1});
  std::vector<ImageLine> lines;
  ProjectLines(camera, state, AllLines(*cube), lines);
  TileGrid grid(camera);
  grid.Build(lines, 8.0);
  grid.Build({}, 8.0);
  for (double v = 0.0; v < 480.0; v += 8.0) {
    for (double u = 0.0; u < 640.0; u += 8.0) EXPECT_TRUE(grid.Lines(grid.TileOf(u, v)).empty());
  }
  EXPECT_EQ(grid.TileOf(-1000.0, 0.0), TileGrid::kNoTile);
  EXPECT_EQ(grid.TileOf(std::nan(""), 0.0), TileGrid::kNoTile);
}

TEST(FindNearLines, GivesTheNearestTwoInOrder) {
  const CameraModel camera = MakeCamera(640, 480, 600.0);
  MotionState state;
  state.camera_from_object = MakePose({0.0, 0.0, 1.0}, {0.0, 0.0, 0.0});
  // Three vertical lines, at u = c, c + 3 and c + 6 pixels.
  std::vector<TrackedLine> tracked;
  for (int k = 0; k < 3; ++k) tracked.push_back({k, {k * 3.0 / 600.0, -0.1, 0.0}, {k * 3.0 / 600.0, 0.1, 0.0}});
  std::vector<ImageLine> lines;
  ProjectLines(camera, state, tracked, lines);
  TileGrid grid(camera);
  grid.Build(lines, 10.0);
  const Observation event = ObservationAt(camera, camera.cx_px + 2.0, camera.cy_px, 0.0, grid);
  const NearLines near = FindNearLines(event, lines.data(), 8.0, 2.0);
  ASSERT_EQ(near.count, 2);
  EXPECT_EQ(near.line[0], 1);
  EXPECT_EQ(near.line[1], 0);
  EXPECT_NEAR(std::abs(near.distance_px[0]), 1.0, 1e-9);
  EXPECT_NEAR(std::abs(near.distance_px[1]), 2.0, 1e-9);
  // The lines end 60 px from their middle; beyond there is none.
  const Observation beyond = ObservationAt(camera, camera.cx_px, camera.cy_px + 63.0, 0.0, grid);
  EXPECT_EQ(FindNearLines(beyond, lines.data(), 8.0, 2.0).count, 0);
}

TEST(FindNearLines, FollowsTheMotionWithinTheWindow) {
  const CameraModel camera = MakeCamera(640, 480, 600.0);
  MotionState state;
  state.camera_from_object = MakePose({0.0, 0.0, 1.0}, {0.0, 0.0, 0.0});
  state.twist[0] = 2.0;  // 1200 px/s to the right
  const std::vector<TrackedLine> tracked = {{0, {0.0, -0.1, 0.0}, {0.0, 0.1, 0.0}}};
  std::vector<ImageLine> lines;
  ProjectLines(camera, state, tracked, lines);
  TileGrid grid(camera);
  grid.Build(lines, 10.0);
  const Observation event = ObservationAt(camera, camera.cx_px + 2.4, camera.cy_px, 2e-3, grid);
  const NearLines near = FindNearLines(event, lines.data(), 5.0, 2.0);
  ASSERT_EQ(near.count, 1);
  EXPECT_NEAR(near.distance_px[0], 0.0, 1e-9);
}

TEST(KeepLinesWithin, KeepsLinesWithinReachAtTheEventsTime) {
  const CameraModel camera = MakeCamera(640, 480, 600.0);
  MotionState state;
  state.camera_from_object = MakePose({0.0, 0.0, 1.0}, {0.0, 0.0, 0.0});
  state.twist[0] = 2.0;  // 1200 px/s to the right
  std::vector<TrackedLine> tracked;
  for (int k = 0; k < 3; ++k) tracked.push_back({k, {k * 4.0 / 600.0, -0.1, 0.0}, {k * 4.0 / 600.0, 0.1, 0.0}});
  std::vector<ImageLine> lines;
  ProjectLines(camera, state, tracked, lines);
  TileGrid grid(camera);
  grid.Build(lines, 20.0);
  // 2 ms later the lines are at 2.4, 6.4 and 10.4 px.
  Observation event = ObservationAt(camera, camera.cx_px + 5.0, camera.cy_px, 2e-3, grid);
  ASSERT_EQ(event.num_lines, 3);
  KeepLinesWithin(5.0, lines.data(), event);
  EXPECT_THAT(event.Lines(), ::testing::UnorderedElementsAre(0, 1));
  KeepLinesWithin(2.0, lines.data(), event);
  EXPECT_THAT(event.Lines(), ::testing::ElementsAre(1));
  // The lines end 60 px from their middle. An event 5 px beyond the end is outside a reach of 4.9 px.
  Observation beyond = ObservationAt(camera, camera.cx_px, camera.cy_px + 65.0, 0.0, grid);
  ASSERT_GT(beyond.num_lines, 0);
  KeepLinesWithin(4.9, lines.data(), beyond);
  EXPECT_EQ(beyond.num_lines, 0);
}

}  // namespace
}  // namespace evpose

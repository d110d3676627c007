// SPDX-License-Identifier: Apache-2.0
#include "core/association/association.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "core/association/line_events.h"
#include "core/association/observation_testing.h"
#include "core/association/tracked_ring_testing.h"
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
  Observation event = testing::ObservationAt(camera, {u_px, v_px});
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
    const double u_px = random.Uniform(-20, 660), v_px = random.Uniform(-20, 500);
    const Observation event = ObservationAt(camera, u_px, v_px, random.Uniform(-1e-3, 1e-3), grid);
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

TEST(MoveLines, FollowsASmallMotion) {
  const CameraModel camera = MakeCamera(640, 480, 600.0);
  MotionState state;
  state.camera_from_object = MakePose({0.02, 0.01, 0.7}, {0.5, 0.4, 0.1});
  state.twist << 0.2, 0.1, -0.1, 1.0, 0.5, -1.0;
  std::vector<TrackedLine> tracked = {{0, {-0.05, -0.04, 0.03}, {-0.03, 0.06, -0.02}},
                                      {1, {0.03, 0.05, 0.02}, {0.05, 0.04, 0.02}}};
  tracked[1].is_element = true;
  std::vector<ImageLine> before, moved, exact;
  ProjectLines(camera, state, tracked, before);
  ProjectVelocityJacobians(camera, state, tracked, absl::MakeSpan(before));
  moved = before;
  Vector12d change = Vector12d::Zero();
  change << 4e-4, 5e-4, 1e-4, 1e-3, -1e-3, 1e-3, 0.1, 0.0, 0.05, 0.2, 0.1, 0.3;
  const MotionState next = Plus(state, change);
  MoveLines(change, absl::MakeSpan(moved));
  ProjectLines(camera, next, tracked, exact);
  for (size_t k = 0; k < tracked.size(); ++k) {
    for (const double fraction : {0.0, 0.5, 1.0}) {
      const Eigen::Vector3d bearing = BearingOf(camera, exact[k].PointAt(fraction));
      EXPECT_GT(std::abs(before[k].a.dot(bearing)), 0.2) << "the motion is seen";
      EXPECT_NEAR(moved[k].a.dot(bearing), 0.0, 5e-3);
      EXPECT_NEAR(moved[k].a_dot.dot(bearing), exact[k].a_dot.dot(bearing), 0.01 * exact[k].a_dot.norm());
    }
    EXPECT_EQ(moved[k].p1_px, before[k].p1_px);
  }
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

// A ring about the optical axis. Its elements have the curve number 5 instead of the default 0.
std::vector<TrackedLine> Ring(int count, double radius_m) {
  std::vector<TrackedLine> ring = testing::TrackedRing(count, radius_m);
  for (TrackedLine& line : ring) line.curve = 5;
  return ring;
}

MotionState StateOfRing(double vx_m_per_s) {
  MotionState state;
  state.camera_from_object = MakePose({0.0, 0.0, 1.0}, {0.0, 0.0, 0.0});
  state.twist[0] = vx_m_per_s;
  return state;
}

TEST(Elements, AnEventBelongsToOneElementOfAChain) {
  const CameraModel camera = MakeCamera(640, 480, 600.0);
  const std::vector<TrackedLine> ring = Ring(24, 0.05);  // 30 px, chords of 8 px
  std::vector<ImageLine> lines;
  ProjectLines(camera, StateOfRing(0.0), ring, lines);
  TileGrid grid(camera);
  grid.Build(lines, 12.0);
  Random random(4);
  for (int i = 0; i < 2000; ++i) {
    const double angle = random.Uniform(0.0, 2.0 * M_PI), radius = 30.0 + random.Uniform(-4.0, 4.0);
    Observation event = ObservationAt(camera, camera.cx_px + radius * std::cos(angle),
                                      camera.cy_px + radius * std::sin(angle), 0.0, grid);
    KeepLinesWithin(12.0, lines.data(), event);
    const NearLines near = FindNearLines(event, lines.data(), 6.0, 2.0);
    ASSERT_EQ(near.count, 1) << angle << " " << radius;
    const int expected = static_cast<int>(angle / (2.0 * M_PI) * 24);
    EXPECT_TRUE(near.line[0] == expected ||
                std::abs(angle * 24 / (2.0 * M_PI) - std::round(angle * 24 / (2.0 * M_PI))) < 1e-6);
    const LineEvents sorted({&event, 1}, lines.size());
    int gated = 0;
    for (const LineGroup& group : sorted.groups()) {
      const GroupLine line(group, lines[group.line]);
      const Lanes distance = line.DistancePx(group.events[0]);
      gated += line.IsGated(group.events[0], distance, line.AlongPx(group.events[0]), AllLanes(6.0))[0] != 0;
    }
    // In single precision an event on a border may belong to both elements or none.
    EXPECT_NEAR(gated, 1, std::abs(angle * 24 / (2.0 * M_PI) - std::round(angle * 24 / (2.0 * M_PI))) < 1e-3 ? 1 : 0);
  }
}

TEST(Elements, MoveAlongThemselvesWithinAWindow) {
  const CameraModel camera = MakeCamera(640, 480, 600.0);
  const std::vector<TrackedLine> ring = Ring(24, 0.05);
  std::vector<ImageLine> lines;
  ProjectLines(camera, StateOfRing(1.0), ring, lines);  // 600 px/s to the right
  TileGrid grid(camera);
  grid.Build(lines, 12.0);
  // The middle of the element at the top of the image, where the motion is along the curve, 2 ms later and earlier.
  const int top = 18;
  const Eigen::Vector2d middle = lines[top].PointAt(0.5);
  for (const double tau_s : {-2e-3, 2e-3}) {
    const Observation event = ObservationAt(camera, middle.x() + 600.0 * tau_s, middle.y(), tau_s, grid);
    const NearLines near = FindNearLines(event, lines.data(), 6.0, 0.0);
    ASSERT_EQ(near.count, 1);
    EXPECT_EQ(near.line[0], top);
    EXPECT_NEAR(near.distance_px[0], 0.0, 0.02);
    EXPECT_NEAR(AlongPx(event, lines[top]), 0.5 * lines[top].length_px, 0.02);
  }
}

TEST(Elements, TheEndOfAChainIsAnEnd) {
  const CameraModel camera = MakeCamera(640, 480, 600.0);
  std::vector<TrackedLine> arc = Ring(24, 0.05);
  arc.resize(6);
  arc.front().previous = -1;
  arc.back().next = -1;
  std::vector<ImageLine> lines;
  ProjectLines(camera, StateOfRing(0.0), arc, lines);
  TileGrid grid(camera);
  grid.Build(lines, 12.0);
  const Eigen::Vector2d beyond = lines[5].PointAt(1.0) + 1.5 * lines[5].direction;
  const Observation event = ObservationAt(camera, beyond.x(), beyond.y(), 0.0, grid);
  EXPECT_EQ(FindNearLines(event, lines.data(), 6.0, 2.0).count, 1);
  EXPECT_EQ(FindNearLines(event, lines.data(), 6.0, 1.0).count, 0);
}

TEST(Elements, AFullTileKeepsThoseWithContrast) {
  const CameraModel camera = MakeCamera(640, 480, 600.0);
  // Eight parallel elements, 1 px apart; the two nearest to the middle are faint.
  std::vector<TrackedLine> tracked(8);
  for (int k = 0; k < 8; ++k) {
    const double x = (k - 3.5) / 600.0;
    tracked[k].curve = k;
    tracked[k].p1 = {x, -0.05, 0.0};
    tracked[k].p2 = {x, 0.05, 0.0};
    tracked[k].is_element = true;
    tracked[k].prior_contrast = k == 3 || k == 4 ? 0.1f : 1.0f;
  }
  std::vector<ImageLine> lines;
  ProjectLines(camera, StateOfRing(0.0), tracked, lines);
  TileGrid grid(camera);
  grid.Build(lines, 10.0);
  const Observation event = ObservationAt(camera, camera.cx_px, camera.cy_px, 0.0, grid);
  EXPECT_THAT(event.Lines(), ::testing::UnorderedElementsAre(0, 1, 2, 5, 6, 7));
}

TEST(ForEachCurve, JoinsTheElementsOfACurveOnly) {
  std::vector<TrackedLine> lines(7);
  const std::vector<int> curves = {0, 0, 1, 4, 4, 5, 5};
  for (size_t k = 0; k < lines.size(); ++k) {
    lines[k].curve = curves[k];
    lines[k].is_element = k >= 3;
  }
  std::vector<std::pair<size_t, size_t>> found;
  ForEachCurve(lines, [&](size_t first, size_t end) { found.emplace_back(first, end); });
  const std::vector<std::pair<size_t, size_t>> expected = {{0, 1}, {1, 2}, {2, 3}, {3, 5}, {5, 7}};
  EXPECT_EQ(found, expected);
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/templates/turn_scan.h"

#include <gtest/gtest.h>

#include <memory>
#include <numbers>
#include <optional>
#include <vector>

#include "core/contours/contour_shapes_testing.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/initialization/templates/edge_blobs.h"
#include "core/initialization/templates/event_edges.h"

namespace evpose {
namespace {

using testing::ConstantTwist;
using testing::IdealEventOptions;
using testing::MakePose;
using testing::Motion;

const CameraModel kTurnCamera = testing::MakeCamera(640, 480, 600.0);

// A cylinder with a short painted line along its side, which shows the turn about its axis.
std::shared_ptr<const ObjectModel> MarkedCylinder() {
  ObjectModel model = CylinderModel(0.07, 0.04, 64);
  ModelLine line;
  line.p1 = {0.04, 0.0, -0.02};
  line.p2 = {0.04, 0.0, 0.02};
  line.face_normals.push_back(Eigen::Vector3d::UnitX());
  line.kind = EdgeKind::kPainted;
  model.lines.push_back(line);
  return std::make_shared<const ObjectModel>(std::move(model));
}

// The side of the cylinder at the angle -pi/2 + turn faces the camera.
RigidTransform TurnStart(double turn) {
  constexpr double kHalfPi = 0.5 * std::numbers::pi;
  return {MakePose({0, 0, 0}, {0.3, 0.2, 0.4}).rotation * ExpSo3({1.3, 0.0, 0.0}) * ExpSo3({0.0, 0.0, turn - kHalfPi}),
          {0.02, -0.01, 0.6}};
}

// The turns of the true pose, turned by `turned_by` about the axis, of the cylinder that starts at `start`, and the
// true pose.
struct TurnTrial {
  std::vector<ScannedTurn> turns;
  RigidTransform truth;
};
TurnTrial ScanTurned(const RigidTransform& start, double turned_by) {
  const auto model = MarkedCylinder();
  const TemplateModel views(model);
  Vector6d twist;
  twist << 0.25, 0.12, 0.05, 0.4, -0.3, 0.2;
  const Motion motion = ConstantTwist(start, twist);
  IdealEventOptions options;
  options.duration_us = 20'000;
  options.clutter_per_s = 100'000.0;
  std::vector<PixelEvent> events;
  for (const Event& event : testing::MakeIdealEvents(*model, kTurnCamera, motion, options)) {
    events.push_back({event.t_us, static_cast<float>(event.x), static_cast<float>(event.y), event.polarity});
  }
  EventEdgeDetector detector({}, {640, 480});
  const EventEdges edges = detector.Detect(events);
  const EdgeDistanceMap map(edges.points, FindEdgeBlobs(edges.points, {640, 480}, 1).at(0));
  TurnTrial trial;
  trial.truth = motion(1e-6 * static_cast<double>(edges.t_mid_us()));
  const TurnScanner scanner(views, kTurnCamera, events, edges.t_begin_us, edges.t_end_us);
  trial.turns =
      scanner.Scan(map, trial.truth * RigidTransform{ExpSo3({0.0, 0.0, turned_by}), {0.0, 0.0, 0.0}}, twist, 3);
  return trial;
}

TEST(TurnScanTest, TheTrueTurnIsTheFirstOne) {
  for (const double mark : {-0.6, 0.0, 0.5}) {
    for (const double turned_by : {0.0, 1.0, 3.0}) {
      const TurnTrial trial = ScanTurned(TurnStart(mark), turned_by);
      ASSERT_FALSE(trial.turns.empty()) << mark << " " << turned_by;
      EXPECT_LT(RotationAngle(trial.turns[0].camera_from_object.rotation, trial.truth.rotation), 0.06)
          << mark << " " << turned_by;
      EXPECT_GT(trial.turns[0].sigma, 3.0);
      for (size_t i = 1; i < trial.turns.size(); ++i) {
        EXPECT_LE(trial.turns[i].sigma, trial.turns[i - 1].sigma);
        EXPECT_GT(RotationAngle(trial.turns[i].camera_from_object.rotation, trial.turns[0].camera_from_object.rotation),
                  0.08);
      }
    }
  }
}

TEST(TurnScanTest, AHiddenMarkShowsNoTurn) {
  for (const double turned_by : {0.0, 1.0, 3.0}) {
    for (const ScannedTurn& turn : ScanTurned(TurnStart(std::numbers::pi), turned_by).turns) {
      EXPECT_LT(turn.sigma, 3.0) << turned_by;
    }
  }
}

}  // namespace
}  // namespace evpose

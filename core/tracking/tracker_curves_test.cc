// SPDX-License-Identifier: Apache-2.0

// Tracking of objects with curved edges and contours from a given pose, on ideal events.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "core/association/visible_edges.h"
#include "core/contours/contour_shapes_testing.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/initialization/templates/template_model.h"
#include "core/models/continuous_symmetry.h"
#include "core/tracking/object/pose_track.h"
#include "core/tracking/object/tracker_options.h"
#include "core/tracking/tracker.h"
#include "core/tracking/tracking_testing.h"

namespace evpose {
namespace {

using testing::ConstantTwist;
using testing::IdealEventOptions;
using testing::MakeIdealEvents;
using testing::MakePose;
using testing::Motion;

enum class Shape { kCylinder, kTorus, kCapsule, kSphere, kPlate };

ObjectModel ShapeOf(Shape shape) {
  switch (shape) {
    case Shape::kCylinder:
      return CylinderModel(0.07, 0.04, 64);
    case Shape::kTorus:
      return TorusModel(0.06, 0.025, 96, 48);
    case Shape::kCapsule:
      return CapsuleModel(0.05, 0.04, 96, 48);
    case Shape::kSphere:
      return SphereModel(0.05, 96, true);
    case Shape::kPlate:
      break;
  }
  return PlateWithHoles(0.04, 0.02, 0.005, 64, {-0.09, 0.0, 0.09});
}

// Returns the model with its symmetries, as a model file has them.
std::shared_ptr<const ObjectModel> ModelOf(Shape shape) {
  auto model = std::make_shared<ObjectModel>(ShapeOf(shape));
  model->continuous_symmetry = FindContinuousSymmetry(*model, nullptr);
  if (shape == Shape::kCapsule) {
    model->continuous_symmetry = {ContinuousSymmetry::Kind::kAxis, {0, 0, 0}, {0, 0, 1}, true};
  }
  if (!model->continuous_symmetry) model->symmetries = FindSymmetries(*model);
  return model;
}

struct RoundRun {
  std::vector<PoseEstimate> estimates;
  std::unique_ptr<Tracker> tracker;
};

RoundRun Follow(const std::shared_ptr<const ObjectModel>& model, const std::vector<Event>& events,
                const RigidTransform& start) {
  RoundRun run;
  run.tracker = Tracker::Create(model, kCamera, IdealSensor(), start).value();
  run.tracker->AddEvents(events, run.estimates);
  run.tracker->Finish(run.estimates);
  return run;
}

// Largest errors over the estimates: position relative to the depth, and the angle between the z axes, about which the
// objects are symmetric, rad.
struct RoundErrors {
  double position_of_depth = 0.0;
  double axis_rad = 0.0;
};

RoundErrors ErrorsOf(const std::vector<PoseEstimate>& estimates, const Motion& motion) {
  RoundErrors errors;
  for (const PoseEstimate& estimate : estimates) {
    const RigidTransform truth = motion(estimate.t_us * 1e-6);
    const RigidTransform& pose = estimate.camera_from_object;
    errors.position_of_depth = std::max(errors.position_of_depth,
                                        (pose.translation_m - truth.translation_m).norm() / truth.translation_m.norm());
    errors.axis_rad = std::max(
        errors.axis_rad, Eigen::Vector3d(pose.rotation.col(2)).cross(Eigen::Vector3d(truth.rotation.col(2))).norm());
  }
  return errors;
}

const RigidTransform kRoundStart = MakePose({0.02, -0.01, 0.5}, {1.0, 0.5, 0.2});

class TracksRoundObjects : public ::testing::TestWithParam<Shape> {};

TEST_P(TracksRoundObjects, FromTheTruePose) {
  const auto model = ModelOf(GetParam());
  const Motion motion = ConstantTwist(kRoundStart, Twist(0.25, 0.1, 0.05, 0.8, -0.6, 0.4));
  for (const uint64_t seed : {1u, 2u, 3u}) {
    IdealEventOptions options;
    options.duration_us = 120'000;
    options.seed = seed;
    const std::vector<Event> events = MakeIdealEvents(*model, kCamera, motion, options);
    const RoundRun run = Follow(model, events, kRoundStart);
    EXPECT_EQ(run.tracker->state(), TrackState::kTracking) << seed;
    EXPECT_EQ(run.tracker->losses(), 0u) << seed;
    ASSERT_GT(run.estimates.size(), 50u) << seed;
    const RoundErrors errors = ErrorsOf(run.estimates, motion);
    EXPECT_LT(errors.position_of_depth, 6e-3) << seed;
    if (GetParam() == Shape::kSphere) {
      // No event shows the rotation, which is reported as unknown about every axis.
      const Matrix6d& covariance = run.estimates.back().covariance;
      for (int axis = 3; axis < 6; ++axis) EXPECT_NEAR(covariance(axis, axis), M_PI * M_PI / 3.0, 1e-6) << seed;
    } else {
      EXPECT_LT(errors.axis_rad, 0.02) << seed;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Shapes, TracksRoundObjects,
                         ::testing::Values(Shape::kCylinder, Shape::kTorus, Shape::kCapsule, Shape::kSphere,
                                           Shape::kPlate));

// A cylinder with a painted line, the only part that shows the turn about its axis.
std::shared_ptr<const ObjectModel> MarkedCylinder() {
  auto model = std::make_shared<ObjectModel>(CylinderModel(0.07, 0.04, 64));
  for (const double offset : {-0.01, 0.01}) {
    ModelLine& line = model->lines.emplace_back();
    line.p1 = {std::sqrt(0.04 * 0.04 - offset * offset), offset, -0.06};
    line.p2 = {line.p1.x(), offset, 0.02};  // not symmetric
    line.face_normals.push_back(Eigen::Vector3d(line.p1.x(), offset, 0.0).normalized());
    line.kind = EdgeKind::kPainted;
  }
  return model;
}

TEST(TrackerCurves, TheTurnOfANearlyRoundObjectMustBeSupported) {
  const auto model = MarkedCylinder();
  // The camera sees the painted lines.
  const RigidTransform seen{MakePose({0, 0, 0}, {0.3, 0.2, 0.4}).rotation *
                                MakePose({0, 0, 0}, {1.3, 0.0, 0.0}).rotation *
                                MakePose({0, 0, 0}, {0.0, 0.0, -1.57}).rotation,
                            {0.02, -0.01, 0.5}};
  const Motion motion = ConstantTwist(seen, Twist(0.25, 0.1, 0.05, 0.8, -0.6, 0.4));
  IdealEventOptions options;
  options.duration_us = 120'000;
  const std::vector<Event> events = MakeIdealEvents(*model, kCamera, motion, options);
  for (const double turn : {0.0, 0.6, -0.6}) {
    const RigidTransform turned{seen.rotation * MakePose({0, 0, 0}, {0, 0, turn}).rotation, seen.translation_m};
    const RoundRun run = Follow(model, events, turned);
    size_t num_tracking = 0;
    for (const PoseEstimate& estimate : run.estimates) {
      if (estimate.state != TrackState::kTracking) continue;
      ++num_tracking;
      EXPECT_LT(RotationAngle(estimate.camera_from_object.rotation, motion(estimate.t_us * 1e-6).rotation), 0.05)
          << turn << " " << estimate.t_us;
    }
    if (turn == 0.0) {
      EXPECT_GT(num_tracking, run.estimates.size() * 9 / 10);
    }
  }
}

TEST(TrackerCurves, AFaceThatPassesTheEdgeOnViewKeepsItsInclination) {
  const auto model = ModelOf(Shape::kCylinder);
  // A cap, 0.07 m from the centre, is seen edge-on after 0.06 s and then from its other side.
  const double edge_on_rad = std::asin(0.07 / 0.5);
  for (const double rate : {1.0, -1.0}) {
    const RigidTransform start = MakePose({0.0, 0.0, 0.5}, {M_PI / 2.0 - edge_on_rad - 0.06 * rate, 0.0, 0.0});
    const Motion motion = ConstantTwist(start, Twist(0.15, 0.0, 0.0, rate, 0.0, 0.0));
    for (const uint64_t seed : {1u, 2u, 3u}) {
      IdealEventOptions options;
      options.duration_us = 200'000;
      options.seed = seed;
      const RoundRun run = Follow(model, MakeIdealEvents(*model, kCamera, motion, options), start);
      EXPECT_EQ(run.tracker->losses(), 0u) << rate << ", seed " << seed;
      ASSERT_GT(run.estimates.size(), 100u) << rate << ", seed " << seed;
      std::vector<PoseEstimate> tracking;
      for (const PoseEstimate& estimate : run.estimates) {
        if (estimate.state == TrackState::kTracking) tracking.push_back(estimate);
      }
      EXPECT_GT(tracking.size(), run.estimates.size() * 3 / 4) << rate << ", seed " << seed;
      EXPECT_LT(ErrorsOf(tracking, motion).axis_rad, 0.04) << rate << ", seed " << seed;
      EXPECT_LT(ErrorsOf({run.estimates.back()}, motion).axis_rad, 0.02) << rate << ", seed " << seed;
    }
  }
}

TEST(TrackerCurves, AContourWithoutEventsDoesNotReduceTheSpeed) {
  const auto model = ModelOf(Shape::kTorus);
  const Motion motion = ConstantTwist(kRoundStart, Twist(0.3, 0.1, 0.0, 0.3, 0.2, 0.0));
  IdealEventOptions options;
  options.duration_us = 150'000;
  // The background is as bright as the object on the right of its centre.
  options.is_hidden = [&](const Eigen::Vector2d& pixel, double t_s) {
    return pixel.x() > kCamera.Project(motion(t_s).translation_m).x();
  };
  const std::vector<Event> events = MakeIdealEvents(*model, kCamera, motion, options);
  const RoundRun run = Follow(model, events, kRoundStart);
  EXPECT_EQ(run.tracker->losses(), 0u);
  ASSERT_GT(run.estimates.size(), 50u);
  EXPECT_LT(ErrorsOf(run.estimates, motion).position_of_depth, 0.02);
}

TEST(TrackerCurves, AnObjectThatStopsIsHeld) {
  const auto model = ModelOf(Shape::kCylinder);
  const auto path = [](double t) { return std::min(t, 0.08); };
  const Motion motion = [path](double t) {
    return Perturb(kRoundStart, path(t) * Twist(0.25, 0.1, 0.0, 0.5, 0.3, 0.0));
  };
  IdealEventOptions options;
  options.duration_us = 250'000;
  const RoundRun run = Follow(model, MakeIdealEvents(*model, kCamera, motion, options), kRoundStart);
  EXPECT_EQ(run.tracker->losses(), 0u);
  ASSERT_GT(run.estimates.size(), 50u);
  EXPECT_LT(ErrorsOf(run.estimates, motion).position_of_depth, 0.01);
}

TEST(TrackerCurves, AModelWithoutLinesIsFoundByItsContours) {
  auto model = std::make_shared<ObjectModel>(*ModelOf(Shape::kTorus));
  model->continuous_symmetry = FindContinuousSymmetry(*model, nullptr);
  ASSERT_TRUE(model->continuous_symmetry.has_value());
  const Motion motion = ConstantTwist(kRoundStart, Twist(0.25, 0.1, 0.0, 0.5, 0.0, 0.0));
  IdealEventOptions options;
  options.duration_us = 60'000;
  const std::vector<Event> events = MakeIdealEvents(*model, kCamera, motion, options);
  auto tracker = Tracker::Create(model, kCamera, IdealSensor(), std::nullopt).value();
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(events, estimates);
  EXPECT_EQ(tracker->state(), TrackState::kTracking);
  EXPECT_EQ(tracker->initialization().status, InitializationStatus::kNotNeeded);
  ASSERT_GT(estimates.size(), 10u);
  const std::vector<PoseEstimate> last(estimates.end() - 10, estimates.end());
  EXPECT_LT(ErrorsOf(last, motion).position_of_depth, 0.01);
  EXPECT_LT(ErrorsOf(last, motion).axis_rad, 0.03);
}

TEST(TrackerCurves, AModelNeedsAnEdge) {
  ObjectModel model = *testing::MakeCube(0.1);
  model.lines.clear();
  const auto tracker = Tracker::Create(std::make_shared<const ObjectModel>(model), kCamera, IdealSensor(), kRoundStart);
  EXPECT_EQ(tracker.status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(TrackerCurves, TrackersThatShareTheTablesOfAModelGiveThePosesOfOneThatHasItsOwn) {
  const auto model = ModelOf(Shape::kCylinder);
  IdealEventOptions options;
  options.duration_us = 30'000;
  const std::vector<Event> events =
      MakeIdealEvents(*model, kCamera, ConstantTwist(kRoundStart, Twist(0.25, 0.1, 0.05, 0.8, -0.6, 0.4)), options);
  const RoundRun alone = Follow(model, events, kRoundStart);
  ASSERT_GT(alone.estimates.size(), 3u);
  ObjectToTrack object{model, kRoundStart};
  object.edges = MakeModelEdges(model, IdealSensor().visibility, IdealSensor().elements);
  object.template_model = std::make_shared<const TemplateModel>(model, object.edges->surface());
  const long uses = object.edges->surface().use_count();
  RoundRun first, second;
  for (RoundRun* run : {&first, &second}) run->tracker = Tracker::Create({object}, kCamera, IdealSensor()).value();
  EXPECT_EQ(object.edges->surface().use_count(), uses) << "they have no tables of their own";
  for (const Event& event : events) {
    for (RoundRun* run : {&first, &second}) run->tracker->AddEvents({&event, 1}, run->estimates);
  }
  for (RoundRun* run : {&first, &second}) {
    run->tracker->Finish(run->estimates);
    ASSERT_EQ(run->estimates.size(), alone.estimates.size());
    for (size_t i = 0; i < alone.estimates.size(); ++i) {
      EXPECT_EQ(run->estimates[i].camera_from_object.translation_m,
                alone.estimates[i].camera_from_object.translation_m);
      EXPECT_EQ(run->estimates[i].camera_from_object.rotation, alone.estimates[i].camera_from_object.rotation);
    }
  }
  object.model = ModelOf(Shape::kTorus);
  EXPECT_EQ(Tracker::Create({object}, kCamera, IdealSensor()).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(TrackerCurves, TheCostDependsOnTheImageAndNotOnTheMesh) {
  const Motion motion = ConstantTwist(kRoundStart, Twist(0.25, 0.1, 0.05, 0.8, -0.6, 0.4));
  IdealEventOptions options;
  options.duration_us = 10'000;
  for (const int count : {48, 384}) {
    const auto model = std::make_shared<const ObjectModel>(TorusModel(0.06, 0.025, count, count / 2));
    const TrackerOptions tracker_options = IdealSensor();
    const auto edges = std::make_shared<const ModelEdges>(*model, tracker_options.visibility, tracker_options.elements);
    const TrackContext context{model, kCamera, MakeCameraTables(kCamera).value(), tracker_options, edges};
    PoseTrack track(context, InitialMotionState(kRoundStart, 0, kCamera.fx_px, tracker_options.initial));
    EventWindower windower(tracker_options.windows, {kCamera.width_px, kCamera.height_px});
    size_t most = 0;
    windower.Add(MakeIdealEvents(*model, kCamera, motion, options), [&](const EventWindow& window) {
      track.OnWindow(window);
      most = std::max(most, track.lines().size());
    });
    // The circles of the outline are 36 to 102 px in radius, and an arc turns by at most 25 degrees.
    EXPECT_GT(most, 14u) << count;
    EXPECT_LE(most, 80u) << count;
  }
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// First poses and recovery after a loss, on ideal events and without given poses.
#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <vector>

#include "core/estimation/ideal_events_testing.h"
#include "core/models/symmetry.h"
#include "core/tracking/object/tracker_options.h"
#include "core/tracking/tracker.h"
#include "core/tracking/tracking_testing.h"

namespace evpose {
namespace {

using testing::ConstantTwist;
using testing::IdealEventOptions;
using testing::MakeCamera;
using testing::MakeCube;
using testing::MakeIdealEvents;
using testing::MakePose;
using testing::Motion;

const Vector6d kTwist = Twist(0.3, 0.15, 0.05, 0.5, 0.3, 0.6);

std::unique_ptr<Tracker> MakeTracker(const TrackerOptions& options, std::shared_ptr<const ObjectModel> model = Cube(),
                                     const CameraModel& camera = kCamera) {
  return Tracker::Create(std::move(model), camera, options, std::nullopt).value();
}

ObjectModel LineFigure(const std::vector<Eigen::Vector3d>& corners, bool is_closed) {
  ObjectModel figure;
  for (size_t k = 0; k + (is_closed ? 0 : 1) < corners.size(); ++k) {
    figure.lines.push_back({corners[k], corners[(k + 1) % corners.size()], {}});
  }
  figure.vertices = corners;
  for (const Eigen::Vector3d& corner : corners) figure.diameter_m = std::max(figure.diameter_m, 2.0 * corner.norm());
  return figure;
}

std::vector<Event> CubeEvents(int64_t t_begin_us, int64_t duration_us, const RigidTransform& start = kStart) {
  return EventsOf(*MakeCube(0.15), ConstantTwist(start, kTwist), t_begin_us, duration_us);
}

// 200 ms of the events of a single moving line.
std::vector<Event> EventsOfOneLine() {
  const ObjectModel line = LineFigure({{-0.1, -0.05, 0.0}, {0.1, 0.05, 0.0}}, false);
  const Motion motion = ConstantTwist(MakePose({0.0, 0.0, 0.6}, {0.1, 0.2, 0.3}), Twist(0.1, -0.3, 0, 0, 0, 0));
  return EventsOf(line, motion, 0, 200'000);
}

// Whether a pose is right within 2 deg and 2 % of depth, up to the symmetry.
bool IsRight(const ObjectModel& model, const RigidTransform& truth, const PoseEstimate& estimate) {
  const RigidTransform nearest = NearestEquivalent(truth, model.symmetries, estimate.camera_from_object);
  return RotationAngle(nearest.rotation, estimate.camera_from_object.rotation) < 0.035 &&
         (nearest.translation_m - estimate.camera_from_object.translation_m).norm() < 0.02 * truth.translation_m.z();
}

// Returns the first TRACKING estimate and checks all later ones: they must be right with respect to `motion`, with
// times relative to `t_begin_us`.
int64_t FirstRightUs(const ObjectModel& model, const std::vector<PoseEstimate>& estimates, const Motion& motion,
                     int64_t t_begin_us) {
  int64_t first_us = -1;
  for (const PoseEstimate& estimate : estimates) {
    if (estimate.state != TrackState::kTracking || estimate.t_us < t_begin_us) continue;
    EXPECT_TRUE(IsRight(model, motion((estimate.t_us - t_begin_us) * 1e-6), estimate)) << estimate.t_us;
    if (first_us < 0) first_us = estimate.t_us;
  }
  return first_us;
}

void ExpectSame(const std::vector<PoseEstimate>& a, const std::vector<PoseEstimate>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (size_t k = 0; k < a.size(); ++k) {
    EXPECT_EQ(a[k].t_us, b[k].t_us);
    EXPECT_EQ(a[k].camera_from_object.translation_m, b[k].camera_from_object.translation_m);
    EXPECT_EQ(a[k].camera_from_object.rotation, b[k].camera_from_object.rotation);
    EXPECT_EQ(a[k].covariance, b[k].covariance);
    EXPECT_EQ(a[k].twist, b[k].twist);
    EXPECT_EQ(a[k].state, b[k].state);
  }
}

TEST(TrackerInitialization, FindsTheCubeOnTheBranchNearestToTheReference) {
  const auto cube = Cube();
  ASSERT_EQ(cube->symmetries.size(), 24u);
  const std::vector<Event> events = CubeEvents(0, 60'000);
  for (const Eigen::Vector3d& reference : {Eigen::Vector3d(0.0, 0.0, 0.0), Eigen::Vector3d(0.5, 0.4, 1.9)}) {
    auto tracker = Tracker::Create({{cube, std::nullopt, ExpSo3(reference)}}, kCamera, IdealSensor()).value();
    std::vector<PoseEstimate> estimates;
    tracker->AddEvents(events, estimates);
    EXPECT_EQ(tracker->state(), TrackState::kTracking);
    EXPECT_EQ(tracker->losses(), 0u);
    EXPECT_EQ(tracker->initialization().status, InitializationStatus::kNotNeeded);
    EXPECT_GE(tracker->initialization().attempts, 1u);
    EXPECT_GE(tracker->initialization().num_lines, 7);
    const Motion motion = ConstantTwist(kStart, kTwist);
    const int64_t first_us = FirstRightUs(*cube, estimates, motion, 0);
    EXPECT_GE(first_us, 0);
    EXPECT_LT(first_us, 50'000);
    ASSERT_FALSE(estimates.empty());
    const RigidTransform nearest = NearestEquivalent(motion(estimates.front().t_us * 1e-6), cube->symmetries,
                                                     {ExpSo3(reference), {0.0, 0.0, 0.0}});
    EXPECT_LT(RotationAngle(nearest.rotation, estimates.front().camera_from_object.rotation), 0.035);
  }
}

TEST(TrackerInitialization, IsLostWhenTheObjectVanishesAndTracksWhenItIsBackElsewhere) {
  const auto cube = Cube();
  auto tracker = MakeTracker(IdealSensor(), cube);
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(CubeEvents(0, 100'000), estimates);
  ASSERT_EQ(tracker->state(), TrackState::kTracking);

  // Many unrelated events for 60 ms, and then only noise for a second.
  tracker->AddEvents(Noise(5e6, 100'000, 60'000), estimates);
  EXPECT_EQ(tracker->state(), TrackState::kLost);
  EXPECT_EQ(tracker->initialization().loss_cause, LossCause::kContradicted);
  estimates.clear();
  tracker->AddEvents(Noise(50e3, 160'000, 940'000), estimates);
  EXPECT_EQ(tracker->state(), TrackState::kLost);
  EXPECT_EQ(tracker->losses(), 1u);
  EXPECT_TRUE(estimates.empty());

  const RigidTransform elsewhere = MakePose({-0.06, 0.04, 0.7}, {0.2, -0.7, 0.9});
  tracker->AddEvents(CubeEvents(1'100'000, 150'000, elsewhere), estimates);
  EXPECT_EQ(tracker->state(), TrackState::kTracking);
  const int64_t back_us = FirstRightUs(*cube, estimates, ConstantTwist(elsewhere, kTwist), 1'100'000);
  EXPECT_GE(back_us, 0);
  EXPECT_LT(back_us, 1'200'000);
}

TEST(TrackerInitialization, IsLostWhenTheObjectLeavesAndTracksWhenItIsBack) {
  const auto cube = Cube();
  auto tracker = MakeTracker(IdealSensor(), cube);
  std::vector<PoseEstimate> estimates;
  IdealEventOptions leaving;
  leaving.duration_us = 250'000;
  const Motion away = ConstantTwist(kStart, Twist(3.0, 0.0, 0.0, 0.0, 0.0, 0.0));
  tracker->AddEvents(MakeIdealEvents(*cube, kCamera, away, leaving), estimates);
  EXPECT_EQ(tracker->state(), TrackState::kLost);
  EXPECT_EQ(tracker->initialization().loss_cause, LossCause::kOutOfView);
  EXPECT_GT(tracker->initialization().lost_at_us, 50'000);
  EXPECT_LE(tracker->initialization().lost_at_us, 250'000);
  EXPECT_GE(FirstRightUs(*cube, estimates, away, 0), 0);
  EXPECT_EQ(estimates.back().loss_cause, LossCause::kNone);
  tracker->AddEvents(CubeEvents(1'000'000, 150'000), estimates);
  EXPECT_EQ(estimates.back().loss_cause, LossCause::kOutOfView);
  EXPECT_EQ(estimates.back().lost_at_us, tracker->initialization().lost_at_us);
  const int64_t back_us = FirstRightUs(*cube, estimates, ConstantTwist(kStart, kTwist), 1'000'000);
  EXPECT_GE(back_us, 0);
  EXPECT_LT(back_us, 1'100'000);
}

TEST(TrackerInitialization, WaitsWhileNothingMoves) {
  auto tracker = MakeTracker(IdealSensor());
  EXPECT_EQ(tracker->initialization().status, InitializationStatus::kWaitingForEvents);
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(Noise(500.0, 0, 500'000), estimates);
  EXPECT_EQ(tracker->initialization().status, InitializationStatus::kWaitingForEvents);
  EXPECT_EQ(tracker->initialization().attempts, 0u);

  // A cube that moves by a thirtieth of a pixel in all.
  IdealEventOptions creeping;
  creeping.duration_us = 300'000;
  creeping.events_per_px2 = 100.0;
  creeping.clutter_per_s = 1000.0;
  creeping.t_begin_us = 500'000;
  const Motion creep = ConstantTwist(kStart, Twist(0.0001, 0.00007, 0.0, 0.0, 0.0, 0.00007));
  tracker->AddEvents(MakeIdealEvents(*MakeCube(0.15), kCamera, creep, creeping), estimates);
  EXPECT_GT(tracker->initialization().searches.not_enough_motion, 0u);
  // The noise of the events can look like the motion that a search needs, but the pose is right.
  for (const PoseEstimate& estimate : estimates) {
    EXPECT_LT((estimate.camera_from_object.translation_m - kStart.translation_m).norm(), 0.01) << estimate.t_us;
  }
}

TEST(TrackerInitialization, ReportsTooFewLines) {
  auto tracker = MakeTracker(IdealSensor());
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(EventsOfOneLine(), estimates);
  EXPECT_EQ(tracker->initialization().status, InitializationStatus::kTooFewLines);
  EXPECT_GE(tracker->initialization().num_lines, 1);
  EXPECT_TRUE(estimates.empty());
}

TEST(TrackerInitialization, ReportsThatTheObjectIsTooSmall) {
  auto tracker = MakeTracker(IdealSensor());
  IdealEventOptions options;
  options.duration_us = 300'000;
  options.events_per_px2 = 5.0;
  options.clutter_per_s = 2000.0;
  const RigidTransform far = MakePose({0.1, 0.05, 8.0}, {0.3, 0.2, 0.1});  // about 20 px across
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(
      MakeIdealEvents(*MakeCube(0.15), kCamera, ConstantTwist(far, Twist(1.0, 0.5, 0, 0, 0, 0.5)), options), estimates);
  tracker->Finish(estimates);
  const InitializationReport report = tracker->initialization();
  EXPECT_EQ(report.status, InitializationStatus::kTooSmall);
  EXPECT_GT(report.searches.too_small, report.searches.too_few_lines);
  EXPECT_GT(report.extent_px, 5);
  EXPECT_LT(report.extent_px, 40);
  EXPECT_TRUE(estimates.empty());
}

TEST(TrackerInitialization, NoiseHasNoSignal) {
  auto tracker = MakeTracker(IdealSensor());
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(Noise(20e3, 0, 300'000), estimates);
  tracker->Finish(estimates);
  EXPECT_EQ(tracker->initialization().status, InitializationStatus::kWaitingForEvents);
  EXPECT_GT(tracker->initialization().searches.no_signal, 3u);
}

TEST(TrackerInitialization, ReportsThatTheEventsDoNotSupportAGivenPose) {
  TrackerOptions options = IdealSensor();
  options.initialization.is_automatic = false;
  auto tracker = Tracker::Create(Cube(), kCamera, options, MakePose({0.03, -0.02, 0.6}, {0.1, 0.1, 1.2})).value();
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(CubeEvents(0, 100'000), estimates);
  EXPECT_TRUE(estimates.empty());
  EXPECT_EQ(tracker->initialization().status, InitializationStatus::kNotSupported);
  EXPECT_EQ(tracker->initialization().loss_cause, LossCause::kContradicted);
  EXPECT_GT(tracker->initialization().lost_at_us, 0);
  EXPECT_EQ(tracker->initialization().num_poses, 0);
}

TEST(TrackerInitialization, TheEndOfTheStreamIsTheLossOfAGivenPoseThatIsStillTested) {
  auto tracker = Tracker::Create(Cube(), kCamera, IdealSensor(), kStart).value();
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(CubeEvents(0, 1'500), estimates);
  tracker->Finish(estimates);
  ASSERT_TRUE(estimates.empty());
  EXPECT_EQ(tracker->state(), TrackState::kLost);
  EXPECT_EQ(tracker->initialization().loss_cause, LossCause::kUnconfirmed);
}

// An object at rest at the end must not replace the reason of the searches before.
TEST(TrackerInitialization, TheEndHasTheResultOfMostSearches) {
  auto tracker = MakeTracker(IdealSensor());
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(EventsOfOneLine(), estimates);
  // Longer than InitializationOptions::memory_us.
  tracker->AddEvents(Noise(200.0, 200'000, 1'600'000), estimates);
  EXPECT_EQ(tracker->initialization().status, InitializationStatus::kWaitingForEvents);
  tracker->Finish(estimates);
  EXPECT_EQ(tracker->initialization().status, InitializationStatus::kTooFewLines);
}

TEST(TrackerInitialization, AModelWithoutVisibleEdgesNeedsAGivenPose) {
  // Two arcs that are shorter than a pixel in any image that shows both.
  ObjectModel model;
  for (const double x : {-0.5, 0.5}) {
    EdgeCurve curve;
    curve.points = {{x, 0.0, 0.0}, {x, 0.0002, 0.0}, {x, 0.0003, 0.0002}};
    curve.face_normals.resize(2, {Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()});
    model.vertices.insert(model.vertices.end(), curve.points.begin(), curve.points.end());
    model.curves.push_back(curve);
  }
  model.diameter_m = 1.0;
  auto tracker = MakeTracker(IdealSensor(), std::make_shared<const ObjectModel>(model));
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(Noise(200e3, 0, 20'000), estimates);
  tracker->Finish(estimates);
  EXPECT_EQ(tracker->initialization().status, InitializationStatus::kNotSearchable);
  EXPECT_EQ(tracker->initialization().attempts, 0u);
}

TEST(MostFrequentResult, IsTheOneThatCameNearestToAPoseAmongEqualCounts) {
  EXPECT_EQ(MostFrequentResult({}), InitializationStatus::kWaitingForEvents);
  EXPECT_EQ(MostFrequentResult({.no_signal = 2, .too_small = 3}), InitializationStatus::kTooSmall);
  EXPECT_EQ(MostFrequentResult({.too_few_lines = 2, .no_pose_fits = 2}), InitializationStatus::kNoPoseFits);
  EXPECT_EQ(MostFrequentResult({.not_enough_motion = 4, .poses_found = 2}), InitializationStatus::kNotEnoughMotion);
  EXPECT_EQ(MostFrequentResult({.poses_found = 1}), InitializationStatus::kNotSupported);
}

TEST(TrackerInitialization, LinesOfSomethingElseAreNoPose) {
  auto tracker = MakeTracker(IdealSensor());
  IdealEventOptions options;
  options.duration_us = 1'000'000;
  // A star: no face of a cube has such corners.
  std::vector<Eigen::Vector3d> corners;
  for (int k = 0; k < 12; ++k) {
    const double radius_m = k % 2 == 0 ? 0.13 : 0.05 + 0.005 * k;
    const Eigen::Matrix3d turn = ExpSo3({0.0, 0.0, 6.283185307179586 * k / 12 + 0.1 * (k % 3)});
    corners.push_back(turn * Eigen::Vector3d(radius_m, 0.0, 0.0));
  }
  const Motion motion = ConstantTwist(MakePose({-0.05, 0.0, 0.6}, {0.1, 0.2, 0.3}), Twist(0.1, 0.08, 0, 0, 0, 0.5));
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(MakeIdealEvents(LineFigure(corners, true), kCamera, motion, options), estimates);
  EXPECT_EQ(tracker->initialization().status, InitializationStatus::kNoPoseFits);
  EXPECT_GE(tracker->initialization().num_lines, 6);
  EXPECT_EQ(tracker->state(), TrackState::kInitializing);
  EXPECT_EQ(tracker->losses(), 0u);
  EXPECT_TRUE(estimates.empty());
  // The interval between searches grows to max_no_pose_retry_us.
  EXPECT_GT(tracker->initialization().attempts, 10u);
  EXPECT_LT(tracker->initialization().attempts, 25u);
}

// At a large distance the two tilts of a plate have the same image, also under translation.
TEST(TrackerInitialization, AnAmbiguousPlateIsReportedWithItsAlternatives) {
  const CameraModel far_camera = MakeCamera(640, 480, 120'000.0);
  auto plate = std::make_shared<ObjectModel>(
      LineFigure({{-0.2, -0.12, 0.0}, {0.2, -0.15, 0.0}, {0.13, 0.12, 0.0}, {-0.1, 0.17, 0.0}}, true));
  const Motion motion = ConstantTwist(MakePose({0.0, 0.0, 200.0}, {0.6, 0.3, 0.2}), Twist(0.3, 0.2, 0, 0, 0, 0));
  IdealEventOptions options;
  options.duration_us = 300'000;
  auto tracker = MakeTracker(IdealSensor(), plate, far_camera);
  std::vector<PoseEstimate> estimates;
  bool was_ambiguous = false;
  for (const Event& event : MakeIdealEvents(*plate, far_camera, motion, options)) {
    tracker->AddEvents({event}, estimates);
    const bool is_ambiguous = tracker->initialization().status == InitializationStatus::kAmbiguous;
    was_ambiguous = was_ambiguous || is_ambiguous;
    if (event.t_us < TrackerOptions().initialization.undecided_us) {
      ASSERT_TRUE(estimates.empty() || estimates.back().state != TrackState::kTracking) << event.t_us;
    }
  }
  EXPECT_TRUE(was_ambiguous);
  EXPECT_EQ(tracker->initialization().status, InitializationStatus::kAmbiguous);
  EXPECT_GE(tracker->initialization().num_poses, 2);
  EXPECT_EQ(tracker->state(), TrackState::kAmbiguous);
  ASSERT_FALSE(estimates.empty());
  for (const PoseEstimate& estimate : estimates) {
    ASSERT_EQ(estimate.state, TrackState::kAmbiguous);
    ASSERT_GE(estimate.alternatives.size(), 1u);
    // An alternative that is better by half of decision_sigma is reported itself; one that is worse by decision_sigma
    // is rejected (README, equation (4)).
    for (const PoseAlternative& alternative : estimate.alternatives) {
      EXPECT_GT(alternative.log_likelihood_ratio, -8.0);
      EXPECT_LT(alternative.log_likelihood_ratio, 2.0);
    }
  }
  // The true pose is the reported one or an alternative.
  const PoseEstimate& last = estimates.back();
  const RigidTransform truth = motion(last.t_us * 1e-6);
  const auto is_near = [&](const RigidTransform& pose) { return RotationAngle(pose.rotation, truth.rotation) < 0.1; };
  EXPECT_TRUE(is_near(last.camera_from_object) ||
              std::any_of(last.alternatives.begin(), last.alternatives.end(),
                          [&](const PoseAlternative& each) { return is_near(each.camera_from_object); }));
}

// From nearby, the two tilts look different: one pose leads, and no alternatives are reported.
TEST(TrackerInitialization, AConfirmedPoseHasNoAlternatives) {
  const auto cube = Cube();
  auto tracker = MakeTracker(IdealSensor(), cube);
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(CubeEvents(0, 100'000), estimates);
  ASSERT_FALSE(estimates.empty());
  for (const PoseEstimate& estimate : estimates) EXPECT_TRUE(estimate.alternatives.empty());
}

TEST(TrackerInitialization, DoesNotDependOnTheCutOfCalls) {
  const std::vector<Event> events = CubeEvents(0, 80'000);
  std::vector<PoseEstimate> whole;
  MakeTracker(IdealSensor())->AddEvents(events, whole);
  ASSERT_GT(whole.size(), 20u);
  for (const size_t step : {1u, 13u, 4096u}) {
    auto tracker = MakeTracker(IdealSensor());
    std::vector<PoseEstimate> estimates;
    for (size_t i = 0; i < events.size(); i += step) {
      tracker->AddEvents(absl::MakeConstSpan(events).subspan(i, step), estimates);
    }
    ExpectSame(estimates, whole);
  }
}

TEST(TrackerInitialization, WorksWithoutRepeatedSearches) {
  const auto cube = Cube();
  TrackerOptions options = IdealSensor();
  options.initialization.num_repeats = 0;
  auto tracker = MakeTracker(options, cube);
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(CubeEvents(0, 100'000), estimates);
  EXPECT_EQ(tracker->state(), TrackState::kTracking);
  const int64_t first_us = FirstRightUs(*cube, estimates, ConstantTwist(kStart, kTwist), 0);
  EXPECT_GE(first_us, 0);
  EXPECT_LT(first_us, 50'000);
}

TEST(TrackerInitialization, FindsTheCubeInDenseNoise) {
  const auto cube = Cube();
  IdealEventOptions options;
  options.duration_us = 60'000;
  options.events_per_px2 = 20.0;
  options.clutter_per_s = 3e6;
  const Motion motion = ConstantTwist(kStart, kTwist);
  const std::vector<Event> events = MakeIdealEvents(*cube, kCamera, motion, options);
  auto tracker = MakeTracker(IdealSensor(), cube);
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(events, estimates);
  EXPECT_EQ(tracker->state(), TrackState::kTracking);
  const int64_t first_us = FirstRightUs(*cube, estimates, motion, 0);
  EXPECT_GE(first_us, 0);
  EXPECT_LT(first_us, 50'000);
  EXPECT_LE(tracker->initialization().attempts, 12u);
}

TEST(TrackerInitialization, AGivenPoseEndsTheSearch) {
  auto tracker = MakeTracker(IdealSensor());
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(Noise(200e3, 0, 60'000), estimates);
  EXPECT_EQ(tracker->state(), TrackState::kInitializing);
  const uint64_t attempts = tracker->initialization().attempts;
  EXPECT_GE(attempts, 1u);
  tracker->ResetPose(kStart);
  tracker->AddEvents(CubeEvents(60'000, 60'000), estimates);
  EXPECT_EQ(tracker->state(), TrackState::kTracking);
  EXPECT_EQ(tracker->initialization().attempts, attempts);
  EXPECT_EQ(tracker->losses(), 0u);
  ASSERT_FALSE(estimates.empty());
  const RigidTransform truth = ConstantTwist(kStart, kTwist)((estimates.front().t_us - 60'000) * 1e-6);
  EXPECT_LT(RotationAngle(truth.rotation, estimates.front().camera_from_object.rotation), 0.035);
}

TEST(TrackerInitialization, AWrongPoseGivenDuringTheSearchIsRejectedAndTheSearchContinues) {
  const auto cube = Cube();
  auto tracker = MakeTracker(IdealSensor(), cube);
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(Noise(200e3, 0, 30'000), estimates);
  tracker->ResetPose(MakePose({0.03, -0.02, 0.6}, {0.1, 0.1, 1.2}));
  EXPECT_EQ(tracker->state(), TrackState::kInitializing);
  tracker->AddEvents(CubeEvents(30'000, 150'000), estimates);
  EXPECT_EQ(tracker->losses(), 1u);
  EXPECT_EQ(tracker->state(), TrackState::kTracking);
  const int64_t first_us = FirstRightUs(*cube, estimates, ConstantTwist(kStart, kTwist), 30'000);
  EXPECT_GE(first_us, 0);
  EXPECT_LT(first_us, 130'000);
}

TEST(TrackerInitialization, PosesNeverStepBackInTime) {
  TrackerOptions options = IdealSensor();
  // The memory then contains windows for which poses were published already.
  options.initialization.num_repeats = 100;
  const RigidTransform elsewhere = MakePose({-0.06, 0.04, 0.7}, {0.2, -0.7, 0.9});
  auto tracker = MakeTracker(options);
  std::vector<PoseEstimate> estimates;
  for (int k = 0; k < 6; ++k) {
    tracker->AddEvents(CubeEvents(int64_t{70'000} * k, 70'000, k % 2 == 0 ? kStart : elsewhere), estimates);
  }
  EXPECT_GE(tracker->losses(), 3u);
  ASSERT_GT(estimates.size(), 100u);
  for (size_t k = 1; k < estimates.size(); ++k) EXPECT_LT(estimates[k - 1].t_us, estimates[k].t_us);
}

TEST(TrackerInitialization, AResetBeforeTheFirstEventIsThePoseAtTheFirstEvent) {
  for (const bool is_automatic : {true, false}) {
    TrackerOptions options = IdealSensor();
    options.initialization.is_automatic = is_automatic;
    auto tracker = MakeTracker(options);
    tracker->ResetPose(kStart);
    EXPECT_EQ(tracker->initialization().status, InitializationStatus::kVerifying);
    std::vector<PoseEstimate> estimates;
    tracker->AddEvents(CubeEvents(1'000'000'000, 50'000), estimates);
    EXPECT_EQ(tracker->state(), TrackState::kTracking);
    EXPECT_EQ(tracker->losses(), 0u);
    ASSERT_FALSE(estimates.empty());
    EXPECT_LT(estimates.front().t_us, 1'000'010'000);
  }
}

TEST(TrackerInitialization, AnObjectThatVanishedAtOnceIsFoundElsewhere) {
  const auto cube = Cube();
  auto tracker = MakeTracker(IdealSensor(), cube);
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(CubeEvents(0, 100'000), estimates);
  ASSERT_EQ(tracker->state(), TrackState::kTracking);
  // It cannot be distinguished from an object at rest.
  tracker->AddEvents(Noise(50e3, 100'000, 1'000'000), estimates);
  EXPECT_NE(tracker->state(), TrackState::kTracking);
  estimates.clear();
  const RigidTransform elsewhere = MakePose({-0.06, 0.04, 0.7}, {0.2, -0.7, 0.9});
  tracker->AddEvents(CubeEvents(1'100'000, 150'000, elsewhere), estimates);
  EXPECT_EQ(tracker->state(), TrackState::kTracking);
  EXPECT_EQ(tracker->losses(), 1u);
  const int64_t back_us = FirstRightUs(*cube, estimates, ConstantTwist(elsewhere, kTwist), 1'100'000);
  EXPECT_GE(back_us, 0);
  EXPECT_LT(back_us, 1'200'000);
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// Competing poses, on ideal events of a cube.
#include "core/tracking/object/hypotheses.h"

#include <gtest/gtest.h>

#include <string>
#include <utility>

#include "absl/functional/function_ref.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/tracking/tracking_testing.h"

namespace evpose {
namespace {

using testing::ConstantTwist;
using testing::IdealEventOptions;
using testing::MakeIdealEvents;
using testing::MakePose;

Vector6d SomeTwist() {
  Vector6d twist;
  twist << 0.3, 0.2, 0.0, 0.5, 0.5, 0.5;
  return twist;
}

TrackContext MakeContext() {
  const TrackerOptions options = IdealSensor();
  const auto model = Cube();
  auto edges = std::make_shared<const ModelEdges>(*model, options.visibility, options.elements);
  return {model, kCamera, MakeCameraTables(kCamera).value(), options, std::move(edges)};
}

MotionState Start(const TrackContext& context, const RigidTransform& pose) {
  MotionState state = InitialMotionState(pose, 0, kCamera.fx_px, context.options.initial);
  state.twist = SomeTwist();
  return state;
}

// Processes the events of the cube that starts at kStart with the hypotheses, and calls `after_window` after each
// window.
std::optional<PoseEstimate> FollowCube(
    const TrackContext& context, Hypotheses& hypotheses, int64_t duration_us,
    absl::FunctionRef<void()> after_window = [] {}) {
  IdealEventOptions options;
  options.duration_us = duration_us;
  const std::vector<Event> events =
      MakeIdealEvents(*context.model, kCamera, ConstantTwist(kStart, SomeTwist()), options);
  EventWindower windower(context.options.windows, {kCamera.width_px, kCamera.height_px});
  std::optional<PoseEstimate> last;
  windower.Add(events, [&](const EventWindow& window) {
    hypotheses.OnWindow(window);
    last = hypotheses.empty() ? std::nullopt : hypotheses.estimate();
    after_window();
  });
  return last;
}

double Angle(const PoseTrack& track, int64_t t_us) {
  return RotationAngle(track.motion().camera_from_object.rotation,
                       ConstantTwist(kStart, SomeTwist())(static_cast<double>(t_us) * 1e-6).rotation);
}

TEST(Hypotheses, ASingleHypothesisEqualsATrack) {
  const TrackContext context = MakeContext();
  Hypotheses hypotheses(context);
  hypotheses.Add(Start(context, kStart));
  const std::optional<PoseEstimate> estimate = FollowCube(context, hypotheses, 20'000);
  ASSERT_TRUE(estimate.has_value());
  EXPECT_EQ(estimate->state, TrackState::kTracking);
  EXPECT_EQ(hypotheses.size(), 1u);
}

TEST(Hypotheses, TheRightOneIsKeptInEitherOrder) {
  // A slightly rotated cube: many of its lines still have events, as at a local optimum.
  const RigidTransform wrong = MakePose({0.02, -0.01, 0.62}, {0.75, 0.5, 0.2});
  for (const bool right_first : {true, false}) {
    const TrackContext context = MakeContext();
    Hypotheses hypotheses(context);
    hypotheses.Add(Start(context, right_first ? kStart : wrong));
    hypotheses.Add(Start(context, right_first ? wrong : kStart));
    const std::optional<PoseEstimate> estimate = FollowCube(context, hypotheses, 30'000);
    ASSERT_TRUE(estimate.has_value()) << right_first;
    EXPECT_EQ(hypotheses.size(), 1u) << right_first;
    EXPECT_LT(Angle(hypotheses.first(), estimate->t_us), 0.01) << right_first;
  }
}

TEST(Hypotheses, EqualHypothesesAreMerged) {
  const TrackContext context = MakeContext();
  Hypotheses hypotheses(context);
  hypotheses.Add(Start(context, kStart));
  hypotheses.Add(Start(context, kStart));
  // A cube rotated by a quarter turn is the same pose by symmetry.
  hypotheses.Add(Start(context, kStart * RigidTransform{ExpSo3({0.0, 0.0, 1.5707963267948966}), {0.0, 0.0, 0.0}}));
  FollowCube(context, hypotheses, 3'000);
  EXPECT_EQ(hypotheses.size(), 1u);
}

TEST(PoseAlternatives, KeepsTheMostLikelyOnesInOrder) {
  PoseAlternatives alternatives;
  EXPECT_TRUE(alternatives.empty());
  for (const double ratio : {-3.0, -1.0, -5.0, -1.0, 0.5, -6.0}) {
    alternatives.Add({MakePose({ratio, static_cast<double>(alternatives.size()), 1.0}, {0.0, 0.0, 0.0}), ratio});
  }
  ASSERT_EQ(alternatives.size(), PoseAlternatives::kMaxSize);
  const double expected[] = {0.5, -1.0, -1.0, -3.0};
  for (size_t i = 0; i < 4; ++i) {
    EXPECT_EQ(alternatives[i].log_likelihood_ratio, expected[i]);
    EXPECT_EQ(alternatives[i].camera_from_object.translation_m.x(), expected[i]);
  }
  // Among equally likely ones the earlier one comes first.
  EXPECT_LT(alternatives[1].camera_from_object.translation_m.y(), alternatives[2].camera_from_object.translation_m.y());

  StateWriter writer;
  writer(alternatives);
  const std::string bytes = writer.Take();
  PoseAlternatives loaded;
  StateReader reader(bytes);
  reader(loaded);
  ASSERT_TRUE(reader.Finish().ok());
  StateWriter again;
  again(loaded);
  EXPECT_EQ(again.Take(), bytes);
  std::string damaged = bytes;
  damaged[0] = 5;
  StateReader damaged_reader(damaged);
  damaged_reader(loaded);
  EXPECT_FALSE(damaged_reader.ok());
}

TEST(Hypotheses, AlternativesHaveTheirLikelihoodRelativeToTheFirstOne) {
  const RigidTransform wrong = MakePose({0.02, -0.01, 0.62}, {0.75, 0.5, 0.2});
  double ratio[2] = {};
  for (const bool right_first : {true, false}) {
    TrackContext context = MakeContext();
    // Without decisions and merges, so that both poses are left.
    context.options.initialization.decision_sigma = 1e6;
    context.options.initialization.merge_rad = 0.0;
    Hypotheses hypotheses(context);
    hypotheses.Add(Start(context, right_first ? kStart : wrong));
    EXPECT_TRUE(hypotheses.Alternatives().empty());
    hypotheses.Add(Start(context, right_first ? wrong : kStart));
    ASSERT_EQ(hypotheses.Alternatives().size(), 1u);
    EXPECT_EQ(hypotheses.Alternatives()[0].log_likelihood_ratio, 0.0) << "without a comparison";
    FollowCube(context, hypotheses, 1'500);
    ASSERT_EQ(hypotheses.size(), 2u);
    ratio[right_first] = hypotheses.Alternatives()[0].log_likelihood_ratio;
  }
  EXPECT_LT(ratio[1], 0.0);
  EXPECT_EQ(ratio[0], -ratio[1]);
}

TEST(Hypotheses, ARivalIsNoAlternativeBeforeItIsCompared) {
  TrackContext context = MakeContext();
  context.options.initialization.decision_sigma = 1e6;
  context.options.initialization.merge_rad = 0.0;
  Hypotheses hypotheses(context);
  EXPECT_EQ(hypotheses.NumCompared(), 0u);
  hypotheses.Add(Start(context, kStart));
  hypotheses.Add(Start(context, kStart));
  hypotheses.AddRival(Start(context, MakePose({0.02, -0.01, 0.6}, {0.5, 0.5, 0.2})),
                      Hypotheses::RivalKind::kOtherEdges);
  int num_windows = 0;
  FollowCube(context, hypotheses, 20'000, [&] {
    ++num_windows;
    ASSERT_EQ(hypotheses.size(), 3u) << num_windows;
    // It is refined in its first eight windows; the ninth is the first one of its comparison.
    const size_t num_rivals = num_windows > ComparisonProgress::kSettlingWindows ? 1 : 0;
    EXPECT_EQ(hypotheses.Alternatives().size(), 1 + num_rivals) << num_windows;
    EXPECT_EQ(hypotheses.NumCompared(), 2 + num_rivals) << num_windows;
  });
  EXPECT_GT(num_windows, ComparisonProgress::kSettlingWindows + 2);
}

TEST(Hypotheses, UnsupportedPosesAreRemoved) {
  const TrackContext context = MakeContext();
  Hypotheses hypotheses(context);
  hypotheses.Add(Start(context, MakePose({0.15, 0.1, 0.6}, {0.1, 1.2, 0.3})));
  hypotheses.Add(Start(context, MakePose({-0.14, 0.1, 0.7}, {1.1, 0.2, 0.3})));
  EXPECT_FALSE(FollowCube(context, hypotheses, 60'000).has_value());
  EXPECT_TRUE(hypotheses.empty());
}

TEST(Hypotheses, AWrongRivalIsRejectedAndChangesNothing) {
  const TrackContext context = MakeContext();
  Hypotheses alone(context), hypotheses(context);
  for (Hypotheses* each : {&alone, &hypotheses}) each->Add(Start(context, kStart));
  hypotheses.AddRival(Start(context, MakePose({0.02, -0.01, 0.62}, {0.75, 0.5, 0.2})),
                      Hypotheses::RivalKind::kOtherEdges);
  EXPECT_TRUE(hypotheses.HasRival());
  EXPECT_FALSE(hypotheses.IsUndecided());
  FollowCube(context, alone, 40'000);
  FollowCube(context, hypotheses, 40'000);
  ASSERT_EQ(hypotheses.size(), 1u);
  EXPECT_FALSE(hypotheses.HasRival());
  EXPECT_EQ(hypotheses.first().motion().camera_from_object, alone.first().motion().camera_from_object);
}

TEST(Hypotheses, ARivalTakesThePlaceOfAWrongPose) {
  const TrackContext context = MakeContext();
  Hypotheses hypotheses(context);
  hypotheses.Add(Start(context, MakePose({0.02, -0.01, 0.62}, {0.75, 0.5, 0.2})));
  hypotheses.AddRival(Start(context, kStart), Hypotheses::RivalKind::kOtherEdges);
  const std::optional<PoseEstimate> estimate = FollowCube(context, hypotheses, 40'000);
  ASSERT_EQ(hypotheses.size(), 1u);
  ASSERT_TRUE(estimate.has_value());
  EXPECT_FALSE(hypotheses.HasRival());
  EXPECT_LT(Angle(hypotheses.first(), estimate->t_us), 0.01);
}

TEST(Hypotheses, ARivalIsRefinedBeforeItIsMerged) {
  const TrackContext context = MakeContext();
  for (const int64_t duration_us : {4'000, 30'000}) {
    Hypotheses hypotheses(context);
    hypotheses.Add(Start(context, kStart));
    hypotheses.AddRival(Start(context, kStart), Hypotheses::RivalKind::kSameEdges);
    FollowCube(context, hypotheses, duration_us);
    EXPECT_EQ(hypotheses.size(), duration_us < 5'000 ? 2u : 1u) << duration_us;
  }
}

TEST(Hypotheses, ATiltedRivalIsRemovedOnceItHasConverged) {
  const TrackContext context = MakeContext();
  Hypotheses alone(context), hypotheses(context);
  for (Hypotheses* each : {&alone, &hypotheses}) each->Add(Start(context, kStart));
  hypotheses.AddRival(Start(context, kStart), Hypotheses::RivalKind::kTilted);
  // Any other rival is followed for 10 ms.
  FollowCube(context, alone, 6'000);
  FollowCube(context, hypotheses, 6'000);
  ASSERT_EQ(hypotheses.size(), 1u);
  EXPECT_FALSE(hypotheses.is_first_tilted());
  EXPECT_EQ(hypotheses.first().motion().camera_from_object, alone.first().motion().camera_from_object);
}

TEST(Hypotheses, TiltedRivalsAloneAreRemovedTogether) {
  const TrackContext context = MakeContext();
  Hypotheses hypotheses(context);
  hypotheses.Add(Start(context, kStart));
  for (const auto kind :
       {Hypotheses::RivalKind::kTilted, Hypotheses::RivalKind::kOtherEdges, Hypotheses::RivalKind::kTilted}) {
    hypotheses.AddRival(Start(context, MakePose({0.02, -0.01, 0.6}, {0.2, 0.1, 0.2})), kind);
  }
  ASSERT_EQ(hypotheses.size(), 4u);
  hypotheses.RemoveTilted();
  EXPECT_EQ(hypotheses.size(), 2u);
  EXPECT_TRUE(hypotheses.HasRival());
  EXPECT_EQ(hypotheses.first().motion().camera_from_object, kStart);
}

TEST(Hypotheses, ATiltedRivalThatTakesThePlaceOfAWrongPoseHasTheSameGeneratedRivals) {
  const TrackContext context = MakeContext();
  Hypotheses hypotheses(context);
  hypotheses.Add(Start(context, MakePose({0.02, -0.01, 0.6}, {0.2, 0.1, 0.2})));
  hypotheses.AddRival(Start(context, kStart), Hypotheses::RivalKind::kTilted);
  ASSERT_FALSE(hypotheses.is_first_tilted());
  FollowCube(context, hypotheses, 40'000);
  ASSERT_EQ(hypotheses.size(), 1u);
  ASSERT_TRUE(hypotheses.is_first_tilted());
  EXPECT_TRUE(hypotheses.are_rivals_generated());
  EXPECT_LT(Angle(hypotheses.first(), 40'000), 0.01);
  StateWriter writer;
  hypotheses.SaveState(writer);
  const std::string state = writer.Take();
  Hypotheses loaded(context);
  StateReader reader(state);
  loaded.LoadState(reader);
  ASSERT_TRUE(reader.Finish().ok());
  EXPECT_TRUE(loaded.is_first_tilted());
}

TEST(Hypotheses, RivalsAreSavedWithTheirCounts) {
  const TrackContext context = MakeContext();
  Hypotheses hypotheses(context), loaded(context);
  hypotheses.Add(Start(context, kStart));
  hypotheses.AddRival(Start(context, MakePose({0.02, -0.01, 0.62}, {0.75, 0.5, 0.2})),
                      Hypotheses::RivalKind::kOtherEdges);
  StateWriter writer;
  hypotheses.SaveState(writer);
  const std::string state = writer.Take();
  StateReader reader(state);
  loaded.LoadState(reader);
  ASSERT_TRUE(reader.Finish().ok());
  EXPECT_TRUE(loaded.HasRival());
  FollowCube(context, hypotheses, 20'000);
  FollowCube(context, loaded, 20'000);
  EXPECT_EQ(loaded.size(), hypotheses.size());
  EXPECT_EQ(loaded.first().motion().camera_from_object, hypotheses.first().motion().camera_from_object);
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// Tests with two poses whose images differ by about one pixel: a card shows two rectangles whose centres differ
// slightly, and the second pose is turned by half a turn.
#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "core/contours/contour_shapes_testing.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/tracking/object/hypotheses.h"
#include "core/tracking/tracker.h"
#include "core/tracking/tracking_testing.h"

namespace evpose {
namespace {

using Eigen::Vector3d;
using testing::ConstantTwist;
using testing::IdealEventOptions;
using testing::MakeIdealEvents;
using testing::MakePose;

const Vector6d kCardTwist = Twist(0.2, 0.25, 0.05, 0.3, 0.3, 0.4);

// The middles of both frames are `offset_m` apart; 1 mm is about 1 px.
std::shared_ptr<const ObjectModel> Card(double offset_m) {
  auto card = std::make_shared<ObjectModel>();
  const auto add_frame = [&card](double half_width_m, double half_height_m, double middle_m) {
    const Vector3d corners[] = {{-half_width_m, middle_m - half_height_m, 0.0},
                                {half_width_m, middle_m - half_height_m, 0.0},
                                {half_width_m, middle_m + half_height_m, 0.0},
                                {-half_width_m, middle_m + half_height_m, 0.0}};
    for (int i = 0; i < 4; ++i) {
      card->vertices.push_back(corners[i]);
      card->lines.push_back({corners[i], corners[(i + 1) % 4], {{0.0, 0.0, -1.0}}, EdgeKind::kPainted});
    }
  };
  add_frame(0.1, 0.06, 0.0);
  add_frame(0.06, 0.03, offset_m);
  card->diameter_m = 0.24;
  return card;
}

const RigidTransform kHalfTurn = MakePose({0.0, 0.0, 0.0}, {0.0, 0.0, std::numbers::pi});

std::vector<Event> CardEvents(const ObjectModel& card, int64_t duration_us) {
  IdealEventOptions options;
  options.duration_us = duration_us;
  return MakeIdealEvents(card, kCamera, ConstantTwist(kStart, kCardTwist), options);
}

class HalfTurnsTest : public ::testing::Test {
 protected:
  HalfTurnsTest() {
    auto edges = std::make_shared<const ModelEdges>(*card_, options_.visibility, options_.elements);
    context_ = std::make_unique<TrackContext>(
        TrackContext{card_, kCamera, MakeCameraTables(kCamera).value(), options_, std::move(edges)});
  }

  MotionState StateOf(const RigidTransform& pose) const {
    MotionState state = InitialMotionState(pose, 0, kCamera.fx_px, options_.initial);
    state.twist = kCardTwist;
    return state;
  }
  // Follows the hypotheses until one is left; returns that time, or the end.
  int64_t UntilOneIsLeftUs(Hypotheses& hypotheses, int64_t duration_us) const {
    EventWindower windower(options_.windows, {kCamera.width_px, kCamera.height_px});
    int64_t end_us = duration_us;
    windower.Add(CardEvents(*card_, duration_us), [&](const EventWindow& window) {
      if (hypotheses.size() < 2) return;
      hypotheses.OnWindow(window);
      if (hypotheses.size() < 2) end_us = window.t_end_us;
    });
    return end_us;
  }
  static bool IsTurned(const RigidTransform& pose, double t_s) {
    return RotationAngle(pose.rotation, ConstantTwist(kStart, kCardTwist)(t_s).rotation) > 1.0;
  }

  const TrackerOptions options_ = IdealSensor();
  const std::shared_ptr<const ObjectModel> card_ = Card(0.002);
  std::unique_ptr<TrackContext> context_;
};

TEST_F(HalfTurnsTest, TheRightHalfTurnWinsWithinAFewWindows) {
  for (const bool right_first : {true, false}) {
    Hypotheses hypotheses(*context_);
    hypotheses.Add(StateOf(right_first ? kStart : kStart * kHalfTurn));
    hypotheses.Add(StateOf(right_first ? kStart * kHalfTurn : kStart));
    const int64_t end_us = UntilOneIsLeftUs(hypotheses, 60'000);
    ASSERT_EQ(hypotheses.size(), 1u) << right_first;
    EXPECT_LT(end_us, 25'000);
    EXPECT_FALSE(IsTurned(hypotheses.first().motion().camera_from_object, static_cast<double>(end_us) * 1e-6));
    EXPECT_TRUE(hypotheses.HasRejected(hypotheses.first().motion().camera_from_object * kHalfTurn));
    EXPECT_FALSE(hypotheses.HasRejected(hypotheses.first().motion().camera_from_object));
  }
}

TEST_F(HalfTurnsTest, APoseThatIsFollowedOrRejectedDoesNotJoinAgain) {
  Hypotheses hypotheses(*context_);
  hypotheses.Add(StateOf(kStart));
  hypotheses.Add(StateOf(kStart * kHalfTurn));
  const int64_t end_us = UntilOneIsLeftUs(hypotheses, 60'000);
  const RigidTransform pose = hypotheses.first().motion().camera_from_object;
  const auto joins = [&](const RigidTransform& other) {
    Hypotheses found(*context_);
    found.Add(InitialMotionState(other, end_us, kCamera.fx_px, options_.initial));
    hypotheses.Join(std::move(found));
    return hypotheses.size() == 2;
  };
  EXPECT_FALSE(joins(pose));
  EXPECT_FALSE(joins(pose * kHalfTurn));
  // Saved and loaded, it is known all the same.
  StateWriter writer;
  hypotheses.SaveState(writer);
  const std::string state = writer.Take();
  StateReader reader(state);
  hypotheses.LoadState(reader);
  ASSERT_TRUE(reader.Finish().ok());
  EXPECT_FALSE(joins(pose * kHalfTurn));
  EXPECT_TRUE(joins(pose * MakePose({0.0, 0.02, 0.0}, {0.0, 0.0, 0.0})));
}

TEST_F(HalfTurnsTest, AnUnlikelyRivalIsUndecidedOnlyIfTheEventsPreferIt) {
  TrackerOptions undecided = options_;
  undecided.initialization.decision_sigma = 1e6;
  const TrackContext context{card_, kCamera, context_->tables, undecided, context_->edges};
  for (const auto prior : {RivalPrior::kEqual, RivalPrior::kUnlikely}) {
    Hypotheses hypotheses(context);
    hypotheses.Add(StateOf(kStart));
    hypotheses.AddRival(StateOf(kStart * kHalfTurn), Hypotheses::RivalKind::kOtherEdges, prior);
    UntilOneIsLeftUs(hypotheses, 40'000);
    ASSERT_EQ(hypotheses.size(), 2u);
    EXPECT_EQ(hypotheses.IsUndecided(), prior == RivalPrior::kEqual);
  }
}

TEST_F(HalfTurnsTest, AContourBesideItsPlaceIsNoEvidenceForThePoseWithoutIt) {
  // A frame that looks the same after half a turn about its middle, and a torus at one of its ends, whose tube is 2 mm
  // (2 px) thicker in the model. The lines of the frame, which both poses share, fit within half a pixel.
  constexpr double kMiddleM = 0.06;
  const auto framed_torus = [](double tube_m) {
    auto model = std::make_shared<ObjectModel>(TorusModel(0.03, tube_m, 96, 48));
    const Vector3d corners[] = {{-0.1, kMiddleM - 0.13, 0.0},
                                {0.1, kMiddleM - 0.13, 0.0},
                                {0.1, kMiddleM + 0.13, 0.0},
                                {-0.1, kMiddleM + 0.13, 0.0}};
    for (int i = 0; i < 4; ++i) {
      model->lines.push_back({corners[i], corners[(i + 1) % 4], {{0.0, 0.0, -1.0}}, EdgeKind::kPainted});
    }
    return std::shared_ptr<const ObjectModel>(model);
  };
  const auto model = framed_torus(0.014);
  TrackerOptions undecided = options_;
  undecided.initialization.decision_sigma = 1e6;
  const auto edges = std::make_shared<const ModelEdges>(*model, options_.visibility, options_.elements);
  const TrackContext context{model, kCamera, context_->tables, undecided, edges};
  const RigidTransform turn = MakePose({0.0, 2.0 * kMiddleM, 0.0}, {0.0, 0.0, std::numbers::pi});
  Hypotheses hypotheses(context);
  hypotheses.Add(StateOf(kStart));
  hypotheses.Add(StateOf(kStart * turn));
  EventWindower windower(options_.windows, {kCamera.width_px, kCamera.height_px});
  windower.Add(CardEvents(*framed_torus(0.012), 40'000),
               [&](const EventWindow& window) { hypotheses.OnWindow(window); });
  ASSERT_EQ(hypotheses.size(), 2u);
  EXPECT_FALSE(IsTurned(hypotheses.first().motion().camera_from_object, 0.04));
  EXPECT_LT(hypotheses.Alternatives()[0].log_likelihood_ratio, 0.0);
}

// A frame that equals itself after half a turn, but for a mark of 1 % of its length. The mark has no events in the
// light that falls on it, and a shade has events where the turned pose expects the mark: the model is wrong in both.
TEST_F(HalfTurnsTest, AnErrorOfTheModelDoesNotDecide) {
  const auto frame_with_mark = [](double sign) {
    const auto frame = std::make_shared<ObjectModel>(*Card(0.0));
    const Vector3d begin(sign * 0.04, sign * 0.01, 0.0), end(sign * 0.04, sign * 0.02, 0.0);
    frame->lines.push_back({begin, end, {{0.0, 0.0, -1.0}}, EdgeKind::kCrease});
    for (ModelLine& line : frame->lines) line.kind = EdgeKind::kCrease;
    return frame;
  };
  const std::shared_ptr<const ObjectModel> model = frame_with_mark(1.0);
  const auto edges = std::make_shared<const ModelEdges>(*model, options_.visibility, options_.elements);
  for (const bool is_exact : {true, false}) {
    TrackerOptions options = options_;
    if (is_exact) options.initialization.model_error_ratio = 0.0;
    const TrackContext context{model, kCamera, context_->tables, options, edges};
    Hypotheses hypotheses(context);
    hypotheses.Add(StateOf(kStart));
    hypotheses.Add(StateOf(kStart * kHalfTurn));
    EventWindower windower(options.windows, {kCamera.width_px, kCamera.height_px});
    windower.Add(CardEvents(*frame_with_mark(-1.0), 200'000),
                 [&](const EventWindow& window) { hypotheses.OnWindow(window); });
    ASSERT_EQ(hypotheses.size(), is_exact ? 1u : 2u);
    EXPECT_EQ(IsTurned(hypotheses.first().motion().camera_from_object, 0.2), is_exact);
  }
}

// States and poses of a tracker.
struct CardRun {
  int turned_tracking = 0, tracking = 0, ambiguous = 0;
  bool ends_right = false;
};

CardRun Track(const std::shared_ptr<const ObjectModel>& card, const std::optional<RigidTransform>& given) {
  auto tracker = Tracker::Create(card, kCamera, IdealSensor(), given).value();
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(CardEvents(*card, 150'000), estimates);
  CardRun run;
  for (const PoseEstimate& estimate : estimates) {
    const RigidTransform truth = ConstantTwist(kStart, kCardTwist)(static_cast<double>(estimate.t_us) * 1e-6);
    const bool is_turned = RotationAngle(estimate.camera_from_object.rotation, truth.rotation) > 0.1;
    run.tracking += estimate.state == TrackState::kTracking ? 1 : 0;
    run.ambiguous += estimate.state == TrackState::kAmbiguous ? 1 : 0;
    run.turned_tracking += is_turned && estimate.state == TrackState::kTracking ? 1 : 0;
    run.ends_right = !is_turned;
  }
  return run;
}

TEST(HalfTurnsTrackerTest, AFoundPoseIsTrackedOnlyOnceItsHalfTurnIsRejected) {
  const CardRun run = Track(Card(0.002), std::nullopt);
  EXPECT_EQ(run.turned_tracking, 0);
  EXPECT_GT(run.tracking, 50);
  EXPECT_TRUE(run.ends_right);
}

TEST(HalfTurnsTrackerTest, AGivenPoseExcludesItsHalfTurnUntilTheEventsContradict) {
  const CardRun right = Track(Card(0.0005), kStart);
  EXPECT_EQ(right.turned_tracking, 0);
  EXPECT_EQ(right.ambiguous, 0);
  EXPECT_GT(right.tracking, 100);
  EXPECT_TRUE(Track(Card(0.002), kStart * kHalfTurn).ends_right);
}

}  // namespace
}  // namespace evpose

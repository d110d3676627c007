#include "core/tracking/line_clutter.h"

#include <gtest/gtest.h>

#include "core/base/random.h"
#include "core/tracking/ideal_events.h"
#include "core/tracking/mixture.h"

namespace evpose {
namespace {

using testing::MakeCamera;
using testing::MakePose;

const MixtureDensity kDensity = {0.5, 0.2, 6.0};

// Two vertical lines of the model, of these numbers, that move sideways.
class LineClutterTest : public ::testing::Test {
 protected:
  LineClutterTest() { Move(0.5); }
  void Move(double speed_m_per_s) {
    MotionState state;
    state.camera_from_object = MakePose({0.0, 0.0, 1.0}, {0.0, 0.0, 0.0});
    state.twist[0] = speed_m_per_s;
    ProjectLines(camera_, state, tracked_, lines_);
  }
  void Learn(const std::vector<LineCounts>& counts) { clutter_.Learn(tracked_, lines_, counts, kDensity.gate_px); }
  std::vector<SideDensities> Densities() const {
    std::vector<SideDensities> densities;
    clutter_.Densities(tracked_, lines_, kDensity, densities);
    return densities;
  }

  const CameraModel camera_ = MakeCamera(1280, 720, 1000.0);
  const std::vector<TrackedLine> tracked_ = {{3, {0.0, -0.05, 0.0}, {0.0, 0.05, 0.0}},
                                             {1, {0.1, -0.05, 0.0}, {0.1, 0.05, 0.0}}};
  std::vector<ImageLine> lines_;
  LineClutter clutter_{camera_};
  // As of a line that nothing is known of.
  const SideDensities shared_ = {kDensity.Outlier(), kDensity.Outlier()};
};

TEST_F(LineClutterTest, EachSideOfEachLineHasItsOwn) {
  EXPECT_EQ(Densities(), (std::vector<SideDensities>{shared_, shared_}));
  // 80 events of its own, and 4 in each pixel on one side: gates of 6 px leave strips of 2.
  for (int i = 0; i < 50; ++i) Learn({{80.0, {8.0, 0.0}}, {80.0, {0.0, 0.0}}});
  const std::vector<SideDensities> densities = Densities();
  const double expected = (1.0 - kDensity.outlier_ratio) * 4.0 / 80.0;
  EXPECT_NEAR(densities[0][0], expected, 0.1 * expected);
  EXPECT_EQ(densities[0][1], kDensity.Outlier());
  EXPECT_EQ(densities[1], shared_);
}

TEST_F(LineClutterTest, IsForgottenAfterAsManyEventsWithoutIt) {
  for (int i = 0; i < 50; ++i) Learn({{80.0, {8.0, 0.0}}, {80.0, {0.0, 8.0}}});
  for (int i = 0; i < 20; ++i) Learn({{80.0, {0.0, 0.0}}, {80.0, {0.0, 0.0}}});
  EXPECT_EQ(Densities(), (std::vector<SideDensities>{shared_, shared_}));
  Learn({{80.0, {80.0, 0.0}}, {80.0, {0.0, 0.0}}});
  EXPECT_NE(Densities()[0], shared_);
  clutter_.Reset();
  EXPECT_EQ(Densities()[0], shared_);
}

TEST_F(LineClutterTest, NothingIsLearnedOfALineAtRestNorSaid) {
  const std::vector<LineCounts> counts = {{80.0, {80.0, 0.0}}, {80.0, {0.0, 80.0}}};
  Move(0.0);
  for (int i = 0; i < 50; ++i) Learn(counts);
  EXPECT_EQ(Densities(), (std::vector<SideDensities>{shared_, shared_}));
  Move(0.5);
  Learn(counts);
  EXPECT_NE(Densities()[0], shared_);
  EXPECT_NE(Densities()[1], shared_);
  Move(0.0);
  EXPECT_EQ(Densities(), (std::vector<SideDensities>{shared_, shared_}));
}

// Events of an outline, and as many again on its inner side, as a flickering lamp makes them there.
class OneSidedClutter : public ::testing::Test {
 protected:
  OneSidedClutter() : grid_(camera_) {
    MotionState state;
    state.camera_from_object = MakePose({0.0, 0.0, 1.0}, {0.0, 0.0, 0.0});
    state.twist[0] = 0.5;
    ProjectLines(camera_, state, tracked_, lines_);
    grid_.Build(lines_, 12.0);
    Random random(5);
    for (int i = 0; i < 20'000; ++i) {
      AddEvent(kDensity.sigma_px * random.Normal());
      AddEvent(random.Uniform(0.0, 6.0));
    }
  }
  void AddEvent(double du_px) {
    Observation event;
    event.u_px = camera_.cx_px + du_px;
    event.v_px = camera_.cy_px;
    event.bx = du_px / camera_.fx_px;
    grid_.GiveLines(event);
    events_.push_back(event);
  }
  // Of the events that the line explains, px.
  double MeanDistance(const std::vector<SideDensities>& clutter) {
    WindowInput input;
    input.events = events_;
    input.lines = tracked_;
    AccumulateMixture(input, lines_, kDensity, clutter, table_, sums_);
    return sums_[0].sums.Sum(0).dot(lines_[0].a) / sums_[0].sums.weight();
  }

  const CameraModel camera_ = MakeCamera(1280, 720, 1000.0);
  const std::vector<TrackedLine> tracked_ = {{0, {0.0, -0.05, 0.0}, {0.0, 0.05, 0.0}}};
  const ExpTable table_;
  TileGrid grid_;
  std::vector<ImageLine> lines_;
  std::vector<Observation> events_;
  std::vector<MixtureLine> sums_;
};

TEST_F(OneSidedClutter, NoLongerDrawsTheLineOnceItIsKnown) {
  const std::vector<SideDensities> even = {{kDensity.Outlier(), kDensity.Outlier()}};
  EXPECT_GT(std::abs(MeanDistance(even)), 0.1);
  LineClutter clutter(camera_);
  std::vector<SideDensities> learned = even;
  for (int i = 0; i < 5; ++i) {
    MeanDistance(learned);
    clutter.Learn(tracked_, lines_, {{sums_[0].sums.weight(), sums_[0].beside}}, kDensity.gate_px);
    clutter.Densities(tracked_, lines_, kDensity, learned);
  }
  EXPECT_LT(std::abs(MeanDistance(learned)), 0.02);
  EXPECT_NEAR(sums_[0].sums.weight(), 20'000.0, 1000.0);
}

}  // namespace
}  // namespace evpose

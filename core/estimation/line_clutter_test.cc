// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/line_clutter.h"

#include <gtest/gtest.h>

#include "core/estimation/ideal_events_testing.h"
#include "core/estimation/mixture_estimator.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

using testing::MakeCamera;
using testing::MakePose;

const MixtureDensity kDensity = {0.5, 0.2, 6.0};

// Two vertical lines, which are the model lines 3 and 1 and move sideways.
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
  // `counts`: those of the present window.
  std::vector<LineDensities> Densities(const std::vector<LineCounts>& counts = {}) const {
    std::vector<LineDensities> densities;
    clutter_.Densities(tracked_, lines_, counts, kDensity.gate_px, kDensity, densities);
    return densities;
  }

  const CameraModel camera_ = MakeCamera(1280, 720, 1000.0);
  const std::vector<TrackedLine> tracked_ = {{3, {0.0, -0.05, 0.0}, {0.0, 0.05, 0.0}},
                                             {1, {0.1, -0.05, 0.0}, {0.1, 0.05, 0.0}}};
  std::vector<ImageLine> lines_;
  LineClutter clutter_{camera_};
  // Densities of a line without counts.
  const LineDensities shared_ = LineDensities::Of(kDensity);
};

// 80 events of the line, and 4 events per pixel of clutter on one side, half of each polarity. A gate of 6 px has
// lateral strips of 2 px.
const LineCounts kBelow = {{40.0, 40.0}, {{{4.0, 4.0}, {0.0, 0.0}}}};
const LineCounts kAbove = {{40.0, 40.0}, {{{0.0, 0.0}, {4.0, 4.0}}}};
const LineCounts kAlone = {{40.0, 40.0}, {}};
// Expected clutter density of each polarity for these counts, 1/px.
constexpr double kDense = (1.0 - 0.2) * 4.0 / 80.0;

TEST_F(LineClutterTest, EachSideOfEachLineHasItsOwnDensity) {
  EXPECT_EQ(Densities(), (std::vector<LineDensities>{shared_, shared_}));
  for (int i = 0; i < 50; ++i) Learn({kBelow, kAlone});
  const std::vector<LineDensities> densities = Densities();
  for (int polarity = 0; polarity < 2; ++polarity) {
    EXPECT_NEAR(densities[0].beside[0][polarity], kDense, 0.1 * kDense);
    EXPECT_EQ(densities[0].beside[1][polarity], kDensity.Outlier());
    EXPECT_DOUBLE_EQ(densities[0].own[polarity], 1.0);
  }
  EXPECT_EQ(densities[1], shared_);
}

TEST_F(LineClutterTest, EachPolarityHasItsOwnDensity) {
  // The OFF events are those of a lamp, the ON events those of the first line.
  for (int i = 0; i < 50; ++i) Learn({{{0.0, 80.0}, {{{8.0, 0.0}, {0.0, 0.0}}}}, kAlone});
  const LineDensities line = Densities()[0];
  EXPECT_NEAR(line.beside[0][0], 2.0 * kDense, 0.2 * kDense);
  EXPECT_EQ(line.beside[0][1], kDensity.Outlier());
  EXPECT_LT(line.own[0], 0.2);
  EXPECT_NEAR(line.own[0] + line.own[1], 2.0, 1e-12);
  // When the line moves the other way its events change polarity; those of the lamp do not.
  Move(-0.5);
  const LineDensities back = Densities()[0];
  EXPECT_DOUBLE_EQ(back.own[0], line.own[1]);
  EXPECT_DOUBLE_EQ(back.own[1], line.own[0]);
  EXPECT_EQ(back.beside, line.beside);
}

TEST_F(LineClutterTest, CountsOfTheWindowActAtOnce) {
  for (int i = 0; i < 50; ++i) Learn({kAlone, kAlone});
  const LineCounts burst = {{40.0, 40.0}, {{{400.0, 0.0}, {0.0, 0.0}}}};
  const std::vector<LineDensities> densities = Densities({burst, kAlone});
  EXPECT_GT(densities[0].beside[0][0], 50.0 * kDensity.Outlier());
  EXPECT_EQ(densities[1], shared_);
  EXPECT_EQ(Densities()[0], shared_) << "counts of the window are used without being learned";
}

TEST_F(LineClutterTest, ClutterIsForgottenAfterAsManyEventsWithoutIt) {
  for (int i = 0; i < 50; ++i) Learn({kBelow, kAbove});
  for (int i = 0; i < 20; ++i) Learn({kAlone, kAlone});
  EXPECT_EQ(Densities(), (std::vector<LineDensities>{shared_, shared_}));
  Learn({{{40.0, 40.0}, {{{40.0, 40.0}, {0.0, 0.0}}}}, kAlone});
  EXPECT_NE(Densities()[0], shared_);
}

TEST_F(LineClutterTest, BothSidesOfALineAtRestAreEquallyDense) {
  Move(0.0);
  for (int i = 0; i < 50; ++i) Learn({{{0.0, 80.0}, kBelow.beside}, kAbove});
  for (const LineDensities& line : Densities()) {
    EXPECT_EQ(line.beside[0], line.beside[1]);
    EXPECT_NEAR(line.beside[0][0], kDense, 0.1 * kDense);
    EXPECT_EQ(line.own, shared_.own) << "a line at rest has no events of its own";
  }
  Move(0.5);
  EXPECT_EQ(Densities()[0].own, shared_.own) << "events of a line at rest do not determine its polarity";
  EXPECT_EQ(Densities()[0].beside[1], shared_.beside[1]);
}

// Events of an outline, and as many uniformly distributed ones on its inner side, as under a flickering lamp.
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
  // Mean distance of the events that are attributed to the line, px.
  double MeanDistance(const std::vector<LineDensities>& clutter) {
    pass_.Accumulate({events_, lines_.size()}, lines_, kDensity, clutter, sums_);
    return sums_[0].sums.Sum(0).dot(lines_[0].a) / sums_[0].sums.weight();
  }

  const CameraModel camera_ = MakeCamera(1280, 720, 1000.0);
  const std::vector<TrackedLine> tracked_ = {{0, {0.0, -0.05, 0.0}, {0.0, 0.05, 0.0}}};
  MixturePass pass_;
  TileGrid grid_;
  std::vector<ImageLine> lines_;
  std::vector<Observation> events_;
  std::vector<MixtureLine> sums_;
};

TEST_F(OneSidedClutter, DoesNotDisplaceTheLineOnceItIsLearned) {
  const std::vector<LineDensities> even = {LineDensities::Of(kDensity)};
  EXPECT_GT(std::abs(MeanDistance(even)), 0.1);
  LineClutter clutter(camera_);
  std::vector<LineDensities> learned = even;
  for (int i = 0; i < 5; ++i) {
    MeanDistance(learned);
    clutter.Learn(tracked_, lines_, {{sums_[0].weight(), sums_[0].beside}}, kDensity.gate_px);
    clutter.Densities(tracked_, lines_, {}, 0.0, kDensity, learned);
  }
  EXPECT_LT(std::abs(MeanDistance(learned)), 0.02);
  EXPECT_NEAR(sums_[0].sums.weight(), 20'000.0, 1000.0);
}

TEST(LineClutter, SumsTheElementsOfACurve) {
  const CameraModel camera = MakeCamera(1280, 720, 1000.0);
  std::vector<TrackedLine> whole = {{2, {0.0, -0.06, 0.0}, {0.0, 0.06, 0.0}}};
  std::vector<TrackedLine> elements(6);
  for (int k = 0; k < 6; ++k) {
    elements[k].curve = 2;
    elements[k].p1 = {0.0, -0.06 + 0.02 * k, 0.0};
    elements[k].p2 = {0.0, -0.04 + 0.02 * k, 0.0};
    elements[k].is_element = true;
  }
  MotionState state;
  state.camera_from_object = MakePose({0.0, 0.0, 1.0}, {0.0, 0.0, 0.0});
  state.twist[0] = 0.5;
  std::vector<ImageLine> of_whole, of_elements;
  ProjectLines(camera, state, whole, of_whole);
  ProjectLines(camera, state, elements, of_elements);
  LineClutter a(camera), b(camera);
  const LineCounts sixth = {{kBelow.own[0] / 6, kBelow.own[1] / 6},
                            {{{kBelow.beside[0][0] / 6, kBelow.beside[0][1] / 6}, {0.0, 0.0}}}};
  std::vector<LineDensities> densities_a, densities_b;
  for (int i = 0; i < 5; ++i) {
    a.Learn(whole, of_whole, std::vector<LineCounts>{kBelow}, kDensity.gate_px);
    b.Learn(elements, of_elements, std::vector<LineCounts>(6, sixth), kDensity.gate_px);
  }
  a.Densities(whole, of_whole, std::vector<LineCounts>{kBelow}, kDensity.gate_px, kDensity, densities_a);
  b.Densities(elements, of_elements, std::vector<LineCounts>(6, sixth), kDensity.gate_px, kDensity, densities_b);
  ASSERT_EQ(densities_b.size(), 6u);
  for (const LineDensities& density : densities_b) {
    for (int polarity = 0; polarity < 2; ++polarity) {
      EXPECT_NEAR(density.beside[0][polarity], densities_a[0].beside[0][polarity], 1e-12);
      EXPECT_NEAR(density.own[polarity], densities_a[0].own[polarity], 1e-12);
    }
  }
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/evidence/curve_activity.h"

#include <gtest/gtest.h>

#include "core/contours/edge_elements.h"
#include "core/estimation/ideal_events_testing.h"

namespace evpose {
namespace {

// Two elements of one contour, 30 px each, that move by 2 px per window.
class CurveActivityTest : public ::testing::Test {
 protected:
  CurveActivityTest() : tracked_(2) {
    for (int k = 0; k < 2; ++k) {
      tracked_[k].curve = 4;
      tracked_[k].p1 = {0.0, -0.03 + 0.03 * k, 0.0};
      tracked_[k].p2 = {0.0, 0.03 * k, 0.0};
      tracked_[k].is_element = true;
      tracked_[k].kind = EdgeKind::kContour;
    }
    MotionState state;
    state.camera_from_object = testing::MakePose({0.0, 0.0, 1.0}, {0.0, 0.0, 0.0});
    state.twist[0] = 1.0;
    ProjectLines(camera_, state, tracked_, lines_);
  }
  void Add(double events_per_px2, int windows, double background_per_px2 = 0.0) {
    WindowInput input;
    input.lines = tracked_;
    input.duration_s = 0.002;
    input.background_per_px2 = background_per_px2;
    const double events = events_per_px2 * 30.0 * 2.0;
    for (int i = 0; i < windows; ++i) activity_.Add(camera_, input, lines_, std::vector<double>{events, events});
  }

  const CameraModel camera_ = testing::MakeCamera(640, 480, 1000.0);
  std::vector<TrackedLine> tracked_;
  std::vector<ImageLine> lines_;
  CurveActivity activity_{10, 0.15};
};

TEST_F(CurveActivityTest, AContourMustHaveShownEvents) {
  EXPECT_EQ(activity_.Of(tracked_[0]), Expectation::kPerhaps);
  Add(2.0, 1);
  EXPECT_EQ(activity_.Of(tracked_[0]), Expectation::kEvents);
  EXPECT_EQ(activity_.Of(tracked_[1]), Expectation::kEvents) << "elements of a curve share it";
}

TEST_F(CurveActivityTest, AContourThatMovesWithoutEventsIsNotExpectedToHaveAny) {
  Add(0.0, 2);
  EXPECT_EQ(activity_.Of(tracked_[0]), Expectation::kPerhaps);
  Add(0.0, 4);
  EXPECT_EQ(activity_.Of(tracked_[0]), Expectation::kNothing);
  // Before another background it shows events again.
  Add(2.0, 3);
  EXPECT_EQ(activity_.Of(tracked_[0]), Expectation::kEvents);
  Add(0.0, 100);
  EXPECT_EQ(activity_.Of(tracked_[0]), Expectation::kNothing);
}

TEST_F(CurveActivityTest, EventsOfTheBackgroundDoNotCount) {
  Add(0.2, 20, 0.2);  // in 2 px by 30 px as many as the background has there
  EXPECT_EQ(activity_.Of(tracked_[0]), Expectation::kNothing);
}

TEST_F(CurveActivityTest, StraightLinesOfFullContrastAndSharpCreasesAreExpected) {
  TrackedLine line = tracked_[0];
  line.kind = EdgeKind::kCrease;
  EXPECT_EQ(activity_.Of(line), Expectation::kEvents);
  line.prior_contrast = 0.3f;
  EXPECT_EQ(activity_.Of(line), Expectation::kPerhaps);
  Add(0.0, 50);
  EXPECT_EQ(activity_.Of(line), Expectation::kNothing);
  line.is_element = false;
  EXPECT_EQ(activity_.Of(line), Expectation::kNothing);
  line.prior_contrast = 1.0f;
  EXPECT_EQ(activity_.Of(line), Expectation::kEvents);
}

TEST_F(CurveActivityTest, AStepIsExpectedOnceItHasEvents) {
  TrackedLine& step = tracked_[0];
  step.kind = EdgeKind::kCrease;
  step.prior_contrast = kStepContrast;
  for (const bool is_element : {true, false}) {
    step.is_element = is_element;
    EXPECT_EQ(activity_.Of(step), Expectation::kNothing);
  }
  Add(2.0, 3);
  EXPECT_EQ(activity_.Of(step), Expectation::kEvents);
}

TEST_F(CurveActivityTest, ALoadedStateIsTheSame) {
  Add(0.0, 50);
  StateWriter writer;
  writer(activity_);
  const std::string state = writer.Take();
  CurveActivity loaded(10, 0.15);
  StateReader reader(state);
  reader(loaded);
  ASSERT_TRUE(reader.Finish().ok());
  EXPECT_EQ(loaded.Of(tracked_[0]), Expectation::kNothing);
}

}  // namespace
}  // namespace evpose

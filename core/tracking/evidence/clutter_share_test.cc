// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/evidence/clutter_share.h"

#include <gtest/gtest.h>

#include <string>

namespace evpose {
namespace {

using Scores = ClutterShare::Scores;

TEST(ClutterShareTest, EventsWithoutClutterCountInFull) {
  ClutterShare share;
  EXPECT_EQ(share.Update({Scores{.near = {50.0, 30.0}}}, 1000), ByPolarity({1.0, 1.0}));
  EXPECT_EQ(share.ratio(), 0.0);
}

TEST(ClutterShareTest, APolarityThatIsOnlyClutterHasNoWeight) {
  ClutterShare share;
  const ByPolarity weights = share.Update({Scores{.near = {100.0, 40.0}, .beside = {100.0, 10.0}}}, 1000);
  EXPECT_DOUBLE_EQ(weights[0], 0.0);
  EXPECT_DOUBLE_EQ(weights[1], 0.75);
  EXPECT_DOUBLE_EQ(share.ratio(), 110.0 / 140.0);
}

TEST(ClutterShareTest, MoreBesideTheLinesThanNearThemIsNoNegativeWeight) {
  ClutterShare share;
  EXPECT_EQ(share.Update({Scores{.near = {10.0, 20.0}, .beside = {30.0, 40.0}}}, 1000), ByPolarity({0.0, 0.0}));
  EXPECT_EQ(share.ratio(), 1.0);
}

// A wrong pose has clutter beside its lines where the right one has none.
TEST(ClutterShareTest, ThePoseWithTheLeastClutterCounts) {
  ClutterShare share;
  const Scores wrong{.near = {40.0, 40.0}, .beside = {30.0, 30.0}}, right{.near = {60.0, 60.0}, .beside = {6.0, 6.0}};
  EXPECT_EQ(share.Update({wrong, right}, 1000), ByPolarity({0.9, 0.9}));
  EXPECT_DOUBLE_EQ(share.ratio(), 0.1);
}

TEST(ClutterShareTest, WithoutPosesOrEventsNothingHasWeight) {
  ClutterShare share;
  EXPECT_EQ(share.Update({}, 1000), ByPolarity({0.0, 0.0}));
  EXPECT_EQ(share.Update({Scores()}, 2000), ByPolarity({0.0, 0.0}));
  EXPECT_EQ(share.ratio(), 0.0);
}

TEST(ClutterShareTest, FewEventsDoNotDetermineTheShare) {
  ClutterShare share;
  EXPECT_EQ(share.Update({Scores{.near = {9.0, 9.0}, .beside = {9.0, 9.0}}}, 1000), ByPolarity({0.0, 0.0}));
  EXPECT_EQ(share.ratio(), 0.0);
}

TEST(ClutterShareTest, TheShareIsTheLargestOfTheLastWindows) {
  const Scores clutter{.near = {50.0, 50.0}, .beside = {40.0, 40.0}}, clear{.near = {50.0, 50.0}};
  ClutterShare share;
  share.Update({clutter}, 1'000'000);
  EXPECT_DOUBLE_EQ(share.ratio(), 0.8);
  share.Update({clear}, 1'020'000);
  EXPECT_DOUBLE_EQ(share.ratio(), 0.4) << "after the time constant";
  share.Update({clutter}, 1'021'000);
  EXPECT_DOUBLE_EQ(share.ratio(), 0.8);
  share.Update({clear}, 1'020'000);
  EXPECT_DOUBLE_EQ(share.ratio(), 0.8) << "a window that is not later lets nothing decay";
}

TEST(ClutterShareTest, TheStateIsCompleteAndBounded) {
  ClutterShare share;
  share.Update({Scores{.near = {50.0, 50.0}, .beside = {40.0, 40.0}}}, 1'000'000);
  StateWriter writer;
  writer(share);
  const std::string state = writer.Take();
  ClutterShare copy;
  StateReader reader(state);
  reader(copy);
  ASSERT_TRUE(reader.ok());
  for (ClutterShare* each : {&share, &copy}) each->Update({}, 1'010'000);
  EXPECT_EQ(share.ratio(), copy.ratio());
  EXPECT_GT(copy.ratio(), 0.5);

  StateWriter hostile;
  hostile(2.0, int64_t{0});
  const std::string beyond = hostile.Take();
  StateReader rejecting(beyond);
  rejecting(copy);
  EXPECT_FALSE(rejecting.ok());
}

}  // namespace
}  // namespace evpose

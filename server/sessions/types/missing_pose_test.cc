// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/types/missing_pose.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>

namespace evpose::server {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

ObjectHealth Without(InitializationStatus status) {
  return {.state = TrackState::kInitializing, .initialization = {.status = status, .attempts = 3, .num_lines = 2}};
}

TEST(MissingPoseTest, EachReasonHasATextOfItsOwn) {
  std::set<std::string> texts;
  for (int status = 1; status <= static_cast<int>(kLastInitializationStatus); ++status) {
    const std::string text = ExplainMissingPose(Without(static_cast<InitializationStatus>(status)));
    EXPECT_FALSE(text.empty()) << status;
    EXPECT_TRUE(texts.insert(text).second) << text;
  }
}

TEST(MissingPoseTest, AConfirmedPoseNeedsNoReason) {
  ObjectHealth object = Without(InitializationStatus::kNotNeeded);
  for (const TrackState state : {TrackState::kTracking, TrackState::kDegraded}) {
    object.state = state;
    EXPECT_EQ(ExplainMissingPose(object), "");
  }
}

TEST(MissingPoseTest, DifferentResultsOfSearchesAreListed) {
  ObjectHealth object = Without(InitializationStatus::kTooFewLines);
  object.initialization.searches.too_few_lines = 9;
  EXPECT_THAT(ExplainMissingPose(object), Not(HasSubstr("searches")));
  object.initialization.searches.no_pose_fits = 3;
  EXPECT_THAT(ExplainMissingPose(object),
              HasSubstr("(of 12 searches, 9 with fewer than three lines, 3 without a pose that fits the edges)"));
}

TEST(MissingPoseTest, AnAmbiguousObjectHasTheNumberOfPoses) {
  ObjectHealth object = Without(InitializationStatus::kAmbiguous);
  object.state = TrackState::kAmbiguous;
  object.initialization.num_poses = 2;
  EXPECT_EQ(ExplainMissingPose(object), "2 poses are compatible with the events");
  object.initialization.num_poses = 1;
  EXPECT_EQ(ExplainMissingPose(object), "another pose may explain the events, and its comparison has not begun yet");
}

TEST(MissingPoseTest, ALostObjectHasTimeAndCause) {
  ObjectHealth object = Without(InitializationStatus::kTooFewLines);
  object.state = TrackState::kLost;
  object.initialization.loss_cause = LossCause::kOutOfView;
  object.initialization.lost_at_us = 2'500'000;
  EXPECT_THAT(ExplainMissingPose(object),
              HasSubstr("lost at 2.500000 s because the object left the image; since then: too few lines"));
  // The cause of a window without a usable fit, too, which may have many events.
  object.initialization.loss_cause = LossCause::kUncertain;
  EXPECT_THAT(ExplainMissingPose(object), HasSubstr("because the events did not determine the pose any more; since"));
  object.initialization.loss_cause = LossCause::kOutOfView;
  object.initialization.status = InitializationStatus::kNotSupported;
  EXPECT_EQ(ExplainMissingPose(object), "lost at 2.500000 s because the object left the image");
}

}  // namespace
}  // namespace evpose::server

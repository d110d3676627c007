// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/evidence/determination.h"

#include <gtest/gtest.h>

#include <memory>
#include <vector>

#include "core/estimation/ideal_events_testing.h"

namespace evpose {
namespace {

// A cube with an edge of 100 mm at a distance of 1 m, seen obliquely; each edge has 200 expected events.
class DeterminationTest : public ::testing::Test {
 protected:
  DeterminationTest() : model_(testing::MakeCube(0.1)) {
    state_.camera_from_object = testing::MakePose({0.0, 0.0, 1.0}, {0.5, 0.4, 0.2});
    for (const ModelLine& line : model_->lines) {
      tracked_.push_back({static_cast<int>(tracked_.size()), line.p1, line.p2});
    }
    ProjectLines(camera_, state_, tracked_, lines_);
  }
  bool IsConfirmed(const std::vector<CurveResult>& results) {
    Determination determination(camera_, *model_, {Eigen::Vector3d::Zero(), 0.5 * model_->diameter_m}, options_);
    determination.Sum(state_.camera_from_object, tracked_, lines_, results);
    return determination.IsConfirmed(options_.confirm_support_ratio);
  }
  std::vector<CurveResult> All(CurveResult::Kind kind, double events, double support_ratio) const {
    return std::vector<CurveResult>(tracked_.size(), {kind, events, kExpected, support_ratio});
  }

  static constexpr double kExpected = 200.0;
  const CameraModel camera_ = testing::MakeCamera(640, 480, 500.0);
  const HealthOptions options_;
  const std::shared_ptr<const ObjectModel> model_;
  MotionState state_;
  std::vector<TrackedLine> tracked_;
  std::vector<ImageLine> lines_;
};

TEST_F(DeterminationTest, SupportedCurvesDetermineACube) {
  EXPECT_TRUE(IsConfirmed(All(CurveResult::Kind::kSupported, kExpected, 1.0)));
  EXPECT_FALSE(IsConfirmed(All(CurveResult::Kind::kContradicted, kExpected, 0.0)));
  EXPECT_FALSE(IsConfirmed(All(CurveResult::Kind::kOpen, kExpected, 0.0)));
}

TEST_F(DeterminationTest, PooledCurvesCountWithTheShareThatThePooledTestFound) {
  EXPECT_TRUE(IsConfirmed(All(CurveResult::Kind::kPooled, kExpected, 0.9)));
  EXPECT_FALSE(IsConfirmed(All(CurveResult::Kind::kPooled, kExpected, 0.0))) << "the pooled test is not significant";
}

TEST_F(DeterminationTest, APooledCurveWithoutEventsOfItsOwnDoesNotCount) {
  // The events that make the pooled test significant lie on one edge, which determines a part of the motions.
  std::vector<CurveResult> results = All(CurveResult::Kind::kPooled, 0.0, 0.9);
  results.front().events = kExpected;
  EXPECT_FALSE(IsConfirmed(results));
}

}  // namespace
}  // namespace evpose

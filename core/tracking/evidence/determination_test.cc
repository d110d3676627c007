// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/evidence/determination.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <memory>
#include <vector>

#include "core/association/observability.h"
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
  Determination Of(const std::vector<CurveResult>& results) const {
    Determination determination(camera_, *model_, sphere_, options_);
    determination.Sum(state_.camera_from_object, tracked_, lines_, results);
    return determination;
  }
  bool IsKept(const std::vector<CurveResult>& results) const { return Of(results).IsKept(); }
  bool IsConfirmed(const std::vector<CurveResult>& results) const {
    return Of(results).IsConfirmed(options_.confirm_support_ratio);
  }
  std::vector<CurveResult> All(CurveResult::Kind kind, double events, double support_ratio) const {
    return std::vector<CurveResult>(tracked_.size(), {kind, events, kExpected, support_ratio});
  }

  // Events of each of the lines from `first` on with which the least certain motion has this standard deviation, at
  // most, without any single one of these lines if `is_without_any`.
  double EventsFor(double uncertainty_px, size_t first, bool is_without_any) const {
    const Matrix6d motions = OutlineMotions(camera_, state_.camera_from_object, sphere_.centre, sphere_.radius_m);
    const auto least_information = [&](size_t left_out) {
      Matrix6d information = Matrix6d::Zero();
      for (size_t k = first; k < lines_.size(); ++k) {
        if (k != left_out) AddInformation(camera_, lines_[k], 1.0 / options_.dispersion, motions, information);
      }
      return Eigen::SelfAdjointEigenSolver<Matrix6d>(information).eigenvalues().minCoeff();
    };
    double least = least_information(lines_.size());
    for (size_t k = first; is_without_any && k < lines_.size(); ++k) least = std::min(least, least_information(k));
    return 1.0 / (uncertainty_px * uncertainty_px * least);
  }

  static constexpr double kExpected = 200.0;
  const CameraModel camera_ = testing::MakeCamera(640, 480, 500.0);
  const HealthOptions options_;
  const std::shared_ptr<const ObjectModel> model_;
  const BoundingSphere sphere_ = {Eigen::Vector3d::Zero(), 0.5 * model_->diameter_m};
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

TEST_F(DeterminationTest, APoseIsKeptWhileEveryMotionIsKnownWithinTheLargestUncertainty) {
  const double events = EventsFor(options_.max_uncertainty_px, 0, false);
  EXPECT_TRUE(IsKept(All(CurveResult::Kind::kSupported, 1.05 * events, 1.0)));
  EXPECT_FALSE(IsKept(All(CurveResult::Kind::kSupported, 0.95 * events, 1.0)));
  EXPECT_FALSE(IsConfirmed(All(CurveResult::Kind::kSupported, 1.05 * events, 1.0))) << "without any single edge";
  EXPECT_FALSE(IsKept(All(CurveResult::Kind::kContradicted, 1.05 * events, 0.0)));
}

TEST_F(DeterminationTest, AConfirmedPoseIsKnownWithinTheLargestUncertaintyWithoutAnySingleEdge) {
  const double events = EventsFor(options_.max_uncertainty_px, 0, true);
  EXPECT_TRUE(IsConfirmed(All(CurveResult::Kind::kSupported, 1.05 * events, 1.0)));
  EXPECT_FALSE(IsConfirmed(All(CurveResult::Kind::kSupported, 0.95 * events, 1.0)));
  EXPECT_TRUE(IsKept(All(CurveResult::Kind::kSupported, 0.95 * events, 1.0)));
}

TEST_F(DeterminationTest, WithASmallShareOfTheExpectedInformationAPoseMustBeSure) {
  // Most of the expected events are those of one edge, which has none.
  const auto results = [&](double events, double expected_of_silent) {
    std::vector<CurveResult> all = All(CurveResult::Kind::kSupported, events, 1.0);
    all.front() = {CurveResult::Kind::kContradicted, 0.0, expected_of_silent, 0.0};
    return all;
  };
  constexpr double kMost = 100.0 * kExpected;
  const double sure = EventsFor(options_.sure_uncertainty_px, 1, true);
  EXPECT_TRUE(IsConfirmed(results(1.05 * sure, kMost)));
  EXPECT_FALSE(IsConfirmed(results(0.95 * sure, kMost)));
  EXPECT_TRUE(IsConfirmed(results(0.95 * sure, 0.0))) << "the silent edge is not expected to have events";
  EXPECT_TRUE(IsKept(results(0.95 * sure, kMost))) << "to keep a pose the share does not count";
}

}  // namespace
}  // namespace evpose

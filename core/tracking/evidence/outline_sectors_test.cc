// SPDX-License-Identifier: Apache-2.0

// The part of TrackHealth that compares the events in each of the eight sectors of the outline with those that the
// motion should cause.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>
#include <vector>

#include "core/association/observation_testing.h"
#include "core/association/tracked_ring_testing.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/numerics/random.h"
#include "core/tracking/evidence/health.h"

namespace evpose {
namespace {

using SectorKind = HealthResult::Kind;

constexpr int kRingElements = 48;  // six in each sector
constexpr double kRingPx = 60.0;
constexpr double kLeastEventsPerPx2 = 0.15;

// A circle that approaches the camera: every part of it moves across itself with the same speed, so that the same
// number of events is expected in each sector.
class OutlineSectorsTest : public ::testing::Test {
 protected:
  explicit OutlineSectorsTest(const HealthOptions& options = {}) : options_(options) {
    state_.camera_from_object = testing::MakePose({0.0, 0.0, 1.0}, {0.0, 0.0, 0.0});
    ProjectLines(camera_, state_, tracked_, lines_);
    grid_.Build(lines_, 12.0);
  }
  void SetUp() override { Restart(); }
  void Restart() {
    health_ = std::make_unique<TrackHealth>(options_, near_probability_, kLeastEventsPerPx2, 1);
    results_.clear();
  }
  void AddEvent(double angle_rad, double distance_px) {
    const double radius_px = kRingPx + distance_px;
    Observation event = testing::ObservationAt(
        camera_, {camera_.cx_px + radius_px * std::cos(angle_rad), camera_.cy_px + radius_px * std::sin(angle_rad)});
    grid_.GiveLines(event);
    KeepLinesWithin(10.0, lines_.data(), event);
    events_.push_back(event);
  }
  double AngleIn(int sector) { return 0.25 * M_PI * (sector + random_.Uniform()); }
  // Adds events with the spread of a right pose.
  void AddOwnEvents(int sector, int count) {
    for (int i = 0; i < count; ++i) AddEvent(AngleIn(sector), random_.Normal());
  }
  // Closes a window in which the motion should have caused at least `expected` events in each sector.
  void CloseWindow(double expected, double duration_s = 0.01) {
    state_.twist[2] = -expected / (kLeastEventsPerPx2 * 0.25 * M_PI * kRingPx * kRingPx * duration_s);
    WindowInput input;
    const LineEvents sorted(events_, tracked_.size());
    input.sorted = &sorted;
    input.duration_s = duration_s;
    input.lines = tracked_;
    input.expectations = expectations_;
    WindowFit fit;
    fit.state = state_;
    fit.residual_rms_px = 1.0;
    health_->AddWindow(camera_, input, lines_, fit);
    events_.clear();
    results_.push_back(health_->Test({0.35, 3, 1000}));
  }
  // Windows in which the last `num_empty` sectors have no events, and each of the others has enough for a result.
  void FollowWithEmpty(int num_empty, int num_windows, double expected) {
    for (int i = 0; i < num_windows; ++i) {
      for (int sector = 0; sector < kNumOutlineSectors - num_empty; ++sector) AddOwnEvents(sector, 40);
      CloseWindow(expected);
    }
  }
  // Index of the first window from `first` on with another result; results_.size() if there is none.
  size_t FirstOther(SectorKind kind, int missing_sectors, size_t first = 0) const {
    const auto differs = [&](const HealthResult& result) {
      return result.kind != kind || result.missing_sectors != missing_sectors;
    };
    return std::find_if(results_.begin() + static_cast<ptrdiff_t>(first), results_.end(), differs) - results_.begin();
  }

  const CameraModel camera_ = testing::MakeCamera(640, 480, 1000.0);
  const HealthOptions options_;
  const NearProbability near_probability_{options_};
  const std::vector<TrackedLine> tracked_ = testing::TrackedRing(kRingElements, 0.06);
  std::vector<Expectation> expectations_;  // empty: events are expected of all
  MotionState state_;
  std::vector<ImageLine> lines_;
  TileGrid grid_{camera_};
  Random random_{11};
  std::vector<Observation> events_;
  std::unique_ptr<TrackHealth> health_;
  std::vector<HealthResult> results_;  // of each window
};

TEST_F(OutlineSectorsTest, AnOutlineWithEventsEverywhereIsSupported) {
  FollowWithEmpty(0, 40, 10.0);
  EXPECT_EQ(FirstOther(SectorKind::kSupported, 0), results_.size());
}

TEST_F(OutlineSectorsTest, UpToThreeSectorsMayLackTheirEvents) {
  FollowWithEmpty(3, 40, 10.0);
  // 48 expected events (5 times the square of 3.1) make the absence of all of them significant.
  EXPECT_EQ(FirstOther(SectorKind::kSupported, 0), 4u);
  EXPECT_EQ(FirstOther(SectorKind::kSupported, 3, 4), results_.size());
}

TEST_F(OutlineSectorsTest, APoseWithoutTheEventsOfFourSectorsIsDoubtful) {
  FollowWithEmpty(4, 40, 10.0);
  EXPECT_EQ(FirstOther(SectorKind::kSupported, 0), 4u);
  EXPECT_EQ(FirstOther(SectorKind::kDoubtful, 4, 4), results_.size());
}

TEST_F(OutlineSectorsTest, ASectorWithFewExpectedEventsIsNotMissing) {
  FollowWithEmpty(4, 47, 1.0);
  EXPECT_EQ(FirstOther(SectorKind::kSupported, 0), results_.size()) << "47 expected events";
}

TEST_F(OutlineSectorsTest, SectorsWhoseElementsPerhapsHaveNoEventsAreNotMissing) {
  // The last four sectors are contours before a background that may be as bright as the object.
  expectations_.assign(kRingElements, Expectation::kEvents);
  std::fill(expectations_.begin() + kRingElements / 2, expectations_.end(), Expectation::kPerhaps);
  FollowWithEmpty(4, 40, 10.0);
  EXPECT_EQ(FirstOther(SectorKind::kSupported, 0), results_.size());
}

TEST_F(OutlineSectorsTest, ADeficitAccumulatesOverSeconds) {
  // 600 events per second. Within a second, 12 events are expected in each of the sectors without any.
  constexpr double kWindowS = 0.02;
  for (int i = 0; i < 500; ++i) {
    for (int sector = 0; sector < 4; ++sector) AddOwnEvents(sector, 3);
    CloseWindow(12.0 * kWindowS, kWindowS);
  }
  std::vector<std::pair<double, HealthResult>> decided;  // seconds
  for (size_t i = 0; i < results_.size(); ++i) {
    if (results_[i].kind != SectorKind::kOpen) decided.emplace_back(kWindowS * static_cast<double>(i + 1), results_[i]);
  }
  ASSERT_GT(decided.size(), 20u);
  for (const auto& [t_s, result] : decided) {
    EXPECT_EQ(result.kind, t_s < 48.05 / 12.0 ? SectorKind::kSupported : SectorKind::kDoubtful) << t_s;
  }
}

TEST_F(OutlineSectorsTest, ClutterIsNotTheEventsOfASector) {
  for (int i = 0; i < 40; ++i) {
    for (int sector = 0; sector < 4; ++sector) AddOwnEvents(sector, 40);
    // Twice as many events as are expected, spread over the gates.
    for (int sector = 4; sector < kNumOutlineSectors; ++sector) {
      for (int n = 0; n < 20; ++n) AddEvent(AngleIn(sector), random_.Uniform(-8.0, 8.0));
    }
    CloseWindow(10.0);
  }
  EXPECT_EQ(FirstOther(SectorKind::kDoubtful, 4, 20), results_.size());
}

// Tests the sectors in every window, however few events there are.
class OutlineSectorsFalseAlarms : public OutlineSectorsTest {
 protected:
  static HealthOptions TestedInEveryWindow() {
    HealthOptions options;
    options.min_events = 1;
    return options;
  }
  OutlineSectorsFalseAlarms() : OutlineSectorsTest(TestedInEveryWindow()) {}
};

TEST_F(OutlineSectorsFalseAlarms, OfTheRightPoseAreRarerThanOneInAThousand) {
  // Each sector of the right pose has 400 events on average, the least number that the motion causes. They occur in
  // groups of five. The number of groups has a Poisson distribution: the variance of the events is five times the mean.
  constexpr int kRuns = 2000, kWindows = 50;
  constexpr double kExpected = 8.0;
  const int group = static_cast<int>(options_.dispersion);
  int alarms = 0, most_missing = 0;
  for (int run = 0; run < kRuns; ++run) {
    Restart();
    for (int i = 0; i < kWindows; ++i) {
      for (int sector = 0; sector < kNumOutlineSectors; ++sector) {
        for (uint32_t left = random_.Poisson(kExpected / group); left > 0; --left) {
          const double angle_rad = AngleIn(sector);
          for (int k = 0; k < group; ++k) AddEvent(angle_rad, random_.Normal());
        }
      }
      const int before = results_.empty() ? 0 : results_.back().missing_sectors;
      CloseWindow(kExpected);
      alarms += std::max(0, results_.back().missing_sectors - before);
      most_missing = std::max(most_missing, results_.back().missing_sectors);
    }
  }
  RecordProperty("alarms", alarms);
  EXPECT_LE(alarms, kRuns * kNumOutlineSectors / 1000);
  EXPECT_GT(alarms, 0) << "the sectors are not tested";
  EXPECT_LE(most_missing, 1);
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/evidence/health.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "core/association/observation_testing.h"
#include "core/association/tracked_ring_testing.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

using ::testing::AllOf;
using ::testing::Each;
using ::testing::Ge;
using ::testing::SizeIs;

using Kind = HealthResult::Kind;

constexpr int kNumLines = 10;
constexpr double kLineM = 0.1;  // 100 px
constexpr double kWindowS = 0.002;
constexpr double kKeep = 0.35;

// Ten vertical lines, 40 px apart, that move to the right by 0.4 px per window.
class HealthTest : public ::testing::Test {
 protected:
  HealthTest() {
    for (int k = 0; k < kNumLines; ++k) {
      const double x = 0.04 * (k - 0.5 * kNumLines);
      tracked_.push_back({k, {x, -0.5 * kLineM, 0.0}, {x, 0.5 * kLineM, 0.0}});
    }
    state_.camera_from_object = testing::MakePose({0.0, 0.0, 1.0}, {0.0, 0.0, 0.0});
    state_.twist[0] = 0.2;
    ProjectLines(camera_, state_, tracked_, lines_);
    grid_.Build(lines_, 12.0);
  }

  // Adds `count` events, uniformly distributed over a strip about a line, or about a part of it, in fractions of its
  // length.
  void AddEvents(int line, int count, double half_width_px, double along_begin = 0.0, double along_end = 1.0,
                 uint8_t polarity = 0) {
    for (int i = 0; i < count; ++i) {
      Eigen::Vector2d pixel = lines_[line].PointAt(random_.Uniform(along_begin, along_end));
      pixel.x() += random_.Uniform(-half_width_px, half_width_px);
      Observation event = testing::ObservationAt(camera_, pixel);
      event.polarity = polarity;
      grid_.GiveLines(event);
      events_.push_back(event);
    }
  }
  void CloseWindow(double background_per_px2 = 0.0, ByPolarity polarity_weight = {1.0, 1.0}) {
    WindowInput input;
    input.sampling.polarity_weight = polarity_weight;
    const LineEvents sorted(events_, tracked_.size());
    input.events = events_;
    input.sorted = &sorted;
    input.duration_s = kWindowS;
    input.background_per_px2 = background_per_px2;
    input.lines = tracked_;
    fit_.state = state_;
    health_->AddWindow(camera_, input, lines_, fit_);
    events_.clear();
  }
  // A window in which `num_lines` lines have events of their own, and the others have unrelated events nearby.
  HealthResult WindowWithOwn(int num_lines) {
    for (int k = 0; k < kNumLines; ++k) AddEvents(k, 100, k < num_lines ? 1.0 : 8.0);
    CloseWindow();
    return TestNow();
  }
  HealthResult TestNow() { return health_->Test({kKeep, 2, options_.min_contradiction_us}); }

  const CameraModel camera_ = testing::MakeCamera(1280, 720, 1000.0);
  const HealthOptions options_{};
  const NearProbability near_probability_{options_};
  std::vector<TrackedLine> tracked_;
  MotionState state_;
  std::vector<ImageLine> lines_;
  TileGrid grid_{camera_};
  std::vector<Observation> events_;
  WindowFit fit_;  // of the next window; its state is state_
  Random random_{7};
  std::unique_ptr<TrackHealth> health_ = std::make_unique<TrackHealth>(options_, near_probability_, 0.15, kNumLines);
};

TEST_F(HealthTest, APoseIsSupportedAtOnce) {
  const HealthResult result = WindowWithOwn(kNumLines);
  EXPECT_EQ(result.kind, Kind::kSupported);
  EXPECT_EQ(result.supported_lines, kNumLines);
}

TEST_F(HealthTest, HalfOfAPoseIsDoubtfulAfterTheTimeOfAContradiction) {
  for (int i = 0; i < 4; ++i) EXPECT_EQ(WindowWithOwn(5).kind, Kind::kOpen) << i;
  const HealthResult result = WindowWithOwn(5);
  EXPECT_EQ(result.kind, Kind::kDoubtful);
  EXPECT_NEAR(result.support_ratio, 0.5, 0.01);
}

TEST_F(HealthTest, APoseWithAFifthOfItsLinesBesideTheirEventsIsDoubtful) {
  for (int i = 0; i < 4; ++i) EXPECT_EQ(WindowWithOwn(8).kind, Kind::kOpen) << i;
  const HealthResult result = WindowWithOwn(8);
  EXPECT_EQ(result.kind, Kind::kDoubtful);
  EXPECT_NEAR(result.support_ratio, 0.8, 0.01);
}

TEST_F(HealthTest, HiddenLinesAreNotDisplaced) {
  // After ten windows the absence of their events is significant.
  for (int i = 0; i < 20; ++i) {
    for (int k = 0; k < 8; ++k) AddEvents(k, 100, 1.0);
    CloseWindow();
    const HealthResult result = TestNow();
    EXPECT_EQ(result.kind, Kind::kSupported) << i;
  }
  EXPECT_EQ(health_->curve_results()[9].kind, CurveResult::Kind::kContradicted);
}

TEST_F(HealthTest, EdgesThatCrossAFifthOfTheLinesDoNotContradictThem) {
  for (int i = 0; i < 20; ++i) {
    for (int k = 0; k < 8; ++k) AddEvents(k, 100, 1.0);
    for (int k = 8; k < kNumLines; ++k) AddEvents(k, 100, 8.0, 0.0, 0.3);
    CloseWindow();
    EXPECT_EQ(TestNow().kind, Kind::kSupported) << i;
  }
}

TEST_F(HealthTest, APoseWhoseEventsAreSpreadAboutItsLinesAndBesideThemIsDoubtful) {
  const auto evaluate = [&](double spread_px, double contrast) {
    health_ = std::make_unique<TrackHealth>(options_, near_probability_, 0.15, kNumLines);
    fit_.gate_px = 6.0;
    fit_.residual_rms_px = spread_px;
    fit_.num_explained = 1000.0;
    fit_.num_background = 100.0;
    const double per_px = fit_.num_explained / (std::sqrt(2.0 * M_PI) * spread_px);
    fit_.num_gated = fit_.num_explained + fit_.num_background + 2.0 * fit_.gate_px * per_px / contrast;
    HealthResult result;
    for (int i = 0; i < 10 && result.kind == Kind::kOpen; ++i) result = WindowWithOwn(kNumLines);
    return result.kind;
  };
  EXPECT_EQ(evaluate(1.2, 0.9 * options_.min_contrast), Kind::kDoubtful);
  EXPECT_EQ(evaluate(1.2, 1.1 * options_.min_contrast), Kind::kSupported) << "no events beside the lines";
  EXPECT_EQ(evaluate(0.7, 0.9 * options_.min_contrast), Kind::kSupported) << "the spread of a right pose";
}

TEST_F(HealthTest, AFifthOfAPoseDoesNotSupportIt) {
  for (int i = 0; i < 4; ++i) EXPECT_EQ(WindowWithOwn(2).kind, Kind::kOpen) << i;
  EXPECT_EQ(WindowWithOwn(2).kind, Kind::kUnsupported);
}

TEST_F(HealthTest, AFewEventsOfOnePolaritySufficeAmongManyOfTheOther) {
  // Like a lamp that becomes brighter: 20 OFF events of the line among ON events of the lit surface. Without the
  // weights by polarity, the 20 events are within the fluctuation of the 420 gated ones.
  const auto evaluate = [&](double own_half_width_px) {
    HealthResult result;
    for (int i = 0; i < 10 && result.kind == Kind::kOpen; ++i) {
      for (int k = 0; k < kNumLines; ++k) {
        AddEvents(k, 400, 8.0, 0.0, 1.0, 1);
        AddEvents(k, 20, own_half_width_px, 0.0, 1.0, 0);
      }
      CloseWindow();
      result = TestNow();
    }
    return result.kind;
  };
  EXPECT_EQ(evaluate(1.0), Kind::kSupported);
  EXPECT_EQ(evaluate(8.0), Kind::kUnsupported);
}

TEST_F(HealthTest, FlickerDoesNotCountAgainstALine) {
  // While the lamp becomes brighter, lines with ON events are masked; half of the lines have OFF events. The motion is
  // so slow that no event is expected of the masked ones.
  state_.twist[0] = 0.02;
  const auto evaluate = [&](ByPolarity polarity_weight) {
    HealthResult result;
    for (int i = 0; i < 10 && result.kind == Kind::kOpen; ++i) {
      for (int k = 0; k < kNumLines; ++k) {
        AddEvents(k, 60, 8.0, 0.0, 1.0, 1);
        if (k % 2 == 0) AddEvents(k, 20, 1.0, 0.0, 1.0, 0);
      }
      CloseWindow(0.0, polarity_weight);
      result = TestNow();
    }
    return result;
  };
  const HealthResult result = evaluate({1.0, 0.01});
  EXPECT_EQ(result.kind, Kind::kSupported);
  EXPECT_EQ(result.testable_lines, kNumLines / 2);
  EXPECT_EQ(evaluate({1.0, 1.0}).kind, Kind::kDoubtful);
}

TEST_F(HealthTest, EventsAtTheBackgroundRateAreFewEvents) {
  // 3 Hz per pixel over 16 px x 100 px, ten lines.
  constexpr double kNoisePerPx2 = 3.0 * kWindowS;
  HealthResult result;
  for (int i = 0; i < 10 && result.kind == Kind::kOpen; ++i) {
    for (int k = 0; k < kNumLines; ++k) AddEvents(k, static_cast<int>(random_.Poisson(kNoisePerPx2 * 1600.0)), 8.0);
    CloseWindow(kNoisePerPx2);
    result = TestNow();
  }
  EXPECT_EQ(result.kind, Kind::kFewEvents);
  // The same events without any elsewhere: something moves there.
  result = HealthResult();
  for (int i = 0; i < 10 && result.kind == Kind::kOpen; ++i) {
    for (int k = 0; k < kNumLines; ++k) AddEvents(k, static_cast<int>(random_.Poisson(kNoisePerPx2 * 1600.0)), 8.0);
    CloseWindow();
    result = TestNow();
  }
  EXPECT_EQ(result.kind, Kind::kUnsupported);
}

TEST_F(HealthTest, ACrossingEdgeIsPresentOnAPartOfTheLines) {
  state_.twist.setZero();
  ProjectLines(camera_, state_, tracked_, lines_);
  const auto evaluate = [&](double along_begin, double along_end) {
    HealthResult result;
    for (int i = 0; i < 10 && result.kind == Kind::kOpen; ++i) {
      for (int k = 0; k < kNumLines; ++k) AddEvents(k, 20, 8.0, along_begin, along_end);
      CloseWindow();
      result = TestNow();
    }
    return result;
  };
  EXPECT_LT(evaluate(0.3, 0.45).present_ratio, 0.35);
  // Events along the whole lines: the object has moved away from this pose.
  EXPECT_GT(evaluate(0.0, 1.0).present_ratio, 0.9);
}

TEST_F(HealthTest, AnObjectAtRestStaysQuietInDenseNoise) {
  const auto add_noise = [&] {
    constexpr double kNoisePerPx2 = 30.0 * kWindowS;
    HealthResult result;
    for (int i = 0; i < 10 && result.kind == Kind::kOpen; ++i) {
      for (int k = 0; k < kNumLines; ++k) AddEvents(k, static_cast<int>(random_.Poisson(kNoisePerPx2 * 1600.0)), 8.0);
      CloseWindow(kNoisePerPx2);
      result = TestNow();
    }
    return result.kind;
  };
  // In motion the object would produce events of its own.
  EXPECT_EQ(WindowWithOwn(kNumLines).kind, Kind::kSupported);
  EXPECT_EQ(add_noise(), Kind::kUnsupported);
  for (int i = 0; i < 20 && TestNow().kind == Kind::kOpen; ++i) CloseWindow();
  EXPECT_EQ(add_noise(), Kind::kFewEvents);
}

// Lines 5 px apart, as the grooves of a puzzle cube in a small image: the gates of three lines overlap everywhere.
class DenseLinesTest : public ::testing::Test {
 protected:
  static constexpr double kSpacingPx = 5.0;
  DenseLinesTest() {
    for (int k = 0; k < kNumLines; ++k) {
      const double x = 0.001 * kSpacingPx * k;
      tracked_.push_back({k, {x, -0.5 * kLineM, 1.0}, {x, 0.5 * kLineM, 1.0}});
    }
    ProjectLines(camera_, MotionState(), tracked_, lines_);
    grid_.Build(lines_, 12.0);
  }
  // Adds an event at a distance from a line.
  void Add(int line, double distance_px) {
    Eigen::Vector2d pixel = lines_[line].PointAt(random_.Uniform(0.0, 1.0));
    pixel.x() += distance_px;
    Observation event = testing::ObservationAt(camera_, pixel);
    grid_.GiveLines(event);
    events_.push_back(event);
  }
  // The first result other than kOpen of windows with `count` events of each line, which are normally distributed with
  // this standard deviation about a line at a distance of `shift_px`: the events of another pose.
  HealthResult ResultOf(int count, double shift_px, double spread_px, int max_windows) {
    TrackHealth health(options_, near_probability_, 0.0, kNumLines);
    HealthResult result;
    for (int i = 0; i < max_windows && result.kind == Kind::kOpen; ++i) {
      for (int k = 1; k + 1 < kNumLines; ++k) {
        for (int n = 0; n < count; ++n) Add(k, shift_px + spread_px * random_.Normal());
      }
      WindowInput input;
      const LineEvents sorted(events_, tracked_.size());
      input.sorted = &sorted;
      input.duration_s = 0.01;
      input.lines = tracked_;
      WindowFit fit;
      fit.residual_rms_px = std::min(spread_px, 1.0);
      health.AddWindow(camera_, input, lines_, fit);
      events_.clear();
      result = health.Test({kKeep, 2, 10'000});
    }
    pooled_ratios_.clear();
    for (const CurveResult& curve : health.curve_results()) {
      if (curve.kind == CurveResult::Kind::kPooled) pooled_ratios_.push_back(curve.support_ratio);
    }
    return result;
  }

  const CameraModel camera_ = testing::MakeCamera(640, 480, 1000.0);
  const HealthOptions options_;
  std::vector<double> pooled_ratios_;  // CurveResult::support_ratio of the pooled curves of the last ResultOf()
  const NearProbability near_probability_{options_};
  std::vector<TrackedLine> tracked_;
  std::vector<ImageLine> lines_;
  TileGrid grid_{camera_};
  std::vector<Observation> events_;
  Random random_{13};
};

TEST_F(DenseLinesTest, EventsBetweenTheLinesAreNoSupport) {
  EXPECT_EQ(ResultOf(100, 0.0, 0.8, 20).kind, Kind::kSupported);
  EXPECT_EQ(ResultOf(100, 0.0, 30.0, 20).kind, Kind::kUnsupported) << "uniform";
  EXPECT_EQ(ResultOf(100, 0.5 * kSpacingPx, 0.8, 20).kind, Kind::kUnsupported) << "slid by half of the spacing";
}

TEST_F(DenseLinesTest, AContradictionRequiresPower) {
  // 20 events of each of eight lines in a window: of isolated lines they would suffice.
  EXPECT_EQ(ResultOf(20, 0.0, 30.0, 2).kind, Kind::kOpen);
  EXPECT_EQ(ResultOf(20, 0.0, 30.0, 20).kind, Kind::kUnsupported);
}

TEST_F(DenseLinesTest, LinesWithoutPowerOfTheirOwnSupportAPoseTogether) {
  // Too few events for the significance of most single lines.
  const HealthResult right = ResultOf(110, 0.0, 1.0, 1);
  EXPECT_EQ(right.kind, Kind::kSupported);
  EXPECT_GE(right.support_ratio, HealthOptions().confirm_support_ratio);
  EXPECT_THAT(pooled_ratios_, AllOf(SizeIs(Ge(3)), Each(Ge(HealthOptions().confirm_support_ratio))));
  EXPECT_NE(ResultOf(110, 0.5 * kSpacingPx, 1.0, 1).kind, Kind::kSupported);
  EXPECT_THAT(pooled_ratios_, AllOf(SizeIs(Ge(3)), Each(0.0)));
}

// A circle of elements, 60 px in radius, as one curve.
class RingHealthTest : public ::testing::Test {
 protected:
  static constexpr int kElements = 48;
  RingHealthTest() {
    state_.camera_from_object = testing::MakePose({0.0, 0.0, 1.0}, {0.0, 0.0, 0.0});
    state_.twist[0] = 0.2;
    ProjectLines(camera_, state_, tracked_, lines_);
    grid_.Build(lines_, 12.0);
  }
  // The result of one window with events that are uniformly distributed over a ring about the circle.
  HealthResult ResultOf(int events, double half_width_px, double background_per_px2 = 0.0,
                        absl::Span<const Expectation> expectations = {}) {
    std::vector<Observation> observations;
    for (int i = 0; i < events; ++i) {
      const double angle = random_.Uniform(0.0, 2.0 * M_PI);
      const double radius = 60.0 + random_.Uniform(-half_width_px, half_width_px);
      Observation event = testing::ObservationAt(
          camera_, {camera_.cx_px + radius * std::cos(angle), camera_.cy_px + radius * std::sin(angle)});
      grid_.GiveLines(event);
      KeepLinesWithin(10.0, lines_.data(), event);
      observations.push_back(event);
    }
    WindowInput input;
    const LineEvents sorted(observations, tracked_.size());
    input.sorted = &sorted;
    input.duration_s = 0.01;
    input.lines = tracked_;
    input.background_per_px2 = background_per_px2;
    input.expectations = expectations;
    TrackHealth health(options_, near_probability_, 0.15, 1);
    WindowFit fit;
    fit.state = state_;
    health.AddWindow(camera_, input, lines_, fit);
    return health.Test({kKeep, 3, 1000});
  }

  const CameraModel camera_ = testing::MakeCamera(640, 480, 1000.0);
  const HealthOptions options_;
  const NearProbability near_probability_{options_};
  const std::vector<TrackedLine> tracked_ = testing::TrackedRing(kElements, 0.06);
  MotionState state_;
  std::vector<ImageLine> lines_;
  TileGrid grid_{camera_};
  Random random_{3};
};

TEST_F(RingHealthTest, ACircleConstrainsAPoseAsSeveralLines) {
  const HealthResult result = ResultOf(400, 1.0);
  EXPECT_EQ(result.kind, Kind::kSupported);
  EXPECT_GE(result.supported_lines, 6);
  EXPECT_LE(result.supported_lines, LineStatistics::kMaxLines);
  EXPECT_EQ(ResultOf(400, 8.0).kind, Kind::kUnsupported);
}

TEST_F(RingHealthTest, EventsAtJointsAreCountedOnce) {
  // All events are within the gate of one element each: the circle has no gaps and no overlaps.
  EXPECT_GT(ResultOf(400, 1.0).sigma, 0.95 * 400 * 0.75 / std::sqrt(400 * 0.25 * 0.75 * options_.dispersion));
}

TEST_F(RingHealthTest, ACurveWithoutExpectedEventsIsNotTestable) {
  // A background that explains all events in the gates: 700 events in a ring of 60 px.
  constexpr double kBackground = 700.0 / (60.0 * 2.0 * M_PI * 60.0);
  EXPECT_GT(ResultOf(700, 30.0, kBackground).testable_lines, 0) << "the motion should have produced events";
  const std::vector<Expectation> no_events(kElements, Expectation::kNothing);
  EXPECT_EQ(ResultOf(700, 30.0, kBackground, no_events).testable_lines, 0);
}

}  // namespace
}  // namespace evpose

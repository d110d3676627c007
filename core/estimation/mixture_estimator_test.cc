// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/mixture_estimator.h"

#include <gtest/gtest.h>

#include <cmath>

#include "core/association/observation_testing.h"
#include "core/estimation/event_deficit.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

using testing::MakeCamera;
using testing::MakePose;

// Two parallel lines, 3 px apart.
class MixtureTest : public ::testing::Test {
 protected:
  MixtureTest() : grid_(camera_) {
    state_.camera_from_object = MakePose({0.0, 0.0, 1.0}, {0.0, 0.0, 0.0});
    state_.twist[0] = 0.2;
    ProjectLines(camera_, state_, tracked_, lines_);
    grid_.Build(lines_, 12.0);
  }
  Observation At(double du_px, double dv_px, uint8_t polarity = 1) const {
    Observation event = testing::ObservationAt(camera_, {camera_.cx_px + du_px, camera_.cy_px + dv_px});
    grid_.GiveLines(event);
    event.polarity = polarity;
    return event;
  }
  MixtureTotals Accumulate(const std::vector<Observation>& events, const MixtureDensity& density) {
    const std::vector<LineDensities> even(lines_.size(), LineDensities::Of(density));
    return pass_.Accumulate({events, lines_.size()}, lines_, density, even, sums_);
  }
  // Returns the missing share of the expected events for the events of the last Accumulate(), as from a window of 10
  // ms.
  double EventDeficit(double noise_per_px, absl::Span<const DeficitCounts> past, Matrix12d& hessian,
                      Vector12d& gradient) {
    WindowInput input;
    input.duration_s = 0.01;
    CountForDeficit(camera_, input, lines_, sums_, state_.twist, noise_per_px, 0.15, deficit_counts_);
    return AddEventDeficit(camera_, lines_, deficit_counts_, past, state_.twist, 1.0, hessian, gradient);
  }
  // Events that are spread evenly over a rectangle.
  std::vector<Observation> EvenEvents(int count, double left_px, double right_px, double top_px, double bottom_px,
                                      uint64_t seed) const {
    Random random(seed);
    std::vector<Observation> events;
    for (int i = 0; i < count; ++i) {
      const double du_px = random.Uniform(left_px, right_px);
      events.push_back(At(du_px, random.Uniform(top_px, bottom_px)));
    }
    return events;
  }
  static double Weight(const MixtureLine& line) { return line.sums.weight(); }

  const CameraModel camera_ = MakeCamera(1280, 720, 1000.0);
  const std::vector<TrackedLine> tracked_ = {{0, {0.0, -0.05, 0.0}, {0.0, 0.05, 0.0}},
                                             {1, {0.003, -0.05, 0.0}, {0.003, 0.05, 0.0}}};
  MotionState state_;
  std::vector<ImageLine> lines_;
  TileGrid grid_;
  MixturePass pass_;
  std::vector<MixtureLine> sums_;
  std::vector<DeficitCounts> deficit_counts_;
};

TEST_F(MixtureTest, AnEventBetweenTwoLinesIsShared) {
  const MixtureDensity density{1.0, 0.1, 6.0};
  Accumulate({At(1.5, 10.0)}, density);
  EXPECT_NEAR(Weight(sums_[0]), Weight(sums_[1]), 1e-4);
  EXPECT_GT(Weight(sums_[0]), 0.4);
  EXPECT_LT(Weight(sums_[0]), 0.5);
  Accumulate({At(0.5, 10.0)}, density);
  // exp(-(0.5^2 - 2.5^2) / 2) = e^3.
  EXPECT_NEAR(Weight(sums_[0]) / Weight(sums_[1]), 20.0855, 0.02);
}

TEST_F(MixtureTest, ObservedInformationEqualsTheCurvatureOfTheLikelihood) {
  for (const double outlier_ratio : {0.05, 0.5, 0.9}) {
    const MixtureDensity density = {0.5, outlier_ratio, 1.4};  // the gate excludes the other line
    Random random(3);
    std::vector<Observation> events;
    std::vector<double> distances_px;
    for (int i = 0; i < 20'000; ++i) {
      const double du_px =
          random.Uniform() < outlier_ratio ? random.Uniform(-1.4, 1.4) : density.sigma_px * random.Normal();
      if (std::abs(du_px) >= 1.4) continue;
      distances_px.push_back(du_px);
      events.push_back(At(du_px, 0.0));
    }
    Accumulate(events, density);
    const double observed_information =
        sums_[0].ObservedRatio(density.sigma_px) * Weight(sums_[0]) / std::pow(density.sigma_px, 2);
    const auto log_likelihood = [&](double shift_px) {
      double sum = 0.0;
      for (const double d_px : distances_px) {
        const double u = (d_px - shift_px) / density.sigma_px;
        const double line = (1.0 - outlier_ratio) * std::exp(-0.5 * u * u) / (density.sigma_px * std::sqrt(2.0 * M_PI));
        sum += std::log(line + density.Outlier());
      }
      return sum;
    };
    constexpr double kStepPx = 0.02;
    const double curvature =
        (log_likelihood(kStepPx) - 2.0 * log_likelihood(0.0) + log_likelihood(-kStepPx)) / (kStepPx * kStepPx);
    EXPECT_NEAR(observed_information, -curvature, 0.02 * Weight(sums_[0]) / std::pow(density.sigma_px, 2))
        << outlier_ratio;
  }
}

TEST_F(MixtureTest, AnEventOfTheOtherPolarityHasLessWeight) {
  const MixtureDensity density = {0.5, 0.2, 1.4};
  const std::vector<Observation> events = {At(0.0, 0.0, 0), At(0.0, 0.0, 1)};
  std::vector<LineDensities> densities(lines_.size(), LineDensities::Of(density));
  densities[0].own = {0.1, 1.9};
  pass_.Accumulate({events, lines_.size()}, lines_, density, densities, sums_);
  const double line = density.Peak();
  EXPECT_NEAR(sums_[0].weight()[0], 0.1 * line / (0.1 * line + density.Outlier()), 1e-5);
  EXPECT_NEAR(sums_[0].weight()[1], 1.9 * line / (1.9 * line + density.Outlier()), 1e-5);
}

TEST_F(MixtureTest, SumsAreByLineHalfAndPolarity) {
  const MixtureDensity density{0.5, 0.1, 6.0};
  const MixtureTotals totals =
      Accumulate({At(-0.2, -20.0, 0), At(0.1, 20.0, 1), At(-5.5, 0.0), At(200.0, 0.0)}, density);
  EXPECT_EQ(totals.num_gated, 3.0);
  EXPECT_GT(sums_[0].half_weight[0][0], 0.9);
  EXPECT_GT(sums_[0].half_weight[1][1], 0.9);
  EXPECT_EQ(sums_[0].half_weight[0][1], 0.0);
  EXPECT_EQ(sums_[0].half_weight[1][0], 0.0);
  EXPECT_NEAR(totals.weight, Weight(sums_[0]) + Weight(sums_[1]), 1e-6);
}

TEST_F(MixtureTest, CountsAccountForDownsamplingByPolarity) {
  MixtureLine line;
  line.half_weight = {{{4.0, 1.0}, {2.0, 3.0}}};
  line.half_reversals = {{{2.0, 1.0}, {0.0, 3.0}}};
  const EdgeCounts counts = line.Counts({2.0, 10.0});
  EXPECT_EQ(counts.polarity[0], 12.0);
  EXPECT_EQ(counts.polarity[1], 40.0);
  EXPECT_EQ(counts.reversals[0], 14.0);
  EXPECT_EQ(counts.reversals[1], 30.0);
}

TEST_F(MixtureTest, AnEventDeficitReducesTheTwist) {
  Accumulate({}, MixtureDensity());
  Matrix12d hessian = Matrix12d::Zero();
  Vector12d gradient = Vector12d::Zero();
  EventDeficit(0.0, {}, hessian, gradient);
  EXPECT_GT(gradient[6], 0.0);  // against the motion to the right
  EXPECT_GT(hessian(6, 6), 0.0);
  // The Newton step of the penalty alone stops the motion.
  EXPECT_NEAR(-gradient[6] / hessian(6, 6), -state_.twist[0], 1e-9);
  EXPECT_EQ(hessian.topLeftCorner(6, 6).norm(), 0.0);
}

TEST_F(MixtureTest, BackgroundEventsDoNotSupportTheMotion) {
  // The background events near the lines are as many as their motion should produce.
  const std::vector<Observation> events = EvenEvents(600, -8.0, 11.0, -50.0, 50.0, 5);
  Accumulate(events, {0.8, 0.3, 6.0});
  const double explained = (Weight(sums_[0]) + Weight(sums_[1])) / 200.0;
  const auto gradient_with = [&](double noise_per_px) {
    Matrix12d hessian = Matrix12d::Zero();
    Vector12d gradient = Vector12d::Zero();
    EventDeficit(noise_per_px, {}, hessian, gradient);
    return gradient[6];
  };
  EXPECT_EQ(gradient_with(0.0), 0.0);
  EXPECT_GT(gradient_with(explained), 0.0);
}

TEST_F(MixtureTest, AnOccludedLineDoesNotReduceTheTwistWhileOthersHaveEvents) {
  // Line 0 sweeps 200 px^2 in 10 ms and produces 2 events per px^2; line 1 produces none.
  const std::vector<Observation> events = EvenEvents(400, -1.0, 0.0, -48.0, 48.0, 4);
  Accumulate(events, {0.5, 0.1, 6.0});
  Matrix12d hessian = Matrix12d::Zero();
  Vector12d gradient = Vector12d::Zero();
  EventDeficit(0.0, {}, hessian, gradient);
  EXPECT_EQ(gradient.norm(), 0.0);
  EXPECT_EQ(hessian.norm(), 0.0);
}

TEST_F(MixtureTest, EventsAtOnePlaceDoNotSupportTheOtherLines) {
  // All events lie on one half of one line, twenty times as many as both lines should produce.
  const std::vector<Observation> events = EvenEvents(1200, -1.0, 0.0, -48.0, -2.0, 6);
  Accumulate(events, {0.5, 0.1, 6.0});
  Matrix12d hessian = Matrix12d::Zero();
  Vector12d gradient = Vector12d::Zero();
  const double missing = EventDeficit(0.0, {}, hessian, gradient);
  EXPECT_NEAR(missing, 0.75, 0.01);
  EXPECT_GT(gradient[6], 0.0);
}

TEST_F(MixtureTest, ASlowLineHasNoDeficitInShortWindows) {
  // At 6 px/s one half of a line sweeps 0.3 px^2 in a millisecond: at the lower bound of the rate it produces 0.045
  // events, and in fact 0.6. Many windows have no event on most of the halves.
  state_.twist *= 0.03;
  constexpr int kMovingWindows = 250;
  constexpr int kStillWindows = 50;
  Random random(7);
  std::vector<DeficitCounts> past(2);
  int deficits_alone = 0, deficits_moving = 0, deficits_at_rest = 0;
  for (int window = 0; window < kMovingWindows + kStillWindows; ++window) {
    const bool is_moving = window < kMovingWindows;
    std::vector<DeficitCounts> deficit_counts(2);
    for (DeficitCounts& counts : deficit_counts) {
      counts.expected = {0.045, 0.045};
      for (double& observed : counts.observed) observed = is_moving ? random.Poisson(0.6) : 0.0;
    }
    Matrix12d hessian = Matrix12d::Zero();
    Vector12d gradient = Vector12d::Zero();
    const auto missing = [&](absl::Span<const DeficitCounts> before) {
      return AddEventDeficit(camera_, lines_, deficit_counts, before, state_.twist, 1.0, hessian, gradient);
    };
    if (is_moving && missing({}) > 0.5) ++deficits_alone;
    if (missing(past) > 0.5) ++(is_moving ? deficits_moving : deficits_at_rest);
    for (size_t k = 0; k < past.size(); ++k) past[k].Add(deficit_counts[k]);
  }
  EXPECT_GT(deficits_alone, 80);
  EXPECT_LT(deficits_moving, 3);
  // Within 12 windows 0.5 events were expected.
  EXPECT_GE(deficits_at_rest, kStillWindows - 12);
}

TEST_F(MixtureTest, AnExcessIsForgotten) {
  DeficitCounts sum, excess, deficit;
  excess.expected = {0.2, 0.2};
  excess.observed = {100.0, 0.0};
  deficit.expected = {0.2, 0.2};
  sum.Add(excess);
  EXPECT_EQ(sum.observed[0], sum.expected[0]);
  for (int i = 0; i < 20; ++i) sum.Add(deficit);
  EXPECT_NEAR(sum.expected[0], DeficitCounts::kMemoryEvents, 1e-12);
  EXPECT_LT(sum.observed[0], 0.01);
  EXPECT_EQ(sum.observed[1], 0.0);
}

// Six lines of a plate seen frontally, with events displaced alternately to one side and the other.
class DisplacedLines : public ::testing::Test {
 protected:
  DisplacedLines() : grid_(camera_) {
    state_ = InitialMotionState(MakePose({0.0, 0.0, 1.0}, {0.0, 0.0, 0.0}), 0, 1000.0, InitialPoseOptions());
    for (const double at : {-0.08, 0.0, 0.08}) {
      tracked_.push_back({static_cast<int>(tracked_.size()), {at, -0.1, 0.0}, {at, 0.1, 0.0}});
      tracked_.push_back({static_cast<int>(tracked_.size()), {-0.1, at, 0.0}, {0.1, at, 0.0}});
    }
    ProjectLines(camera_, state_, tracked_, lines_);
    grid_.Build(lines_, 16.0);
  }
  std::vector<Observation> MakeEvents(double displacement_px) {
    Random random(3);
    std::vector<Observation> events;
    for (int i = 0; i < 600; ++i) {
      const ImageLine& line = lines_[i % lines_.size()];
      const Eigen::Vector2d normal(-line.direction.y(), line.direction.x());
      const double sign = (i % lines_.size()) % 4 < 2 ? 1.0 : -1.0;
      const double off_px = sign * displacement_px + random.Uniform(-1.0, 1.0);
      const Eigen::Vector2d pixel = line.PointAt(random.Uniform(0.02, 0.98)) + off_px * normal;
      Observation event = testing::ObservationAt(camera_, pixel);
      grid_.GiveLines(event);
      events.push_back(event);
    }
    return events;
  }
  // Standard deviation of the lateral position after `num_windows` equal windows, metres.
  double LateralSigma(double displacement_px, int num_windows = 200) {
    const std::vector<Observation> events = MakeEvents(displacement_px);
    WindowInput input;
    const LineEvents sorted(events, tracked_.size());
    input.events = events;
    input.sorted = &sorted;
    input.duration_s = 0.001;
    input.lines = tracked_;
    EstimatorOptions options;
    options.sensor = testing::UnbiasedSensor();
    const std::unique_ptr<WindowEstimator> estimator = MakeMixtureEstimator(options, camera_);
    WindowFit fit;
    for (int window = 0; window < num_windows; ++window) {
      estimator->Fit(state_, input, 1.0, fit);
      estimator->Accept(fit, input);
    }
    return std::sqrt(fit.state.covariance(0, 0));
  }

  const CameraModel camera_ = MakeCamera(1280, 720, 1000.0);
  MotionState state_;
  std::vector<TrackedLine> tracked_;
  std::vector<ImageLine> lines_;
  TileGrid grid_;
};

TEST_F(DisplacedLines, MakeThePoseLessCertain) {
  const double known = LateralSigma(0.0);
  EXPECT_NEAR(LateralSigma(0.03), known, 0.1 * known) << "within the usual displacement";
  EXPECT_GT(LateralSigma(0.3), 2.0 * known);
}

TEST_F(DisplacedLines, OfANarrowFaceCarryLittleInformation) {
  const double known = LateralSigma(0.0, 1);
  // The vertical lines, which determine the lateral position.
  const auto with_faces_of = [&](double width_px) {
    for (size_t k = 0; k < tracked_.size(); k += 2) tracked_[k].narrowest_face_px = width_px;
    return LateralSigma(0.0, 1);
  };
  EXPECT_EQ(with_faces_of(10.0), known) << "wide enough for its edges to be separated";
  EXPECT_GT(with_faces_of(0.5), 3.0 * known);
  EXPECT_GT(with_faces_of(0.0), with_faces_of(0.5));
}

TEST(PoolCounts, DividesTheEventsOfACurveByTheExpectedOnes) {
  std::vector<DeficitCounts> counts(3);
  counts[0] = {{1.0, 1.0}, {4.0, 0.0}};
  counts[1] = {{2.0, 0.0}, {0.0, 0.0}};
  PoolCounts(absl::MakeSpan(counts));
  EXPECT_EQ(counts[0].observed, (std::array<double, 2>{1.0, 1.0}));
  EXPECT_EQ(counts[1].observed, (std::array<double, 2>{2.0, 0.0}));
  EXPECT_EQ(counts[2].observed, (std::array<double, 2>{0.0, 0.0}));
}

TEST_F(MixtureTest, OnlyExpectedLinesHaveADeficit) {
  Accumulate({}, {0.5, 0.2, 5.0});
  WindowInput input;
  input.lines = tracked_;
  input.duration_s = 0.01;
  const std::vector<Expectation> expectations = {Expectation::kEvents, Expectation::kPerhaps};
  input.expectations = expectations;
  CountForDeficit(camera_, input, lines_, sums_, state_.twist, 0.0, 0.15, deficit_counts_);
  EXPECT_GT(deficit_counts_[0].expected[0], 0.0);
  EXPECT_EQ(deficit_counts_[1].expected[0], 0.0);
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// Compares the vectorised computation in single precision with a plain loop in double precision.
#include "core/estimation/mixture_pass.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>

#include "core/association/observation_testing.h"
#include "core/base/yields_testing.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

constexpr double kLeastWeight = 1e-4;

// Sums of one line by a plain loop in double precision.
struct PlainLine {
  std::array<Eigen::Matrix3d, 3> moments = {Eigen::Matrix3d::Zero(), Eigen::Matrix3d::Zero(), Eigen::Matrix3d::Zero()};
  EdgeCounts counts;
  std::array<double, 2> half_weight = {};
  std::array<ByPolarity, 2> beside = {};
  double ambiguous_px2 = 0.0;
};

MixtureTotals PlainPass(absl::Span<const Observation> events, absl::Span<const ImageLine> lines,
                        const MixtureDensity& density, absl::Span<const LineDensities> densities,
                        std::vector<PlainLine>& sums) {
  sums.assign(lines.size(), {});
  MixtureTotals totals;
  for (const Observation& event : events) {
    const NearLines near = FindNearLines(event, lines.data(), density.gate_px, 0.0);
    if (near.count == 0) continue;
    double likelihood[2] = {};
    for (int k = 0; k < near.count; ++k) {
      const double u = near.distance_px[k] / density.sigma_px;
      likelihood[k] = densities[near.line[k]].own[event.polarity] * density.Peak() * std::exp(-0.5 * u * u);
    }
    const double others_per_px = (1.0 - density.outlier_ratio) * event.others_per_px;
    const int side = near.distance_px[0] > 0.0 ? 1 : 0;
    const double outlier = densities[near.line[0]].beside[side][event.polarity];
    const double all = likelihood[0] + likelihood[1] + outlier + others_per_px;
    if (std::abs(near.distance_px[0]) > LineCounts::kLateralRatio * density.gate_px) {
      sums[near.line[0]].beside[side][event.polarity] += outlier / all;
    }
    totals.num_gated += 1.0 - others_per_px / all;
    for (int k = 0; k < near.count; ++k) {
      const double weight = likelihood[k] / all;
      if (weight < kLeastWeight) continue;
      const ImageLine& line = lines[near.line[k]];
      PlainLine& sum = sums[near.line[k]];
      const Eigen::Vector3d bearing(event.bx, event.by, 1.0);
      for (int n = 0; n < 3; ++n) sum.moments[n] += weight * std::pow(event.tau_s, n) * bearing * bearing.transpose();
      const int half = line.AlongPx(event.u_px, event.v_px) < 0.5 * line.length_px ? 0 : 1;
      sum.counts.Add(event, half, weight);
      sum.half_weight[half] += weight;
      const double squared_px2 = near.distance_px[k] * near.distance_px[k];
      sum.ambiguous_px2 += weight * (1.0 - weight) * squared_px2;
      totals.weight += weight;
      totals.weighted_squares_px2 += weight * squared_px2;
    }
  }
  return totals;
}

// Events of a cube, clutter, and the densities of other objects. The lines are so dense that many events are near
// several of them.
class MixturePassTest : public ::testing::TestWithParam<int> {
 protected:
  MixturePassTest() : grid_(camera_), random_(GetParam()) {
    MotionState state;
    state.camera_from_object = testing::MakePose({0.02 * GetParam(), -0.01, 0.9}, {0.5, -0.4 + 0.1 * GetParam(), 0.2});
    state.twist << 0.3, -0.2, 0.1, 2.0, -1.0, 0.5;
    for (size_t k = 0; k < cube_->lines.size(); ++k) {
      tracked_.push_back({static_cast<int>(k), cube_->lines[k].p1, cube_->lines[k].p2});
      const Eigen::Vector3d beside(0.004, 0.003, 0.0);
      tracked_.push_back({static_cast<int>(k), cube_->lines[k].p1 + beside, cube_->lines[k].p2 + beside});
    }
    ProjectLines(camera_, state, tracked_, lines_);
    grid_.Build(lines_, 12.0);
    for (const ImageLine& line : lines_) {
      densities_.push_back(LineDensities::Of(density_));
      densities_.back().own = {0.7, 1.3};
      densities_.back().beside = {ByPolarity{random_.Uniform(0.01, 0.2), random_.Uniform(0.01, 0.2)},
                                  ByPolarity{random_.Uniform(0.01, 0.2), random_.Uniform(0.01, 0.2)}};
      if (line.in_view()) in_view_.push_back(static_cast<int>(densities_.size()) - 1);
    }
    for (int i = 0; i < 3000; ++i) AddEvent();
  }

  void AddEvent() {
    const ImageLine& line = lines_[in_view_[random_.UniformInt(in_view_.size())]];
    const Eigen::Vector2d pixel =
        line.PointAt(random_.Uniform(-0.05, 1.05)) + Eigen::Vector2d{3.0 * random_.Normal(), 3.0 * random_.Normal()};
    Observation event = testing::ObservationAt(camera_, pixel);
    event.tau_s = random_.Uniform(-1e-3, 1e-3);
    event.polarity = static_cast<uint8_t>(random_.UniformInt(2));
    event.previous = static_cast<PreviousPolarity>(random_.UniformInt(3));
    event.others_per_px = random_.Uniform() < 0.3 ? static_cast<float>(random_.Uniform(0.0, 0.5)) : 0.0f;
    if (grid_.GiveLines(event)) events_.push_back(event);
  }

  const CameraModel camera_ = testing::MakeCamera(1280, 720, 1000.0);
  const std::shared_ptr<const ObjectModel> cube_ = testing::MakeCube(0.15);
  const MixtureDensity density_{0.8, 0.2, 6.0};
  TileGrid grid_;
  Random random_;
  std::vector<TrackedLine> tracked_;
  std::vector<ImageLine> lines_;
  std::vector<int> in_view_;
  std::vector<LineDensities> densities_;
  std::vector<Observation> events_;
};

INSTANTIATE_TEST_SUITE_P(Windows, MixturePassTest, ::testing::Range(1, 6));

TEST_P(MixturePassTest, ManyEventsHaveYieldPoints) {
  std::vector<Observation> many;
  for (int i = 0; i < 40; ++i) many.insert(many.end(), events_.begin(), events_.end());
  const LineEvents sorted(many, lines_.size());
  MixturePass pass;
  std::vector<MixtureLine> sums;
  const size_t count = CountYields([&] { pass.Accumulate(sorted, lines_, density_, densities_, sums); });
  // Each of these events has at least two places, and takes some 50 ns.
  EXPECT_GE(count, 2 * sorted.shared().size() / 4096);
  EXPECT_GE(count, 10u);
}

TEST_P(MixturePassTest, EqualsAPlainLoop) {
  MixturePass pass;
  std::vector<MixtureLine> sums;
  const LineEvents sorted(events_, lines_.size());
  ASSERT_GT(sorted.shared().size(), 500u);
  pass.Accumulate(sorted, lines_, density_, densities_, sums);
  // A second pass reuses the memory of the first one.
  const MixtureTotals totals = pass.Accumulate(sorted, lines_, density_, densities_, sums);
  std::vector<PlainLine> plain;
  const MixtureTotals expected = PlainPass(events_, lines_, density_, densities_, plain);
  ASSERT_GT(expected.weight, 500.0);
  // Rounding determines whether an event at the end of a gate, or with a weight of 1e-4, is counted.
  constexpr double kEvents = 2e-3;
  EXPECT_NEAR(totals.num_gated, expected.num_gated, kEvents);
  EXPECT_NEAR(totals.weight, expected.weight, kEvents);
  EXPECT_NEAR(totals.weighted_squares_px2, expected.weighted_squares_px2, 10.0 * kEvents);
  ASSERT_EQ(sums.size(), plain.size());
  for (size_t k = 0; k < plain.size(); ++k) {
    for (int n = 0; n < 3; ++n) {
      EXPECT_LT((sums[k].sums.Moment(n) - plain[k].moments[n]).cwiseAbs().maxCoeff(), kEvents * std::pow(1e-3, n));
    }
    EXPECT_NEAR(sums[k].ambiguous_px2, plain[k].ambiguous_px2, 10.0 * kEvents);
    for (int i = 0; i < 2; ++i) {
      EXPECT_NEAR(sums[k].half_weight[i][0] + sums[k].half_weight[i][1], plain[k].half_weight[i], kEvents);
      EXPECT_NEAR(sums[k].weight()[i], plain[k].counts.polarity[i], kEvents);
      EXPECT_NEAR(sums[k].Counts({1.0, 1.0}).reversals[i], plain[k].counts.reversals[i], kEvents);
      for (int j = 0; j < 2; ++j) EXPECT_NEAR(sums[k].beside[i][j], plain[k].beside[i][j], kEvents);
    }
  }
}

// The mean distance of the events of a line, which moves the pose, agrees to far below what the events can resolve.
TEST_P(MixturePassTest, MeanDistancesEqualAPlainLoop) {
  MixturePass pass;
  std::vector<MixtureLine> sums;
  pass.Accumulate({events_, lines_.size()}, lines_, density_, densities_, sums);
  std::vector<PlainLine> plain;
  PlainPass(events_, lines_, density_, densities_, plain);
  for (size_t k = 0; k < plain.size(); ++k) {
    const double weight = plain[k].moments[0](2, 2);
    if (weight < 10.0) continue;
    const double expected_px = plain[k].moments[0].col(2).dot(lines_[k].a_expected) / weight;
    const double found_px = sums[k].sums.Sum(0).dot(lines_[k].a_expected) / sums[k].sums.weight();
    EXPECT_NEAR(found_px, expected_px, 1e-4);
  }
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// The pose search on random trials: its rate of right poses, and its robustness to defects of detected segments.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "core/experiments/first_pose/line_trial.h"
#include "core/initialization/pose_search.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

constexpr int kTrials = 200;

struct Setting {
  SimulatedObject object;
  int num_spurious;
  int num_missing;
  double least_right;  // share of right poses; slightly below that of 1000 trials
};

std::string SettingName(const testing::TestParamInfo<Setting>& info) {
  return std::string(SimulatedObjectName(info.param.object)) + "_" + std::to_string(info.param.num_spurious) + "_" +
         std::to_string(info.param.num_missing);
}

class PoseSearchTrialsTest : public testing::TestWithParam<Setting> {
 protected:
  void SetUp() override {
    const Setting& setting = GetParam();
    trials_ = LineTrialGenerator::Create({setting.object, 0.8, setting.num_spurious, setting.num_missing}).value();
    search_ = MakePoseSearch(std::make_shared<ObjectModel>(trials_->model()), trials_->camera()).value();
  }
  bool IsRight(const LineTrial& trial, const std::vector<PoseHypothesis>& hypotheses) const {
    return !hypotheses.empty() && CompareWithTruth(*trials_, trial, hypotheses[0].camera_from_object).is_right();
  }

  std::unique_ptr<LineTrialGenerator> trials_;
  std::unique_ptr<PoseSearch> search_;
};

TEST_P(PoseSearchTrialsTest, ThePoseIsRight) {
  int num_right = 0;
  int num_labels = 0, num_right_labels = 0;
  for (int seed = 0; seed < kTrials; ++seed) {
    const LineTrial trial = trials_->Make(seed);
    const std::vector<PoseHypothesis> hypotheses = search_->Search(trial.segments);
    if (!IsRight(trial, hypotheses)) continue;
    ++num_right;
    for (size_t i = 0; i < trial.segments.size(); ++i) {
      ++num_labels;
      // Lines are determined up to the symmetries; spurious segments have none.
      num_right_labels += (hypotheses[0].model_line[i] < 0) == (trial.model_line[i] < 0);
    }
    EXPECT_TRUE(std::is_sorted(hypotheses.begin(), hypotheses.end(),
                               [](const auto& a, const auto& b) { return a.cost < b.cost; }));
  }
  EXPECT_GE(num_right, GetParam().least_right * kTrials);
  EXPECT_GE(num_right_labels, 0.97 * num_labels);
}

INSTANTIATE_TEST_SUITE_P(
    Objects, PoseSearchTrialsTest,
    testing::Values(Setting{SimulatedObject::kCube, 0, 0, 0.99}, Setting{SimulatedObject::kCube, 2, 1, 0.98},
                    Setting{SimulatedObject::kCube, 4, 2, 0.97}, Setting{SimulatedObject::kCuboid, 0, 0, 0.99},
                    Setting{SimulatedObject::kCuboid, 2, 1, 0.98}, Setting{SimulatedObject::kCuboid, 4, 2, 0.97},
                    Setting{SimulatedObject::kPlanar, 0, 0, 0.99}, Setting{SimulatedObject::kPlanar, 2, 1, 0.97},
                    Setting{SimulatedObject::kPlanar, 4, 2, 0.89}, Setting{SimulatedObject::kBook, 0, 0, 0.985},
                    Setting{SimulatedObject::kBook, 2, 1, 0.975}, Setting{SimulatedObject::kBook, 4, 2, 0.96},
                    Setting{SimulatedObject::kSpacecraft, 0, 0, 0.98},
                    Setting{SimulatedObject::kSpacecraft, 2, 1, 0.98},
                    Setting{SimulatedObject::kSpacecraft, 4, 2, 0.96}),
    SettingName);

// Defects of detected segments: shifted, shortened or split in two.
std::vector<ImageSegment> Degraded(const LineTrial& trial, Random& random) {
  std::vector<ImageSegment> segments;
  for (size_t i = 0; i < trial.segments.size(); ++i) {
    ImageSegment segment = trial.segments[i];
    if (trial.model_line[i] < 0) {
      segments.push_back(segment);
      continue;
    }
    const Eigen::Vector2d along = (segment.p2_px - segment.p1_px).normalized();
    const Eigen::Vector2d shift = (random.UniformInt(2) == 0 ? 0.5 : -0.5) * Eigen::Vector2d(-along.y(), along.x());
    segment.p1_px += shift + std::min(random.Uniform(0.0, 6.0), 0.2 * segment.length_px()) * along;
    segment.p2_px += shift - std::min(random.Uniform(0.0, 6.0), 0.2 * segment.length_px()) * along;
    if (random.UniformInt(4) != 0 || segment.length_px() < 60.0) {
      segments.push_back(segment);
      continue;
    }
    const double cut = random.Uniform(0.3, 0.7);
    const Eigen::Vector2d middle = segment.p1_px + cut * (segment.p2_px - segment.p1_px);
    segments.push_back({segment.p1_px, middle - 4.0 * along});
    segments.push_back({middle + 4.0 * along, segment.p2_px});
  }
  return segments;
}

class DegradedSegmentsTest : public PoseSearchTrialsTest {};

TEST_P(DegradedSegmentsTest, ThePoseIsRight) {
  int num_right = 0;
  for (int seed = 0; seed < kTrials; ++seed) {
    const LineTrial trial = trials_->Make(seed);
    Random random(seed);
    num_right += IsRight(trial, search_->Search(Degraded(trial, random)));
  }
  EXPECT_GE(num_right, GetParam().least_right * kTrials);
}

INSTANTIATE_TEST_SUITE_P(Objects, DegradedSegmentsTest,
                         testing::Values(Setting{SimulatedObject::kCube, 2, 1, 0.9},
                                         Setting{SimulatedObject::kCuboid, 2, 1, 0.9},
                                         Setting{SimulatedObject::kPlanar, 2, 1, 0.7},
                                         Setting{SimulatedObject::kBook, 2, 1, 0.9},
                                         Setting{SimulatedObject::kSpacecraft, 2, 1, 0.9}),
                         SettingName);

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/first_pose/line_trial.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "core/geometry/projected_line.h"

namespace evpose {
namespace {

constexpr SimulatedObject kObjects[] = {SimulatedObject::kCube, SimulatedObject::kCuboid, SimulatedObject::kPlanar,
                                        SimulatedObject::kBook, SimulatedObject::kSpacecraft};
constexpr int kTrials = 40;

std::unique_ptr<LineTrialGenerator> Generator(SimulatedObject object, double noise_px, int spurious, int missing) {
  return LineTrialGenerator::Create({object, noise_px, spurious, missing}).value();
}

class LineTrialTest : public testing::TestWithParam<SimulatedObject> {};

TEST_P(LineTrialTest, WithoutNoiseSegmentsLieOnTheirLines) {
  const auto trials = Generator(GetParam(), 0.0, 2, 1);
  for (int seed = 0; seed < kTrials; ++seed) {
    const LineTrial trial = trials->Make(seed);
    int num_spurious = 0;
    for (size_t i = 0; i < trial.segments.size(); ++i) {
      if (trial.model_line[i] < 0) {
        ++num_spurious;
        continue;
      }
      const ModelLine& line = trials->model().lines[trial.model_line[i]];
      const auto projected = ProjectLine(trials->camera(), trial.camera_from_object, line.p1, line.p2);
      ASSERT_TRUE(projected);
      const double length_px = (projected->p2_px - projected->p1_px).norm();
      for (const Eigen::Vector2d& end : {trial.segments[i].p1_px, trial.segments[i].p2_px}) {
        // The end points lie on the line and between its ends.
        EXPECT_NEAR((end - projected->p1_px).norm() + (end - projected->p2_px).norm(), length_px, 1e-6);
      }
    }
    EXPECT_EQ(num_spurious, 2);
  }
}

TEST_P(LineTrialTest, OnlyTheMissingLinesAreAbsent) {
  const auto trials = Generator(GetParam(), 0.8, 4, 2);
  for (int seed = 0; seed < kTrials; ++seed) {
    const LineTrial trial = trials->Make(seed);
    ASSERT_EQ(trial.segments.size(), trial.model_line.size());
    std::set<int> visible, detected(trial.model_line.begin(), trial.model_line.end());
    for (const VisibleSegment& part : trial.visible) visible.insert(part.line);
    EXPECT_EQ(detected.erase(-1), 1);
    EXPECT_EQ(detected.size() + 2, visible.size());
    EXPECT_GE(detected.size(), 4);
    EXPECT_TRUE(std::includes(visible.begin(), visible.end(), detected.begin(), detected.end()));
    EXPECT_EQ(std::count(trial.model_line.begin(), trial.model_line.end(), -1), 4);
  }
}

TEST_P(LineTrialTest, TheObjectIsInViewAtTheGivenDistance) {
  const auto trials = Generator(GetParam(), 0.8, 0, 0);
  Eigen::Vector3d sum_of_axes = Eigen::Vector3d::Zero();
  for (int seed = 0; seed < kTrials; ++seed) {
    const RigidTransform pose = trials->Make(seed).camera_from_object;
    sum_of_axes += pose.rotation.col(0);
    for (const Eigen::Vector3d& vertex : trials->model().vertices) {
      const Eigen::Vector3d point = pose * vertex;
      ASSERT_GT(point.z(), 0.0);
      EXPECT_TRUE(trials->camera().IsInImage(trials->camera().Project(point)));
    }
  }
  EXPECT_LT(sum_of_axes.norm() / kTrials, 0.6) << "attitudes are not spread";
}

TEST_P(LineTrialTest, ASeedDeterminesATrial) {
  const auto trials = Generator(GetParam(), 0.8, 2, 1);
  const LineTrial first = trials->Make(7), again = trials->Make(7), other = trials->Make(8);
  EXPECT_EQ(first.camera_from_object.rotation, again.camera_from_object.rotation);
  EXPECT_EQ(first.model_line, again.model_line);
  ASSERT_EQ(first.segments.size(), again.segments.size());
  for (size_t i = 0; i < first.segments.size(); ++i) EXPECT_EQ(first.segments[i].p1_px, again.segments[i].p1_px);
  EXPECT_NE(first.camera_from_object.rotation, other.camera_from_object.rotation);
}

TEST_P(LineTrialTest, ErrorsAreModuloTheSymmetries) {
  const auto trials = Generator(GetParam(), 0.8, 0, 0);
  const LineTrial trial = trials->Make(3);
  for (const RigidTransform& symmetry : trials->model().symmetries) {
    const PoseError error = CompareWithTruth(*trials, trial, trial.camera_from_object * symmetry);
    EXPECT_LT(error.rotation_rad, 1e-6);
    EXPECT_LT(error.translation_ratio, 1e-9);
    EXPECT_LT(error.reprojection_px, 1e-3);
    EXPECT_TRUE(error.is_right());
  }
  Vector6d by = Vector6d::Zero();
  by[3] = 0.03;
  EXPECT_NEAR(CompareWithTruth(*trials, trial, Perturb(trial.camera_from_object, by)).rotation_rad, 0.03, 1e-6);
  EXPECT_TRUE(CompareWithTruth(*trials, trial, Perturb(trial.camera_from_object, by)).is_right());
  by[3] = 0.04;
  EXPECT_FALSE(CompareWithTruth(*trials, trial, Perturb(trial.camera_from_object, by)).is_right());
  by.setZero();
  by[0] = 0.021 * trial.camera_from_object.translation_m.z();
  EXPECT_NEAR(CompareWithTruth(*trials, trial, Perturb(trial.camera_from_object, by)).translation_ratio, 0.021, 1e-9);
  EXPECT_FALSE(CompareWithTruth(*trials, trial, Perturb(trial.camera_from_object, by)).is_right());
}

TEST_P(LineTrialTest, NoiseHasTheGivenStandardDeviation) {
  const auto trials = Generator(GetParam(), 0.8, 0, 0);
  double sum_px2 = 0.0;
  int count = 0;
  for (int seed = 0; seed < kTrials; ++seed) {
    const LineTrial trial = trials->Make(seed);
    for (size_t i = 0; i < trial.segments.size(); ++i) {
      const ModelLine& line = trials->model().lines[trial.model_line[i]];
      const auto projected = ProjectLine(trials->camera(), trial.camera_from_object, line.p1, line.p2);
      for (const Eigen::Vector2d& end : {trial.segments[i].p1_px, trial.segments[i].p2_px}) {
        const Eigen::Vector3d bearing((end.x() - trials->camera().cx_px) / trials->camera().fx_px,
                                      (end.y() - trials->camera().cy_px) / trials->camera().fy_px, 1.0);
        const double d_px = projected->a.dot(bearing);
        sum_px2 += d_px * d_px;
        ++count;
      }
    }
  }
  EXPECT_NEAR(std::sqrt(sum_px2 / count), 0.8, 0.1);
}

INSTANTIATE_TEST_SUITE_P(Objects, LineTrialTest, testing::ValuesIn(kObjects),
                         [](const auto& test) { return std::string(SimulatedObjectName(test.param)); });

TEST(LineTrialGeneratorTest, ViewsFromBehindAreNotDrawn) {
  for (const SimulatedObject object : {SimulatedObject::kPlanar, SimulatedObject::kBook}) {
    const auto trials = Generator(object, 0.8, 0, 0);
    for (int seed = 0; seed < kTrials; ++seed) {
      const RigidTransform pose = trials->Make(seed).camera_from_object;
      // The front faces -z of the object.
      EXPECT_GT(pose.Inverse().translation_m.dot(-Eigen::Vector3d::UnitZ()), 0.0);
    }
  }
}

TEST(LineTrialGeneratorTest, OptionsAreChecked) {
  const auto message = [](const LineTrialOptions& options) {
    const auto generator = LineTrialGenerator::Create(options);
    EXPECT_EQ(generator.status().code(), absl::StatusCode::kInvalidArgument);
    return std::string(generator.status().message());
  };
  EXPECT_THAT(message({SimulatedObject::kCube, -1.0, 0, 0}), testing::HasSubstr("noise_px"));
  EXPECT_THAT(message({SimulatedObject::kCube, 0.8, -1, 0}), testing::HasSubstr("num_spurious"));
  EXPECT_THAT(message({SimulatedObject::kCube, 0.8, 0, 21}), testing::HasSubstr("num_missing"));
  EXPECT_EQ(LineTrialGenerator::Create({SimulatedObject::kCube, 0.8, 0, 9}).status().code(),
            absl::StatusCode::kFailedPrecondition);
}

}  // namespace
}  // namespace evpose

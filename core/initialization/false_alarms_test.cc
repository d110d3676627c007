// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/false_alarms.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <numbers>
#include <vector>

#include "core/initialization/initializer.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

CameraModel SmallCamera() { return {240, 180, 200.0, 200.0, 120.0, 90.0, {}}; }

// Five printed polygons with 3 to 7 sides on a sheet.
ObjectModel Poster() {
  ObjectModel model;
  const Vector2d centres[] = {{-0.3, -0.2}, {0.3, -0.22}, {0.0, 0.03}, {-0.28, 0.24}, {0.31, 0.2}};
  for (int shape = 0; shape < 5; ++shape) {
    const int sides = 3 + shape;
    const auto corner = [&](int i) {
      const double angle = 2.0 * std::numbers::pi * i / sides + 0.4 * shape, radius = 0.1 + 0.02 * (i % 3);
      return Vector3d(centres[shape].x() + radius * std::cos(angle), centres[shape].y() + radius * std::sin(angle), 0);
    };
    for (int i = 0; i < sides; ++i) model.lines.push_back({corner(i), corner(i + 1), {}});
  }
  model.diameter_m = 0.9;
  return model;
}

std::vector<ImageSegment> Clutter(int count, Random& random) {
  std::vector<ImageSegment> segments;
  for (int i = 0; i < count; ++i) {
    const double y = random.Uniform(15.0, 165.0);  // first: the order of arguments depends on the compiler
    const Vector2d middle(random.Uniform(15.0, 225.0), y);
    const double angle = random.Uniform(0.0, std::numbers::pi), half = random.Uniform(8.0, 18.0);
    const Vector2d way(half * std::cos(angle), half * std::sin(angle));
    segments.push_back({middle - way, middle + way});
  }
  return segments;
}

const RigidTransform kPosterPose = {ExpSo3({0.2, -0.15, 0.3}), {0.03, -0.02, 0.9}};

// `count` lines of the poster, as a detector finds them.
void AddLines(const ObjectModel& poster, int count, Random& random, std::vector<ImageSegment>& segments) {
  for (int i = 0; i < count; ++i) {
    const ModelLine& line = poster.lines[size_t{7} * static_cast<size_t>(i) % poster.lines.size()];
    const auto project = [&](const Vector3d& point) -> Vector2d {
      const double x = random.Normal(), y = random.Normal();
      return SmallCamera().Project(kPosterPose * point) + 0.5 * Vector2d(x, y);
    };
    const Vector2d p1 = project(line.p1);
    segments.push_back({p1, project(line.p2)});
  }
}

std::unique_ptr<PoseSearch> PosterSearch() {
  return MakePoseSearch(std::make_shared<ObjectModel>(Poster()), SmallCamera()).value();
}

bool IsPosterPose(const RigidTransform& pose) {
  return RotationAngle(pose.rotation, kPosterPose.rotation) < 0.06 &&
         (pose.translation_m - kPosterPose.translation_m).norm() < 0.05;
}

TEST(FalseAlarms, EightLinesAmongAsManyClutterSegmentsAreSignificant) {
  const auto search = PosterSearch();
  const ObjectModel poster = Poster();
  int num_significant = 0, num_found = 0;
  constexpr int kTrials = 20;
  for (int trial = 0; trial < kTrials; ++trial) {
    Random random(100 + trial);
    std::vector<ImageSegment> segments = Clutter(8, random);
    AddLines(poster, 8, random, segments);
    for (const PoseHypothesis& hypothesis : search->Search(segments)) {
      if (!IsPosterPose(hypothesis.camera_from_object)) continue;
      ++num_found;
      num_significant += hypothesis.expected_false_alarms <= InitializerOptions().max_false_alarms ? 1 : 0;
      break;
    }
  }
  EXPECT_GE(num_found, kTrials - 2);
  EXPECT_GE(num_significant, num_found - 1);
}

TEST(FalseAlarms, ClutterHasAtMostTheStatedNumberOfPoses) {
  const auto search = PosterSearch();
  int num_significant = 0, num_poses = 0;
  constexpr int kTrials = 60;
  for (int trial = 0; trial < kTrials; ++trial) {
    Random random(1 + trial);
    const std::vector<PoseHypothesis> hypotheses = search->Search(Clutter(10 + trial % 12, random));
    for (const PoseHypothesis& hypothesis : hypotheses) {
      ++num_poses;
      num_significant += hypothesis.expected_false_alarms <= InitializerOptions().max_false_alarms ? 1 : 0;
    }
  }
  EXPECT_GT(num_poses, kTrials / 2) << "poses that explain clutter are found, and must be told from right ones";
  EXPECT_LE(num_significant, InitializerOptions().max_false_alarms * kTrials);
}

class ExpectedFalseAlarmsTest : public testing::Test {
 protected:
  ExpectedFalseAlarmsTest() {
    Random random(3);
    segments_ = MakeSearchSegments(SmallCamera(), Clutter(12, random), 1.0, 32);
  }
  double Expected(int num_lines, double across_cost, double lines_per_part = 1.0, double num_symmetries = 1.0) const {
    const std::vector<double> lengths_px(9, 40.0);
    return ExpectedFalseAlarms({num_lines, across_cost}, segments_, lengths_px, lines_per_part, num_symmetries, {});
  }

  std::vector<SearchSegment> segments_;
};

TEST_F(ExpectedFalseAlarmsTest, DecreasesWithTheNumberOfLinesAndTheirCloseness) {
  EXPECT_TRUE(std::isinf(Expected(3, 0.0))) << "some pose fits any three lines";
  for (int num_lines = 5; num_lines < 12; ++num_lines) {
    EXPECT_LT(Expected(num_lines, 6.0), 0.3 * Expected(num_lines - 1, 6.0));
  }
  // Two surplus lines: the number is that of points in a triangle.
  EXPECT_NEAR(Expected(5, 6.0) / Expected(5, 3.0), 4.0, 1e-9);
  EXPECT_EQ(Expected(5, 32.0), Expected(5, 40.0)) << "not closer than chance matches";
}

TEST_F(ExpectedFalseAlarmsTest, CountsTheTriplesOfAllLinesModuloTheSymmetries) {
  EXPECT_NEAR(Expected(6, 6.0, 2.0) / Expected(6, 6.0), 8.0, 1e-9);
  EXPECT_NEAR(Expected(6, 6.0) / Expected(6, 6.0, 1.0, 24.0), 24.0, 1e-9);
}

TEST_F(ExpectedFalseAlarmsTest, IsTheFormulaOfTheReadme) {
  // Four equal segments of 20 px on a square of 200 px, one line of 30 px: each may lie anywhere along 10 px and 12 px
  // beyond either end.
  std::vector<ImageSegment> square = {
      {{0, 0}, {20, 0}}, {{180, 200}, {200, 200}}, {{0, 180}, {0, 200}}, {{200, 0}, {200, 20}}};
  const std::vector<SearchSegment> segments = MakeSearchSegments(SmallCamera(), square, 1.0, 32);
  ASSERT_EQ(segments.size(), 4u);
  const double side = 200.0 + 2.0 * 12.0, chord = std::numbers::pi * side / 4.0, range = 10.0 + 2.0 * 12.0;
  const double triples = 8.0 / 6.0 * std::pow(4.0 * range / chord, 3.0);
  const double chance = 8.0 / 10.0 * range / (side * side);
  const std::vector<double> lengths_px = {30.0};
  EXPECT_NEAR(ExpectedFalseAlarms({4, 4.0}, segments, lengths_px, 1.0, 1.0, {}) / (triples * chance * 4.0 / 16.0), 1.0,
              1e-9);
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/initializer.h"

#include <gtest/gtest.h>

#include "core/geometry/projected_line.h"

namespace evpose {
namespace {

const CameraModel kCamera = {1280, 720, 1000.0, 1010.0, 640.0, 360.0, {}};
const RigidTransform kPose = {ExpSo3({0.5, 0.4, -0.2}), {0.05, -0.03, 0.9}};

ObjectModel Wires() {
  ObjectModel model;
  const Eigen::Vector3d corners[] = {{0, 0, 0}, {0.2, 0, 0}, {0, 0.15, 0}, {0, 0, 0.1}, {0.2, 0.15, 0.1}};
  for (int i = 0; i < 5; ++i) {
    for (int j = i + 1; j < 5; ++j) model.lines.push_back({corners[i], corners[j], {}});
  }
  model.diameter_m = 0.27;
  return model;
}

Vector6d SomeTwist() {
  Vector6d twist;
  twist << 0.3, -0.2, 0.15, 0.7, -0.9, 0.4;
  return twist;
}

// The model's lines as a detector would return them at both ends of an interval centred at the pose's time.
LineDetection Moving(const ObjectModel& model, const Vector6d& twist, int64_t duration_us) {
  const double half_s = 0.5e-6 * static_cast<double>(duration_us);
  LineDetection detection{0, duration_us, {}};
  for (const ModelLine& line : model.lines) {
    const auto begin = ProjectLine(kCamera, Perturb(kPose, -half_s * twist), line.p1, line.p2);
    const auto end = ProjectLine(kCamera, Perturb(kPose, half_s * twist), line.p1, line.p2);
    DetectedLine detected;
    detected.at_begin = {begin->p1_px, begin->p2_px};
    detected.at_end = {end->p1_px, end->p2_px};
    detected.normal_velocity_px_per_s = 400.0;
    detection.lines.push_back(detected);
  }
  return detection;
}

std::vector<int> InOrder(size_t count) {
  std::vector<int> numbers;
  for (size_t i = 0; i < count; ++i) numbers.push_back(static_cast<int>(i));
  return numbers;
}

TEST(EstimateTwist, IsWhatMovedTheLines) {
  const ObjectModel model = Wires();
  const LineDetection detection = Moving(model, SomeTwist(), 10'000);
  const TwistEstimate estimate =
      EstimateTwist(model, kCamera, kPose, detection, InOrder(model.lines.size()), InitializerOptions());
  EXPECT_LT((estimate.twist - SomeTwist()).head<3>().norm(), 0.01) << estimate.twist.transpose();
  EXPECT_LT((estimate.twist - SomeTwist()).tail<3>().norm(), 0.05) << estimate.twist.transpose();
}

TEST(EstimateTwist, IsTheSameWhicheverWayTheSegmentsRun) {
  const ObjectModel model = Wires();
  LineDetection detection = Moving(model, SomeTwist(), 10'000);
  const std::vector<int> numbers = InOrder(model.lines.size());
  const TwistEstimate forward = EstimateTwist(model, kCamera, kPose, detection, numbers, InitializerOptions());
  for (DetectedLine& line : detection.lines) {
    std::swap(line.at_begin.p1_px, line.at_begin.p2_px);
    std::swap(line.at_end.p1_px, line.at_end.p2_px);
  }
  const TwistEstimate backward = EstimateTwist(model, kCamera, kPose, detection, numbers, InitializerOptions());
  EXPECT_LT((forward.twist - backward.twist).norm(), 1e-9);
}

TEST(EstimateTwist, EqualsThePriorInUnobservedDirections) {
  const ObjectModel model = Wires();
  const LineDetection detection = Moving(model, SomeTwist(), 10'000);
  std::vector<int> numbers(model.lines.size(), -1);
  const InitializerOptions options;
  const TwistEstimate nothing = EstimateTwist(model, kCamera, kPose, detection, numbers, options);
  EXPECT_EQ(nothing.twist.norm(), 0.0);
  EXPECT_NEAR(std::sqrt(nothing.covariance(5, 5)), options.twist_prior.angular_velocity_rad_per_s, 1e-9);

  numbers[0] = 0;
  numbers[1] = 1;
  const TwistEstimate little = EstimateTwist(model, kCamera, kPose, detection, numbers, options);
  EXPECT_TRUE(little.twist.allFinite());
  EXPECT_LT(little.covariance.determinant(), nothing.covariance.determinant());
  EXPECT_GT(little.covariance.trace(), 0.1 * nothing.covariance.trace());
}

TEST(EstimateTwist, ADetectionWithoutDurationGivesThePrior) {
  const ObjectModel model = Wires();
  LineDetection detection = Moving(model, SomeTwist(), 10'000);
  detection.t_end_us = detection.t_begin_us;
  const TwistEstimate estimate =
      EstimateTwist(model, kCamera, kPose, detection, InOrder(model.lines.size()), InitializerOptions());
  EXPECT_EQ(estimate.twist.norm(), 0.0);
}

class FixedDetector : public LineDetector {
 public:
  explicit FixedDetector(LineDetection detection) : detection_(std::move(detection)) {}
  LineDetection Detect(absl::Span<const PixelEvent>) override { return detection_; }

 private:
  LineDetection detection_;
};

// A search that returns one given hypothesis and stores the segments that it received.
class FixedSearch : public PoseSearch {
 public:
  FixedSearch(PoseHypothesis hypothesis, std::vector<ImageSegment>& received)
      : hypothesis_(std::move(hypothesis)), received_(received) {}
  std::vector<PoseHypothesis> Search(absl::Span<const ImageSegment> segments) const override {
    received_.assign(segments.begin(), segments.end());
    return {hypothesis_};
  }

 private:
  const PoseHypothesis hypothesis_;
  std::vector<ImageSegment>& received_;
};

TEST(PoseInitializer, SearchesWithTheLinesAtTheMiddleOfTheirTime) {
  auto model = std::make_shared<const ObjectModel>(Wires());
  const LineDetection detection = Moving(*model, SomeTwist(), 10'000);
  std::vector<ImageSegment> received;
  PoseHypothesis hypothesis{kPose, 3.5, InOrder(model->lines.size()), 10};
  PoseInitializer initializer(model, kCamera, {std::make_shared<FixedDetector>(detection)},
                              std::make_unique<FixedSearch>(hypothesis, received));
  const FirstPoses first = initializer.Find({});
  EXPECT_EQ(first.num_lines, 10);
  ASSERT_EQ(first.poses.size(), 1u);
  EXPECT_EQ(first.poses[0].t_us, 5000);
  EXPECT_LT((first.poses[0].twist - SomeTwist()).head<3>().norm(), 0.01);
  ASSERT_EQ(received.size(), 10u);
  for (size_t k = 0; k < received.size(); ++k) {
    const auto middle = ProjectLine(kCamera, kPose, model->lines[k].p1, model->lines[k].p2);
    EXPECT_LT((received[k].p1_px - middle->p1_px).norm(), 0.05);
    EXPECT_LT((received[k].p2_px - middle->p2_px).norm(), 0.05);
  }
}

TEST(PoseInitializer, RejectsPosesThatRandomSegmentsWouldGive) {
  auto model = std::make_shared<const ObjectModel>(Wires());
  const LineDetection detection = Moving(*model, SomeTwist(), 10'000);
  std::vector<ImageSegment> received;
  const double bound = InitializerOptions().max_false_alarms;
  for (const auto& [expected_false_alarms, is_plausible] : {std::pair{0.9 * bound, true}, {1.1 * bound, false}}) {
    PoseHypothesis hypothesis{kPose, 3.5, InOrder(model->lines.size()), 10};
    hypothesis.expected_false_alarms = expected_false_alarms;
    PoseInitializer initializer(model, kCamera, {std::make_shared<FixedDetector>(detection)},
                                std::make_unique<FixedSearch>(hypothesis, received));
    const FirstPoses first = initializer.Find({});
    EXPECT_TRUE(first.has_moved);
    EXPECT_EQ(first.poses.size(), is_plausible ? 1u : 0u) << expected_false_alarms;
  }
}

TEST(PoseInitializer, WaitsUntilTheLinesHaveMoved) {
  auto model = std::make_shared<const ObjectModel>(Wires());
  LineDetection detection = Moving(*model, SomeTwist(), 10'000);
  for (DetectedLine& line : detection.lines) line.normal_velocity_px_per_s = -90.0;
  std::vector<ImageSegment> received;
  PoseHypothesis hypothesis{kPose, 3.5, InOrder(model->lines.size()), 10};
  PoseInitializer initializer(model, kCamera, {std::make_shared<FixedDetector>(detection)},
                              std::make_unique<FixedSearch>(hypothesis, received));
  const FirstPoses first = initializer.Find({});
  EXPECT_EQ(first.num_lines, 10);
  EXPECT_NEAR(first.motion_px, 0.9, 1e-9);
  EXPECT_TRUE(first.poses.empty());
  EXPECT_TRUE(received.empty());
}

}  // namespace
}  // namespace evpose

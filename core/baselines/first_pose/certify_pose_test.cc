// SPDX-License-Identifier: Apache-2.0
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <vector>

#include "core/baselines/first_pose/published_bnb.h"
#include "core/initialization/pose_search.h"

namespace evpose {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using ::testing::HasSubstr;

const CameraModel kCamera = {1280, 720, 1030.0, 1030.0, 640.0, 360.0, {}};

// Wires in seven directions; none is occluded.
ObjectModel Wires() {
  ObjectModel model;
  const Vector3d corners[] = {{-0.1, -0.08, 0.03}, {0.1, -0.07, -0.05}, {0.08, 0.1, 0.06}, {-0.09, 0.06, -0.08}};
  for (int i = 0; i < 4; ++i) {
    for (int j = i + 1; j < 4; ++j) model.lines.push_back({corners[i], corners[j], {}});
  }
  model.lines.push_back({{0.0, 0.0, -0.1}, {0.02, -0.05, 0.1}, {}});
  model.diameter_m = 0.3;
  return model;
}

std::vector<ImageSegment> Project(const ObjectModel& model, const RigidTransform& pose) {
  std::vector<ImageSegment> segments;
  for (const ModelLine& line : model.lines) {
    segments.push_back({kCamera.Project(pose * line.p1), kCamera.Project(pose * line.p2)});
  }
  return segments;
}

RigidTransform Truth() { return {ExpSo3({0.4, -0.3, 0.8}), Vector3d(0.03, -0.02, 0.8)}; }

TEST(CertifyPose, ExactPoseOfASearchAttainsTheMaximum) {
  const ObjectModel model = Wires();
  const std::vector<ImageSegment> segments = Project(model, Truth());
  const auto search = MakePoseSearch(std::make_shared<const ObjectModel>(model), kCamera);
  ASSERT_TRUE(search.ok()) << search.status();
  const std::vector<PoseHypothesis> hypotheses = (*search)->Search(segments);
  ASSERT_FALSE(hypotheses.empty());
  const auto certificate = CertifyPose(model, kCamera, segments, hypotheses[0].camera_from_object);
  ASSERT_TRUE(certificate.ok()) << certificate.status();
  EXPECT_EQ(certificate->optimality, RotationOptimality::kMaximum);
  EXPECT_EQ(certificate->count, 7);
  EXPECT_EQ(certificate->upper_bound, 7);
}

TEST(CertifyPose, WrongRotationIsRefutedByABetterOne) {
  const ObjectModel model = Wires();
  const std::vector<ImageSegment> segments = Project(model, Truth());
  RigidTransform wrong = Truth();
  wrong.rotation = wrong.rotation * ExpSo3({0.5, 0.4, -0.3});
  const auto certificate = CertifyPose(model, kCamera, segments, wrong);
  ASSERT_TRUE(certificate.ok()) << certificate.status();
  EXPECT_EQ(certificate->optimality, RotationOptimality::kNotMaximum);
  EXPECT_LT(certificate->count, 7);
  const RigidTransform better = {certificate->better, wrong.translation_m};
  const auto again = CertifyPose(model, kCamera, segments, better);
  ASSERT_TRUE(again.ok()) << again.status();
  EXPECT_GT(again->count, certificate->count);
}

TEST(CertifyPose, SpentBudgetIsUnknown) {
  // One spurious line: an upper bound of all eight lines must be refuted first.
  std::vector<ImageSegment> segments = Project(Wires(), Truth());
  segments.push_back({Vector2d(500.0, 100.0), Vector2d(430.0, 170.0)});
  RotationBnbOptions options;
  options.max_branches = 1;
  const auto certificate = CertifyPose(Wires(), kCamera, segments, Truth(), options);
  ASSERT_TRUE(certificate.ok()) << certificate.status();
  EXPECT_EQ(certificate->optimality, RotationOptimality::kUnknown);
  EXPECT_GT(certificate->upper_bound, certificate->count);
}

TEST(CertifyPose, SegmentsOfZeroLengthAreIgnored) {
  std::vector<ImageSegment> segments = Project(Wires(), Truth());
  segments.push_back({Vector2d(500.0, 100.0), Vector2d(500.0, 100.0)});
  const auto certificate = CertifyPose(Wires(), kCamera, segments, Truth());
  ASSERT_TRUE(certificate.ok()) << certificate.status();
  EXPECT_EQ(certificate->count, 7);
  EXPECT_EQ(certificate->optimality, RotationOptimality::kMaximum);
}

TEST(CertifyPose, RejectsInvalidArguments) {
  const ObjectModel model = Wires();
  const std::vector<ImageSegment> segments = Project(model, Truth());
  const auto message = [](const auto& certificate) {
    EXPECT_EQ(certificate.status().code(), absl::StatusCode::kInvalidArgument);
    return std::string(certificate.status().message());
  };
  EXPECT_THAT(message(CertifyPose(model, kCamera, {}, Truth())), HasSubstr("normals"));
  RigidTransform mirrored = Truth();
  mirrored.rotation.col(0) *= -1.0;
  EXPECT_THAT(message(CertifyPose(model, kCamera, segments, mirrored)), HasSubstr("rotation"));
  ObjectModel parallel = model;
  parallel.lines = {model.lines[0], model.lines[0], model.lines[0]};
  EXPECT_THAT(message(CertifyPose(parallel, kCamera, segments, Truth())), HasSubstr("directions"));
  RotationBnbOptions options;
  options.inlier_rad = -1.0;
  EXPECT_THAT(message(CertifyPose(model, kCamera, segments, Truth(), options)), HasSubstr("inlier_rad"));
}

}  // namespace
}  // namespace evpose

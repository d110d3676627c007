// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/pose_frame.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <string>

#include "client/lib/core_types.h"
#include "core/base/output_file.h"
#include "core/numerics/random.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

Pose SomeFramedPose() {
  Pose pose;
  pose.camera_from_object = {ExpSo3({0.1, -0.8, 0.3}), {0.1, -0.3, 1.5}};
  pose.twist << 0.1, 0.2, -0.3, 1.0, -2.0, 0.5;
  pose.alternatives.push_back({{ExpSo3({0.4, 0.0, 0.3}), {0.1, -0.2, 1.6}}, -1.0});
  return pose;
}

// The frames of the tests with the map from camera_from_object to the written transform.
RigidTransform Mount() { return {ExpSo3({-0.4, 0.2, 1.0}), {3.0, 2.0, 1.0}}; }
RigidTransform InFrame(const PoseFrame& frame, const RigidTransform& pose) {
  return frame.transform() == kObjectFromCamera ? pose.Inverse() : Mount() * pose;
}
std::vector<PoseFrame> Frames() { return {PoseFrame::ObjectFromCamera(), PoseFrame::WorldFromObject(Mount(), "base")}; }

TEST(PoseFrameTest, TransformsPoseAndAlternatives) {
  const Pose pose = SomeFramedPose();
  for (const PoseFrame& frame : Frames()) {
    const Pose out = frame.Apply(pose);
    EXPECT_LT(Difference(ToCore(out.camera_from_object), InFrame(frame, ToCore(pose.camera_from_object))).norm(),
              1e-14);
    EXPECT_LT(Difference(ToCore(out.alternatives.at(0).camera_from_object),
                         InFrame(frame, ToCore(pose.alternatives[0].camera_from_object)))
                  .norm(),
              1e-14);
    EXPECT_EQ(out.alternatives[0].log_likelihood_ratio, -1.0);
  }
  EXPECT_EQ(PoseFrame().Apply(pose).twist, pose.twist);
}

// The covariance of many perturbed poses after the transform, and the derivative of the transformed pose along the
// twist.
TEST(PoseFrameTest, CovarianceAndTwistAreThoseOfTheWrittenTransform) {
  Pose pose = SomeFramedPose();
  const RigidTransform camera_from_object = ToCore(pose.camera_from_object);
  Matrix6d root = Matrix6d::Zero();
  Random random(7);
  for (int i = 0; i < 6; ++i) {
    for (int k = 0; k <= i; ++k) root(i, k) = 1e-4 * random.Normal();
  }
  pose.covariance = root * root.transpose();
  for (const PoseFrame& frame : Frames()) {
    const RigidTransform centre = InFrame(frame, camera_from_object);
    const Pose out = frame.Apply(pose);
    Matrix6d sum = Matrix6d::Zero();
    constexpr int kSamples = 20'000;
    for (int i = 0; i < kSamples; ++i) {
      Vector6d normal;
      for (double& value : normal) value = random.Normal();
      const Vector6d error = Difference(InFrame(frame, Perturb(camera_from_object, root * normal)), centre);
      sum += error * error.transpose();
    }
    // Relative to the predicted covariance the sample's is the identity, with 1 / sqrt(samples) errors.
    const Matrix6d whitened = out.covariance.llt().matrixL().solve(sum / kSamples);
    const Matrix6d ratio = out.covariance.llt().matrixL().solve(whitened.transpose());
    EXPECT_LT((ratio - Matrix6d::Identity()).cwiseAbs().maxCoeff(), 0.05) << frame.transform();

    constexpr double kStep = 1e-6;
    const Vector6d twist = Difference(InFrame(frame, Perturb(camera_from_object, kStep * pose.twist)),
                                      InFrame(frame, Perturb(camera_from_object, -kStep * pose.twist))) /
                           (2.0 * kStep);
    EXPECT_LT((twist - out.twist).norm(), 1e-7) << frame.transform();
    EXPECT_EQ(out.covariance, out.covariance.transpose().eval());
  }
}

TEST(PoseFrameTest, ArgumentsChooseTheFrame) {
  EXPECT_EQ(PoseFrameArguments().Read()->transform(), "camera_from_object");
  EXPECT_EQ((PoseFrameArguments{.pose = "object-from-camera"}.Read()->transform()), "object_from_camera");
  const std::string path = ::testing::TempDir() + "/pose_frame_test.txt";
  ASSERT_TRUE(WriteFile(path, "1 2 3 0 0 0 1\n").ok());
  EXPECT_EQ((PoseFrameArguments{.world_from_camera = path}.Read()->transform()), "world_from_object");
  ASSERT_TRUE(WriteFile(path, "frame_id: base\ntranslation: [1, 2, 3]\nrotation: [0, 0, 0, 1]\n").ok());
  EXPECT_EQ((PoseFrameArguments{.world_from_camera = path}.Read()->transform()), "base_from_object");
  ASSERT_TRUE(WriteFile(path, "1 2 3\n").ok());
  EXPECT_THAT((PoseFrameArguments{.world_from_camera = path}.Read().status().message()),
              HasSubstr(path + ": has 3 numbers"));
}

TEST(PoseFrameTest, DescriptionsDifferWithTheNumbers) {
  RigidTransform other = Mount();
  other.translation_m.x() += 1e-12;
  EXPECT_NE(PoseFrame::WorldFromObject(other, "base").Description(),
            PoseFrame::WorldFromObject(Mount(), "base").Description());
  EXPECT_NE(PoseFrame::ObjectFromCamera().Description(), PoseFrame().Description());
}

}  // namespace
}  // namespace evpose::client

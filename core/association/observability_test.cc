// SPDX-License-Identifier: Apache-2.0
#include "core/association/observability.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "core/estimation/ideal_events_testing.h"

namespace evpose {
namespace {

using testing::MakeCamera;
using testing::MakePose;

class ObservabilityTest : public ::testing::Test {
 protected:
  static constexpr double kRadiusM = 0.05;

  // Adds a ring of chords about the z axis at the height `z_m`.
  void AddRing(double z_m, double ring_radius_m) {
    constexpr int kChords = 60;
    for (int i = 0; i < kChords; ++i) {
      const double begin = 2.0 * M_PI * i / kChords, end = 2.0 * M_PI * (i + 1) / kChords;
      TrackedLine& chord = lines_.emplace_back();
      chord.p1 = {ring_radius_m * std::cos(begin), ring_radius_m * std::sin(begin), z_m};
      chord.p2 = {ring_radius_m * std::cos(end), ring_radius_m * std::sin(end), z_m};
      chord.is_element = true;
    }
  }
  void AddLine(const Eigen::Vector3d& p1, const Eigen::Vector3d& p2) {
    TrackedLine& line = lines_.emplace_back();
    line.p1 = p1;
    line.p2 = p2;
  }
  Matrix6d Information(double events_per_line) const {
    std::vector<ImageLine> images;
    MotionState state;
    state.camera_from_object = pose_;
    ProjectLines(camera_, state, lines_, images);
    const Matrix6d motions = OutlineMotions(camera_, pose_, Eigen::Vector3d::Zero(), kRadiusM);
    Matrix6d information = Matrix6d::Zero();
    for (const ImageLine& line : images) AddInformation(camera_, line, events_per_line, motions, information);
    return information;
  }

  const CameraModel camera_ = MakeCamera(640, 480, 600.0);
  const RigidTransform pose_ = MakePose({0.02, -0.01, 0.5}, {1.0, 0.5, 0.2});
  std::vector<TrackedLine> lines_;
};

TEST_F(ObservabilityTest, RingsDoNotShowTheTurnAboutTheirAxis) {
  AddRing(-0.03, kRadiusM);
  AddRing(0.03, 0.5 * kRadiusM);
  const Matrix6d information = Information(100.0);
  EXPECT_FALSE(IsDetermined(information, Eigen::Matrix3Xd(3, 0), 12.0));
  ObjectModel round;
  round.continuous_symmetry = {ContinuousSymmetry::Kind::kAxis, {0, 0, 0}, {0, 0, 1}, false};
  EXPECT_TRUE(IsDetermined(information, FreeRotations(round, pose_.rotation), 12.0));
  AddLine({kRadiusM, 0.0, -0.03}, {kRadiusM, 0.0, 0.03});
  EXPECT_TRUE(IsDetermined(Information(100.0), Eigen::Matrix3Xd(3, 0), 12.0));
}

TEST_F(ObservabilityTest, TheDeviationIsThatOfTheEvents) {
  // A line along the x axis of the camera, through the centre, determines the translation along y. The information is
  // the number of events, because OutlineMotions() move an outline by 1 px.
  AddLine(pose_.rotation.transpose() * Eigen::Vector3d(-0.05, 0, 0),
          pose_.rotation.transpose() * Eigen::Vector3d(0.05, 0, 0));
  const Matrix6d information = Information(40.0);
  EXPECT_NEAR(information(1, 1), 40.0, 1e-6);
  EXPECT_NEAR(information(0, 0), 0.0, 1e-6);
  EXPECT_FALSE(IsDetermined(information, Eigen::Matrix3Xd(3, 0), 1e6));
  const Matrix6d all = 4.0 * Matrix6d::Identity();
  EXPECT_TRUE(IsDetermined(all, Eigen::Matrix3Xd(3, 0), 0.51));
  EXPECT_FALSE(IsDetermined(all, Eigen::Matrix3Xd(3, 0), 0.49));
  Matrix6d weak = 1e6 * all;
  weak(5, 5) = 90.0;
  EXPECT_FALSE(IsDetermined(weak, Eigen::Matrix3Xd(3, 0), 12.0)) << "errors of the derivatives of the other motions";
}

TEST_F(ObservabilityTest, ThePartIsComparedForEachMotion) {
  const Eigen::Matrix3Xd none(3, 0);
  Matrix6d whole = 10.0 * Matrix6d::Identity(), part = whole;
  part(5, 5) = 4.0;
  EXPECT_TRUE(IsAtLeast(part, 0.35, whole, none));
  EXPECT_FALSE(IsAtLeast(part, 0.6, whole, none));
  EXPECT_TRUE(IsAtLeast(part, 0.6, whole, Eigen::Vector3d::UnitZ()));
  whole(5, 5) = part(5, 5) = 0.0;
  EXPECT_TRUE(IsAtLeast(part, 0.6, whole, none)) << "no line shows this motion";
}

TEST_F(ObservabilityTest, ASphereHasThreeFreeRotations) {
  ObjectModel sphere;
  EXPECT_EQ(FreeRotations(sphere, pose_.rotation).cols(), 0);
  sphere.continuous_symmetry = {ContinuousSymmetry::Kind::kSphere, {0, 0, 0}, {0, 0, 1}, false};
  EXPECT_EQ(FreeRotations(sphere, pose_.rotation).cols(), 3);
}

}  // namespace
}  // namespace evpose

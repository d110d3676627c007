// SPDX-License-Identifier: Apache-2.0
#include "client/lib/messages/core_types.h"

#include <gtest/gtest.h>

namespace evpose::client {
namespace {

TEST(CoreTypesTest, DefaultSensorIsTheDefaultOfCore) {
  SensorProfile expected;
  expected.name.clear();
  EXPECT_EQ(ToCore(SensorParameters()), expected);
}

TEST(CoreTypesTest, EachSensorParameterIsConverted) {
  const SensorParameters sensor{0.6, 0.7, 0.2, 90.0, 120.0, 0.4};
  const SensorProfile profile = ToCore(sensor);
  EXPECT_EQ(profile.pixel_noise_px, 0.6);
  EXPECT_EQ(profile.blur_px, 0.7);
  EXPECT_EQ(profile.contrast_threshold, 0.2);
  EXPECT_EQ(profile.refractory_us, 90.0);
  EXPECT_EQ(profile.latency_us, 120.0);
  EXPECT_EQ(profile.uncertainty, 0.4);
  EXPECT_EQ(FromCore(profile), sensor);
}

TEST(CoreTypesTest, CameraIsConvertedBothWays) {
  const Camera camera{640, 480, 500.0, 501.0, 320.0, 240.0, {0.1, 0.2, 0.3, 0.4, 0.5, 0.6}, LensModel::kRational};
  const CameraModel core = ToCore(camera);
  EXPECT_EQ(core.height_px, 480);
  EXPECT_EQ(core.fy_px, 501.0);
  EXPECT_EQ(core.lens_model, evpose::LensModel::kRational);
  EXPECT_EQ(core.distortion[4], 0.5);
  EXPECT_EQ(FromCore(core), camera);
}

TEST(CoreTypesTest, TransformKeepsItsBits) {
  const RigidTransform core{ExpSo3({0.1, -0.2, 0.3}), {0.1, 1.0 / 3.0, 1.5}};
  const Transform transform = FromCore(core);
  EXPECT_EQ(transform.rotation, core.rotation);
  EXPECT_EQ(transform.translation_m, core.translation_m);
  EXPECT_EQ(transform.Quaternion().coeffs(), core.Quaternion().coeffs());
  EXPECT_EQ(ToCore(transform).rotation, core.rotation);
}

TEST(CoreTypesTest, EncodingsHaveTheNamesOfCore) {
  for (const Encoding encoding :
       {Encoding::kEvt3, Encoding::kEvt21, Encoding::kEvt2, Encoding::kDat, Encoding::kFlat64}) {
    EXPECT_EQ(EventEncodingName(FromCore(encoding)), EncodingName(encoding));
    EXPECT_EQ(ToCore(FromCore(encoding)), encoding);
  }
}

TEST(CoreTypesTest, ServersOfferAllEstimatorsButThoseOfTheReleasedCode) {
  for (const auto& [estimator, name] : kEstimatorNames) {
    EXPECT_EQ(FromCore(estimator).has_value(), !name.starts_with("released-")) << name;
  }
  EXPECT_EQ(FromCore(Estimator::kStaticMm), PoseEstimator::kStaticMm);
}

TEST(CoreTypesTest, APoseAtAnotherTimeFollowsItsTwist) {
  Pose pose;
  pose.t_us = 1'000'000;
  pose.camera_from_object.translation_m = {0.1, -0.2, 1.5};
  pose.camera_from_object.rotation = Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitX()).toRotationMatrix();
  pose.twist << 2.0, 0.0, -1.0, 0.0, 0.0, 10.0;
  const Transform same = pose.At(pose.t_us);
  EXPECT_EQ(same.translation_m, pose.camera_from_object.translation_m);
  EXPECT_TRUE(same.rotation.isApprox(pose.camera_from_object.rotation, 1e-15));
  for (const double dt_s : {0.01, -0.02}) {
    const Transform other = pose.At(pose.t_us + static_cast<int64_t>(1e6 * dt_s));
    EXPECT_TRUE(other.translation_m.isApprox(Eigen::Vector3d(0.1 + 2.0 * dt_s, -0.2, 1.5 - dt_s), 1e-14)) << dt_s;
    const Eigen::Matrix3d turn = Eigen::AngleAxisd(10.0 * dt_s, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    EXPECT_TRUE(other.rotation.isApprox(turn * pose.camera_from_object.rotation, 1e-14)) << dt_s;
  }
}

TEST(CoreTypesTest, StatesHaveTheNamesOfTheApi) {
  EXPECT_EQ(TrackStateName(TrackState::kUnknown), "UNKNOWN");
  EXPECT_EQ(TrackStateName(TrackState::kInitializing), "INITIALIZING");
  EXPECT_EQ(TrackStateName(TrackState::kTracking), "TRACKING");
  EXPECT_EQ(TrackStateName(TrackState::kDegraded), "DEGRADED");
  EXPECT_EQ(TrackStateName(TrackState::kLost), "LOST");
  EXPECT_EQ(TrackStateName(TrackState::kAmbiguous), "AMBIGUOUS");
  EXPECT_EQ(LossCauseName(LossCause::kUnknown), "UNKNOWN");
  EXPECT_EQ(LossCauseName(LossCause::kUnconfirmed), "UNCONFIRMED");
  EXPECT_EQ(SessionStateName(SessionState::kUnknown), "UNKNOWN");
  EXPECT_EQ(SessionStateName(SessionState::kAttached), "ATTACHED");
  EXPECT_EQ(InitializationStatusName(InitializationStatus::kNotNeeded), "NOT_NEEDED");
  EXPECT_EQ(InitializationStatusName(InitializationStatus::kWaitingForEvents), "WAITING_FOR_EVENTS");
  EXPECT_EQ(InitializationStatusName(InitializationStatus::kTooFewLines), "TOO_FEW_LINES");
  EXPECT_EQ(InitializationStatusName(InitializationStatus::kNoPoseFits), "NO_POSE_FITS");
  EXPECT_EQ(InitializationStatusName(InitializationStatus::kVerifying), "VERIFYING");
  EXPECT_EQ(InitializationStatusName(InitializationStatus::kAmbiguous), "AMBIGUOUS");
  EXPECT_EQ(InitializationStatusName(InitializationStatus::kNotSearchable), "NOT_SEARCHABLE");
  EXPECT_EQ(InitializationStatusName(InitializationStatus::kNotEnoughMotion), "NOT_ENOUGH_MOTION");
  EXPECT_EQ(InitializationStatusName(InitializationStatus::kTooSmall), "TOO_SMALL");
  EXPECT_EQ(InitializationStatusName(InitializationStatus::kNotSupported), "NOT_SUPPORTED");
}

}  // namespace
}  // namespace evpose::client

#include "client/lib/conversion.h"

#include <gtest/gtest.h>

#include <utility>

namespace evpose::client {
namespace {

TEST(ConversionTest, ModelTellsOfItsSymmetries) {
  v1::Model message;
  message.set_num_symmetries(24);
  EXPECT_EQ(FromProto(message).num_symmetries, 24u);
}

TEST(ConversionTest, ConfigKeepsTheReferenceRotationAndAnAbsentPose) {
  SessionConfig config;
  config.objects.resize(2);
  config.objects[0].object_id = "plain";
  config.objects[1].object_id = "turned";
  config.objects[1].reference_rotation = ExpSo3({0.3, -2.0, 1.0});
  v1::Session message;
  *message.mutable_config() = ToProto(config);
  EXPECT_FALSE(message.config().objects(0).has_reference_rotation());
  EXPECT_FALSE(message.config().objects(0).has_initial_camera_from_object());
  const absl::StatusOr<Session> session = FromProto(message);
  ASSERT_TRUE(session.ok()) << session.status();
  EXPECT_FALSE(session->config.objects[0].reference_rotation.has_value());
  EXPECT_FALSE(session->config.objects[0].initial_camera_from_object.has_value());
  ASSERT_TRUE(session->config.objects[1].reference_rotation.has_value());
  EXPECT_TRUE(session->config.objects[1].reference_rotation->isApprox(*config.objects[1].reference_rotation, 1e-12));

  message.mutable_config()->mutable_objects(1)->mutable_reference_rotation()->set_w(2.0);
  EXPECT_EQ(FromProto(message).status().code(), absl::StatusCode::kInternal);
}

TEST(ConversionTest, ASensorProfileComesBackButForItsName) {
  SessionConfig config;
  config.sensor = {"", 0.6, 0.7, 0.2, 90.0, 120.0};
  v1::Session message;
  *message.mutable_config() = ToProto(config);
  const absl::StatusOr<Session> session = FromProto(message);
  ASSERT_TRUE(session.ok()) << session.status();
  EXPECT_EQ(session->config.sensor, config.sensor);
}

TEST(ConversionTest, HealthSaysWhyThereIsNoPose) {
  v1::SessionHealth message;
  for (const auto& [theirs, ours] :
       {std::pair{v1::INITIALIZATION_STATUS_NOT_NEEDED, InitializationStatus::kNotNeeded},
        {v1::INITIALIZATION_STATUS_WAITING_FOR_EVENTS, InitializationStatus::kWaitingForEvents},
        {v1::INITIALIZATION_STATUS_TOO_FEW_LINES, InitializationStatus::kTooFewLines},
        {v1::INITIALIZATION_STATUS_NO_POSE_FITS, InitializationStatus::kNoPoseFits},
        {v1::INITIALIZATION_STATUS_VERIFYING, InitializationStatus::kVerifying},
        {v1::INITIALIZATION_STATUS_AMBIGUOUS, InitializationStatus::kAmbiguous}}) {
    message.clear_objects();
    v1::ObjectHealth& object = *message.add_objects();
    object.set_object_id("cube");
    object.set_state(v1::TRACK_STATE_INITIALIZING);
    object.set_initialization(theirs);
    object.set_initialization_attempts(7);
    object.set_detail("why");
    const SessionHealth health = FromProto(message);
    ASSERT_EQ(health.objects.size(), 1u);
    EXPECT_EQ(health.objects[0].object_id, "cube");
    EXPECT_EQ(health.objects[0].initialization, ours);
    EXPECT_EQ(health.objects[0].initialization_attempts, 7u);
    EXPECT_EQ(health.objects[0].detail, "why");
  }
}

}  // namespace
}  // namespace evpose::client

// SPDX-License-Identifier: Apache-2.0
#include "client/lib/conversion.h"

#include <gtest/gtest.h>

#include <utility>

#include "client/lib/status_details.h"
#include "core/geometry/rigid_transform.h"

namespace evpose::client {
namespace {

TEST(ConversionTest, ModelHasItsSymmetries) {
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

TEST(ConversionTest, ASensorProfileRoundTripsExceptForItsName) {
  SessionConfig config;
  config.sensor = {0.6, 0.7, 0.2, 90.0, 120.0};
  v1::Session message;
  *message.mutable_config() = ToProto(config);
  const absl::StatusOr<Session> session = FromProto(message);
  ASSERT_TRUE(session.ok()) << session.status();
  EXPECT_EQ(session->config.sensor, config.sensor);
}

TEST(ConversionTest, AnOverloadPolicyRoundTripsWithItsLag) {
  SessionConfig config;
  v1::Session message;
  *message.mutable_config() = ToProto(config);
  EXPECT_EQ(message.config().overload_policy(), v1::OVERLOAD_POLICY_BLOCK);
  EXPECT_FALSE(message.config().has_max_lag());
  config.overload_policy = OverloadPolicy::kLatest;
  config.max_lag = absl::Milliseconds(1500);
  *message.mutable_config() = ToProto(config);
  EXPECT_EQ(message.config().max_lag().seconds(), 1);
  EXPECT_EQ(message.config().max_lag().nanos(), 500'000'000);
  const absl::StatusOr<Session> session = FromProto(message);
  ASSERT_TRUE(session.ok()) << session.status();
  EXPECT_EQ(session->config.overload_policy, OverloadPolicy::kLatest);
  EXPECT_EQ(session->config.max_lag, config.max_lag);
}

TEST(ConversionTest, ReasonsOfLaterServersAreUnspecified) {
  for (const auto& [name, reason] : {std::pair{"SEQ_GAP", v1::SEQ_GAP},
                                     {"", v1::ERROR_REASON_UNSPECIFIED},
                                     {"OF_A_LATER_SERVER", v1::ERROR_REASON_UNSPECIFIED}}) {
    absl::Status status = absl::InternalError("what");
    SetDetails(status, {.reason = name});
    EXPECT_EQ(ReasonOf(status), reason) << name;
  }
}

TEST(ConversionTest, DroppedEventsAreConverted) {
  for (const auto& [theirs, ours] : {std::pair{v1::DROP_REASON_LAG, DropReason::kLag},
                                     {v1::DROP_REASON_MEMORY, DropReason::kMemory},
                                     {v1::DROP_REASON_READER, DropReason::kReader},
                                     {v1::DROP_REASON_UNSPECIFIED, DropReason::kUnknown}}) {
    v1::TrackResponse::Notice message;
    message.mutable_dropped()->set_num_events(3);
    message.mutable_dropped()->set_from_t_us(4);
    message.mutable_dropped()->set_to_t_us(5);
    message.mutable_dropped()->set_reason(theirs);
    const std::optional<Notice> notice = FromProto(message);
    ASSERT_TRUE(notice.has_value());
    const auto& dropped = std::get<EventsDropped>(*notice);
    EXPECT_EQ(dropped.num_events, 3u);
    EXPECT_EQ(dropped.from_t_us, 4);
    EXPECT_EQ(dropped.to_t_us, 5);
    EXPECT_EQ(dropped.reason, ours);
  }
  v1::SessionHealth health;
  health.set_skipped_events(7);
  health.set_skipped_us(8);
  EXPECT_EQ(FromProto(health).skipped_events, 7u);
  EXPECT_EQ(FromProto(health).skipped_us, 8);
}

TEST(ConversionTest, AStateOfALaterServerIsUnknown) {
  v1::SessionHealth message;
  message.add_objects()->set_state(static_cast<v1::TrackState>(99));
  const SessionHealth health = FromProto(message);
  ASSERT_EQ(health.objects.size(), 1u);
  EXPECT_EQ(health.objects[0].state, TrackState::kUnknown);
}

TEST(ConversionTest, HealthHasTheReasonForAMissingPose) {
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

// SPDX-License-Identifier: Apache-2.0
#include "client/lib/messages/conversion.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <utility>
#include <vector>

#include "client/lib/messages/status_details.h"
#include "core/geometry/rigid_transform.h"
#include "google/protobuf/generated_enum_reflection.h"
#include "google/rpc/error_details.pb.h"
#include "google/rpc/status.pb.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

// Compares the enumerators of a public enumeration, in the order of their numbers, with all those of the API.
template <typename Theirs, typename Ours>
void ExpectNumbersOfTheApi(const std::vector<std::pair<Ours, Theirs>>& enumerators) {
  for (const auto& [ours, theirs] : enumerators) EXPECT_EQ(static_cast<int>(ours), theirs);
  EXPECT_EQ(google::protobuf::GetEnumDescriptor<Theirs>()->value_count(), 1 + static_cast<int>(enumerators.size()));
}

TEST(ConversionTest, EnumeratorsHaveTheNumbersOfTheApi) {
  ExpectNumbersOfTheApi<v1::EventEncoding, EventEncoding>({{EventEncoding::kEvt3, v1::EVENT_ENCODING_EVT3},
                                                           {EventEncoding::kEvt21, v1::EVENT_ENCODING_EVT21},
                                                           {EventEncoding::kEvt2, v1::EVENT_ENCODING_EVT2},
                                                           {EventEncoding::kDat, v1::EVENT_ENCODING_DAT},
                                                           {EventEncoding::kFlat64, v1::EVENT_ENCODING_FLAT64}});
  ExpectNumbersOfTheApi<v1::LensModel, LensModel>({{LensModel::kBrown, v1::LENS_MODEL_BROWN},
                                                   {LensModel::kRational, v1::LENS_MODEL_RATIONAL},
                                                   {LensModel::kFisheye, v1::LENS_MODEL_FISHEYE}});
  ExpectNumbersOfTheApi<v1::ModelFormat, ModelFormat>({{ModelFormat::kObj, v1::MODEL_FORMAT_OBJ},
                                                       {ModelFormat::kPly, v1::MODEL_FORMAT_PLY},
                                                       {ModelFormat::kStl, v1::MODEL_FORMAT_STL},
                                                       {ModelFormat::kMesh, v1::MODEL_FORMAT_MESH}});
  ExpectNumbersOfTheApi<v1::ModelSurface, ModelSurface>(
      {{ModelSurface::kSmooth, v1::MODEL_SURFACE_SMOOTH}, {ModelSurface::kAsIs, v1::MODEL_SURFACE_AS_IS}});
  ExpectNumbersOfTheApi<v1::TrackState, TrackState>({{TrackState::kInitializing, v1::TRACK_STATE_INITIALIZING},
                                                     {TrackState::kTracking, v1::TRACK_STATE_TRACKING},
                                                     {TrackState::kDegraded, v1::TRACK_STATE_DEGRADED},
                                                     {TrackState::kLost, v1::TRACK_STATE_LOST},
                                                     {TrackState::kAmbiguous, v1::TRACK_STATE_AMBIGUOUS}});
  ExpectNumbersOfTheApi<v1::InitializationStatus, InitializationStatus>(
      {{InitializationStatus::kNotNeeded, v1::INITIALIZATION_STATUS_NOT_NEEDED},
       {InitializationStatus::kWaitingForEvents, v1::INITIALIZATION_STATUS_WAITING_FOR_EVENTS},
       {InitializationStatus::kTooFewLines, v1::INITIALIZATION_STATUS_TOO_FEW_LINES},
       {InitializationStatus::kNoPoseFits, v1::INITIALIZATION_STATUS_NO_POSE_FITS},
       {InitializationStatus::kVerifying, v1::INITIALIZATION_STATUS_VERIFYING},
       {InitializationStatus::kAmbiguous, v1::INITIALIZATION_STATUS_AMBIGUOUS},
       {InitializationStatus::kNotSearchable, v1::INITIALIZATION_STATUS_NOT_SEARCHABLE},
       {InitializationStatus::kNotEnoughMotion, v1::INITIALIZATION_STATUS_NOT_ENOUGH_MOTION},
       {InitializationStatus::kTooSmall, v1::INITIALIZATION_STATUS_TOO_SMALL},
       {InitializationStatus::kNotSupported, v1::INITIALIZATION_STATUS_NOT_SUPPORTED}});
  ExpectNumbersOfTheApi<v1::LossCause, LossCause>({{LossCause::kContradicted, v1::LOSS_CAUSE_CONTRADICTED},
                                                   {LossCause::kUncertain, v1::LOSS_CAUSE_UNCERTAIN},
                                                   {LossCause::kOutOfView, v1::LOSS_CAUSE_OUT_OF_VIEW},
                                                   {LossCause::kBetterPose, v1::LOSS_CAUSE_BETTER_POSE},
                                                   {LossCause::kOccupied, v1::LOSS_CAUSE_OCCUPIED},
                                                   {LossCause::kUnconfirmed, v1::LOSS_CAUSE_UNCONFIRMED}});
  ExpectNumbersOfTheApi<v1::LogLevel, LogLevel>({{LogLevel::kDebug, v1::LOG_LEVEL_DEBUG},
                                                 {LogLevel::kInfo, v1::LOG_LEVEL_INFO},
                                                 {LogLevel::kWarning, v1::LOG_LEVEL_WARNING},
                                                 {LogLevel::kError, v1::LOG_LEVEL_ERROR},
                                                 {LogLevel::kOff, v1::LOG_LEVEL_OFF}});
  ExpectNumbersOfTheApi<v1::Estimator, PoseEstimator>(
      {{PoseEstimator::kMixture, v1::ESTIMATOR_MIXTURE},
       {PoseEstimator::kStaticLs, v1::ESTIMATOR_STATIC_LS},
       {PoseEstimator::kStaticM, v1::ESTIMATOR_STATIC_M},
       {PoseEstimator::kStaticS, v1::ESTIMATOR_STATIC_S},
       {PoseEstimator::kStaticMm, v1::ESTIMATOR_STATIC_MM},
       {PoseEstimator::kErrorStateFilter, v1::ESTIMATOR_ERROR_STATE_FILTER}});
  ExpectNumbersOfTheApi<v1::OverloadPolicy, OverloadPolicy>(
      {{OverloadPolicy::kBlock, v1::OVERLOAD_POLICY_BLOCK}, {OverloadPolicy::kLatest, v1::OVERLOAD_POLICY_LATEST}});
  ExpectNumbersOfTheApi<v1::DropReason, DropReason>({{DropReason::kLag, v1::DROP_REASON_LAG},
                                                     {DropReason::kMemory, v1::DROP_REASON_MEMORY},
                                                     {DropReason::kReader, v1::DROP_REASON_READER}});
  ExpectNumbersOfTheApi<v1::SessionState, SessionState>({{SessionState::kDetached, v1::SESSION_STATE_DETACHED},
                                                         {SessionState::kAttached, v1::SESSION_STATE_ATTACHED},
                                                         {SessionState::kEnded, v1::SESSION_STATE_ENDED}});
}

TEST(ConversionTest, AStoreHasTheNameOfTheApi) {
  for (const auto& [theirs, name] : {std::pair{v1::STORE_KIND_MEMORY, "memory"},
                                     {v1::STORE_KIND_SQLITE, "sqlite"},
                                     {v1::STORE_KIND_REDIS, "redis"},
                                     {static_cast<v1::StoreKind>(99), "unknown"},
                                     {v1::STORE_KIND_UNSPECIFIED, "unknown"}}) {
    v1::ServerInfo message;
    message.set_store(theirs);
    EXPECT_EQ(FromProto(message).store, name);
  }
}

TEST(ConversionTest, ServerInfoHasTheTimeIfTheServerStatesIt) {
  v1::ServerInfo message;
  EXPECT_EQ(FromProto(message).time, std::nullopt);
  message.mutable_time()->set_seconds(7);
  EXPECT_EQ(FromProto(message).time, absl::FromUnixSeconds(7));
}

TEST(ConversionTest, ModelHasItsSymmetries) {
  v1::Model message;
  message.set_num_symmetries(24);
  EXPECT_EQ(FromProto(message).num_symmetries, 24u);
  message.set_num_curves(7);
  message.set_num_regions(9);
  message.set_file_name("cube.obj");
  EXPECT_EQ(FromProto(message).num_curves, 7u);
  EXPECT_EQ(FromProto(message).num_regions, 9u);
  EXPECT_EQ(FromProto(message).file_name, "cube.obj");
}

TEST(ConversionTest, ModelHasItsContinuousSymmetry) {
  v1::Model message;
  EXPECT_FALSE(FromProto(message).continuous_symmetry.has_value());
  v1::ContinuousSymmetry& symmetry = *message.mutable_continuous_symmetry();
  symmetry.mutable_centre_m()->set_x(0.25);
  symmetry.mutable_axis()->set_y(1.0);
  symmetry.set_flippable(true);
  for (const auto& [theirs, ours] : {std::pair{v1::ContinuousSymmetry::KIND_AXIS, ContinuousSymmetry::Kind::kAxis},
                                     {v1::ContinuousSymmetry::KIND_SPHERE, ContinuousSymmetry::Kind::kSphere}}) {
    symmetry.set_kind(theirs);
    const ModelInfo model = FromProto(message);
    ASSERT_TRUE(model.continuous_symmetry.has_value());
    EXPECT_EQ(model.continuous_symmetry->kind, ours);
    EXPECT_EQ(static_cast<int>(ours), static_cast<int>(theirs));
    EXPECT_EQ(model.continuous_symmetry->centre_m, Eigen::Vector3d(0.25, 0, 0));
    EXPECT_EQ(model.continuous_symmetry->axis, Eigen::Vector3d(0, 1, 0));
    EXPECT_TRUE(model.continuous_symmetry->is_flippable);
  }
  symmetry.set_kind(static_cast<v1::ContinuousSymmetry::Kind>(99));
  EXPECT_FALSE(FromProto(message).continuous_symmetry.has_value());
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

TEST(ConversionTest, AnErrorHasItsFieldAndWhatIsWrongWithIt) {
  const auto details_of = [](const char* description) {
    google::rpc::BadRequest bad_request;
    google::rpc::BadRequest::FieldViolation& violation = *bad_request.add_field_violations();
    violation.set_field("header.size_bytes");
    violation.set_description(description);
    google::rpc::Status details;
    details.add_details()->PackFrom(bad_request);
    const absl::Status status = FromGrpc(
        grpc::Status(grpc::StatusCode::INVALID_ARGUMENT, "header.size_bytes: is 0", details.SerializeAsString()),
        "server:1");
    return GetDetails(WithMessage(status, "another text"));
  };
  EXPECT_EQ(details_of("header.size_bytes: is 0").field, "header.size_bytes");
  EXPECT_EQ(details_of("header.size_bytes: is 0").field_error, "is 0");
  EXPECT_EQ(details_of("is 0").field_error, "is 0");
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

TEST(ConversionTest, ProcessorTimeIsConverted) {
  v1::SessionHealth message;
  v1::ProcessingHealth& theirs = *message.mutable_processing();
  theirs.set_cpu_s_per_s(0.5);
  theirs.set_max_cpu_s_per_s(1.0);
  theirs.set_falls_behind(true);
  theirs.set_tenant_cpu_s_per_s(1.5);
  theirs.set_max_tenant_cpu_s_per_s(2.0);
  const ProcessingHealth processing = FromProto(message).processing;
  EXPECT_EQ(processing.cpu_s_per_s, 0.5);
  EXPECT_EQ(processing.max_cpu_s_per_s, 1.0);
  EXPECT_TRUE(processing.falls_behind);
  EXPECT_EQ(processing.tenant_cpu_s_per_s, 1.5);
  EXPECT_EQ(processing.max_tenant_cpu_s_per_s, 2.0);
}

TEST(ConversionTest, Triggers) {
  v1::TrackResponse::Notice message;
  v1::TrackResponse::Triggers& triggers = *message.mutable_triggers();
  triggers.set_seq(9);
  triggers.set_num_skipped(2);
  triggers.add_triggers()->set_t_us(16'000'001);
  triggers.mutable_triggers(0)->set_input(6);
  triggers.mutable_triggers(0)->set_rising(true);
  const std::optional<Notice> notice = FromProto(message);
  ASSERT_TRUE(notice.has_value());
  const auto& ours = std::get<client::Triggers>(*notice);
  EXPECT_EQ(ours.chunk_seq, 9u);
  EXPECT_EQ(ours.num_skipped, 2u);
  ASSERT_EQ(ours.triggers.size(), 1u);
  EXPECT_EQ(ours.triggers[0].t_us, 16'000'001);
  EXPECT_EQ(ours.triggers[0].input, 6u);
  EXPECT_TRUE(ours.triggers[0].is_rising);
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
        {v1::INITIALIZATION_STATUS_AMBIGUOUS, InitializationStatus::kAmbiguous},
        {v1::INITIALIZATION_STATUS_NOT_SEARCHABLE, InitializationStatus::kNotSearchable},
        {v1::INITIALIZATION_STATUS_NOT_ENOUGH_MOTION, InitializationStatus::kNotEnoughMotion},
        {v1::INITIALIZATION_STATUS_TOO_SMALL, InitializationStatus::kTooSmall},
        {v1::INITIALIZATION_STATUS_NOT_SUPPORTED, InitializationStatus::kNotSupported}}) {
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
    EXPECT_FALSE(health.objects[0].latest_loss.has_value());
  }
}

TEST(ConversionTest, HealthHasTheLatestLossAndTheSearches) {
  v1::SessionHealth message;
  v1::ObjectHealth& object = *message.add_objects();
  object.mutable_latest_loss()->set_t_us(12);
  object.mutable_latest_loss()->set_cause(v1::LOSS_CAUSE_OUT_OF_VIEW);
  object.mutable_searches()->set_too_small(3);
  object.mutable_searches()->set_poses_found(4);
  object.set_followed_poses(2);
  const ObjectHealth health = FromProto(message).objects.at(0);
  ASSERT_TRUE(health.latest_loss.has_value());
  EXPECT_EQ(health.latest_loss->t_us, 12);
  EXPECT_EQ(health.latest_loss->cause, LossCause::kOutOfView);
  EXPECT_EQ(health.searches.too_small, 3u);
  EXPECT_EQ(health.searches.poses_found, 4u);
  EXPECT_EQ(health.followed_poses, 2u);
  message.mutable_objects(0)->mutable_latest_loss()->set_cause(static_cast<v1::LossCause>(99));
  EXPECT_EQ(FromProto(message).objects.at(0).latest_loss->cause, LossCause::kUnknown);
}

TEST(ConversionTest, APoseHasItsAlternativesAndTheLatestLoss) {
  v1::Pose message;
  message.mutable_covariance()->mutable_upper_triangle()->Resize(21, 0.0);
  message.mutable_twist()->mutable_linear_m_per_s();
  message.mutable_camera_from_object()->mutable_rotation()->set_w(1.0);
  message.mutable_camera_from_object()->mutable_translation_m()->set_z(1.0);
  message.set_state(v1::TRACK_STATE_AMBIGUOUS);
  v1::PoseAlternative& alternative = *message.add_alternatives();
  alternative.mutable_camera_from_object()->mutable_rotation()->set_x(1.0);
  alternative.mutable_camera_from_object()->mutable_translation_m()->set_z(2.0);
  alternative.set_log_likelihood_ratio(-1.5);
  const absl::StatusOr<Pose> pose = FromProto(message);
  ASSERT_TRUE(pose.ok()) << pose.status();
  EXPECT_EQ(pose->state, TrackState::kAmbiguous);
  ASSERT_EQ(pose->alternatives.size(), 1u);
  EXPECT_EQ(pose->alternatives[0].log_likelihood_ratio, -1.5);
  EXPECT_EQ(pose->alternatives[0].camera_from_object.translation_m.z(), 2.0);
  EXPECT_FALSE(pose->latest_loss.has_value());
  message.mutable_latest_loss()->set_t_us(12);
  message.mutable_latest_loss()->set_cause(v1::LOSS_CAUSE_UNCERTAIN);
  EXPECT_TRUE(FromProto(message)->latest_loss == (Loss{12, LossCause::kUncertain}));
  alternative.mutable_camera_from_object()->mutable_rotation()->set_x(0.0);
  EXPECT_THAT(FromProto(message).status().message(), HasSubstr("alternatives"));
}

}  // namespace
}  // namespace evpose::client

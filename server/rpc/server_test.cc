// SPDX-License-Identifier: Apache-2.0

// Tests the addresses and the unary calls of a server.
#include "server/rpc/server.h"

#include <grpcpp/generic/generic_stub.h>

#include <limits>

#include "absl/strings/escaping.h"
#include "core/base/version.h"
#include "core/numerics/hash.h"
#include "grpc/health/v1/health.grpc.pb.h"
#include "server/rpc/server_testing.h"

namespace evpose::server {
namespace {

class ServerTest : public RpcTest {};

TEST_F(ServerTest, CreatesAndDescribesASession) {
  CreatedSession created;
  ASSERT_EQ(Describe(Create(CreateRequest(), &created)), "OK");
  EXPECT_THAT(created.name(), testing::MatchesRegex("sessions/[0-9a-f]{32}"));
  EXPECT_EQ(created.resume_token().size(), 32u);
  EXPECT_EQ(created.config().tracker().estimator(), v1::ESTIMATOR_MIXTURE) << "the effective configuration";
  EXPECT_EQ(created.config().tracker().pose_rate_hz(), 1000.0);
  EXPECT_EQ(created.config().camera().distortion_size(), 5);
  EXPECT_EQ(created.config().objects(0).reference_rotation().w(), 1.0);
  EXPECT_EQ(created.state(), v1::SESSION_STATE_DETACHED);
  EXPECT_GT(created.expire_time().seconds(), created.create_time().seconds());

  CreatedSession found;
  ASSERT_EQ(Describe(Get(created.name(), &found)), "OK");
  EXPECT_EQ(found.config().SerializeAsString(), created.config().SerializeAsString());
  EXPECT_EQ(found.health().objects(0).state(), v1::TRACK_STATE_TRACKING);
  EXPECT_EQ(Describe(Delete(created.name())), "OK");
  EXPECT_EQ(Describe(Delete(created.name())), "NOT_FOUND SESSION_NOT_FOUND");
  EXPECT_EQ(Describe(Delete(created.name(), true)), "OK") << "allow_missing";
  EXPECT_EQ(Describe(Get(created.name(), &found)), "NOT_FOUND SESSION_NOT_FOUND");
}

TEST_F(ServerTest, ASensorProfileIsReturnedWithDefaultsFilledIn) {
  auto request = CreateRequest();
  request.mutable_config()->mutable_tracker()->mutable_sensor()->set_blur_px(0.75);
  CreatedSession created;
  ASSERT_EQ(Describe(Create(request, &created)), "OK");
  const v1::SensorProfile& sensor = created.config().tracker().sensor();
  EXPECT_EQ(sensor.blur_px(), 0.75);
  EXPECT_EQ(sensor.contrast_threshold(), SensorProfile().contrast_threshold);
  EXPECT_EQ(sensor.latency_us(), SensorProfile().latency_us);
  EXPECT_EQ(sensor.uncertainty(), SensorProfile().uncertainty);
  EXPECT_EQ(sensor.pixel_noise_px(), SensorProfile().pixel_noise_px);
}

TEST_F(ServerTest, ReturnsTheEffectiveOverloadPolicy) {
  EXPECT_EQ(CreateSession().config().overload_policy(), v1::OVERLOAD_POLICY_BLOCK);
  v1::CreateSessionRequest request = CreateRequest();
  request.mutable_config()->set_overload_policy(v1::OVERLOAD_POLICY_LATEST);
  CreatedSession session;
  ASSERT_EQ(Describe(Create(request, &session)), "OK");
  EXPECT_EQ(session.config().overload_policy(), v1::OVERLOAD_POLICY_LATEST);
  EXPECT_EQ(session.config().max_lag().nanos(), 20'000'000);
  request.mutable_config()->mutable_max_lag()->set_seconds(10);
  ASSERT_EQ(Describe(Create(request, &session)), "OK");
  EXPECT_EQ(session.config().max_lag().seconds(), 10);
}

TEST_F(ServerTest, APoseRateBeyondItsLimitsIsRefused) {
  for (const double pose_rate_hz : {0.0, 999.0, 10'001.0, std::nan("")}) {
    auto request = CreateRequest();
    request.mutable_config()->mutable_tracker()->set_pose_rate_hz(pose_rate_hz);
    CreatedSession created;
    const grpc::Status status = Create(request, &created);
    EXPECT_EQ(status.error_code(), grpc::StatusCode::INVALID_ARGUMENT) << pose_rate_hz;
    EXPECT_THAT(status.error_message(), testing::HasSubstr("config.tracker.pose_rate_hz")) << pose_rate_hz;
  }
}

TEST_F(ServerTest, NamesTheFieldOfABadConfiguration) {
  using Spoil = std::function<void(v1::SessionConfig&)>;
  const std::vector<std::pair<std::string, Spoil>> cases = {
      {"config.encoding", [](auto& config) { config.clear_encoding(); }},
      {"config.encoding", [](auto& config) { config.set_encoding(static_cast<v1::EventEncoding>(99)); }},
      {"config.tracker.estimator",
       [](auto& config) { config.mutable_tracker()->set_estimator(static_cast<v1::Estimator>(99)); }},
      {"config.tracker.sensor", [](auto& config) { config.mutable_tracker()->mutable_sensor()->set_blur_px(-1.0); }},
      {"config.tracker.sensor",
       [](auto& config) { config.mutable_tracker()->mutable_sensor()->set_latency_us(std::nan("")); }},
      {"config.overload_policy", [](auto& config) { config.set_overload_policy(static_cast<v1::OverloadPolicy>(99)); }},
      {"config.max_lag", [](auto& config) { config.mutable_max_lag()->set_seconds(1); }},  // with BLOCK
      {"config.max_lag",
       [](auto& config) {
         config.set_overload_policy(v1::OVERLOAD_POLICY_LATEST);
         config.mutable_max_lag()->set_nanos(999'999);
       }},
      {"config.max_lag",
       [](auto& config) {
         config.set_overload_policy(v1::OVERLOAD_POLICY_LATEST);
         config.mutable_max_lag()->set_seconds(std::numeric_limits<int64_t>::max());
       }},
      {"config.camera", [](auto& config) { config.clear_camera(); }},
      {"config.camera", [](auto& config) { config.mutable_camera()->set_width_px(0); }},
      {"config.camera", [](auto& config) { config.mutable_camera()->set_width_px(4'000'000'000u); }},
      {"config.camera", [](auto& config) { config.mutable_camera()->set_fx_px(std::nan("")); }},
      {"config.camera", [](auto& config) { config.mutable_camera()->set_fx_px(1e300); }},
      {"config.camera",
       [](auto& config) {
         config.set_encoding(v1::EVENT_ENCODING_EVT3);
         config.mutable_camera()->set_width_px(5000);  // EVT3 addresses 2048 columns
       }},
      {"config.camera.distortion", [](auto& config) { config.mutable_camera()->add_distortion(0.1); }},
      {"config.camera.distortion",
       [](auto& config) {
         config.mutable_camera()->set_lens_model(v1::LENS_MODEL_FISHEYE);
         for (int i = 0; i < 5; ++i) config.mutable_camera()->add_distortion(0.0);
       }},
      {"config.camera.lens_model",
       [](auto& config) { config.mutable_camera()->set_lens_model(static_cast<v1::LensModel>(99)); }},
      {"config.objects", [](auto& config) { config.clear_objects(); }},
      {"config.objects",
       [](auto& config) {
         for (int i = 1; i < 17; ++i) {
           *config.add_objects() = config.objects(0);
           config.mutable_objects(i)->set_object_id(absl::StrCat("cube", i));
         }
       }},
      {"config.objects[0].object_id", [](auto& config) { config.mutable_objects(0)->clear_object_id(); }},
      {"config.objects[0].object_id",
       [](auto& config) { config.mutable_objects(0)->set_object_id(std::string(65, 'x')); }},
      {"config.objects[0].object_id",
       [](auto& config) { config.mutable_objects(0)->set_object_id("cube\xe2\x80\xae"); }},
      {"config.objects[0].model", [](auto& config) { config.mutable_objects(0)->clear_model(); }},
      {"config.objects[1].object_id", [](auto& config) { *config.add_objects() = config.objects(0); }},
      {"config.objects[0].initial_camera_from_object.rotation",
       [](auto& config) {
         config.mutable_objects(0)->mutable_initial_camera_from_object()->mutable_rotation()->set_w(0.9);
       }},
      {"config.objects[0].initial_camera_from_object.translation_m",
       [](auto& config) {
         config.mutable_objects(0)->mutable_initial_camera_from_object()->mutable_translation_m()->set_x(std::nan(""));
       }},
      {"config.objects[0].reference_rotation",
       [](auto& config) { config.mutable_objects(0)->mutable_reference_rotation()->set_w(1.0011); }},
      {"config.objects[0].reference_rotation",
       [](auto& config) { config.mutable_objects(0)->mutable_reference_rotation()->set_x(std::nan("")); }},
      {"config.objects[0].reference_rotation",
       [](auto& config) { config.mutable_objects(0)->mutable_reference_rotation(); }},
  };
  for (const auto& [field, spoil] : cases) {
    v1::CreateSessionRequest request = CreateRequest();
    spoil(*request.mutable_config());
    CreatedSession session;
    const grpc::Status status = Create(request, &session);
    EXPECT_EQ(Describe(status), "INVALID_ARGUMENT " + field) << status.error_message();
    EXPECT_THAT(status.error_message(), testing::StartsWith(field));
  }
}

TEST_F(ServerTest, KeepsTheReferenceRotation) {
  v1::CreateSessionRequest request = CreateRequest();
  v1::Quaternion& rotation = *request.mutable_config()->mutable_objects(0)->mutable_reference_rotation();
  rotation.set_x(0.6);
  rotation.set_z(-0.8);
  CreatedSession session;
  ASSERT_EQ(Describe(Create(request, &session)), "OK");
  const v1::Quaternion& kept = session.config().objects(0).reference_rotation();
  // A quaternion and its negative are the same rotation.
  EXPECT_NEAR(std::abs(kept.x() * 0.6 - kept.z() * 0.8), 1.0, 1e-12);
}

TEST_F(ServerTest, RefusesObjectsThatDoNotDetermineAPose) {
  v1::Model model;
  ASSERT_EQ(Describe(Upload(UploadRequests("v 0 0 0\nv 1 0 0\nv 0 1 0\nl 1 2\nl 1 3\n"), &model)), "OK");
  v1::CreateSessionRequest request = CreateRequest();
  request.mutable_config()->mutable_objects(0)->set_model(model.name());
  CreatedSession session;
  const grpc::Status status = Create(request, &session);
  EXPECT_EQ(Describe(status), "INVALID_ARGUMENT config.objects[0].model");
  EXPECT_THAT(status.error_message(), testing::HasSubstr("2 distinct lines"));
}

TEST_F(ServerTest, HealthHasTheReasonForAMissingPose) {
  CreatedSession session;
  ASSERT_EQ(Describe(Create(CreateRequest(), &session)), "OK");
  EXPECT_EQ(session.health().objects(0).initialization(), v1::INITIALIZATION_STATUS_NOT_NEEDED);
  EXPECT_EQ(session.health().objects(0).detail(), "");

  v1::CreateSessionRequest request = CreateRequest();
  request.mutable_config()->mutable_objects(0)->clear_initial_camera_from_object();
  ASSERT_EQ(Describe(Create(request, &session)), "OK");
  const auto track = Attached(session);
  track->Events(1, Flat64(SomeEvents(1, 3)));
  track->End();
  v1::TrackResponse response;
  ASSERT_TRUE(track->ReadUntil(v1::TrackResponse::kSummary, response));
  const v1::ObjectHealth& health = response.summary().health().objects(0);
  EXPECT_EQ(health.state(), v1::TRACK_STATE_INITIALIZING);
  EXPECT_EQ(health.initialization(), v1::INITIALIZATION_STATUS_TOO_FEW_LINES);
  EXPECT_EQ(health.initialization_attempts(), 6u);
  EXPECT_THAT(health.detail(), testing::HasSubstr("too few lines in the events: 2"));
}

TEST_F(ServerTest, RefusesUnknownModelsLongRequestIdsAndReusedOnes) {
  v1::CreateSessionRequest request = CreateRequest();
  CreatedSession session;
  request.mutable_config()->mutable_objects(0)->set_model("models/none");
  EXPECT_EQ(Describe(Create(request, &session)), "NOT_FOUND MODEL_NOT_FOUND");
  request = CreateRequest();
  request.set_request_id(std::string(129, 'x'));
  EXPECT_EQ(Describe(Create(request, &session)), "INVALID_ARGUMENT request_id");

  request.set_request_id("mine");
  ASSERT_EQ(Describe(Create(request, &session)), "OK");
  CreatedSession again;
  ASSERT_EQ(Describe(Create(request, &again)), "OK");
  EXPECT_EQ(again.name(), session.name());
  EXPECT_EQ(again.resume_token(), session.resume_token());
  request.mutable_config()->mutable_camera()->set_fx_px(400);
  EXPECT_EQ(Describe(Create(request, &again)), "ALREADY_EXISTS REQUEST_ID_REUSED");
}

TEST_F(ServerTest, TheNumberOfSessionsIsLimited) {
  for (uint32_t i = 0; i < Options().max_sessions; ++i) CreateSession();
  CreatedSession session;
  const grpc::Status status = Create(CreateRequest(), &session);
  EXPECT_EQ(Describe(status), "RESOURCE_EXHAUSTED TOO_MANY_SESSIONS");
  EXPECT_EQ(DetailOf<google::rpc::QuotaFailure>(status).violations(0).subject(), "max_sessions");
  EXPECT_GT(DetailOf<google::rpc::RetryInfo>(status).retry_delay().seconds(), 0);
}

TEST_F(ServerTest, ListsSessionsInPages) {
  for (int i = 0; i < 3; ++i) CreateSession();
  std::vector<std::string> names;
  v1::ListSessionsRequest request;
  request.set_page_size(2);
  do {
    grpc::ClientContext context;
    v1::ListSessionsResponse response;
    ASSERT_EQ(Describe(sessions_->ListSessions(&context, request, &response)), "OK");
    EXPECT_LE(response.sessions_size(), 2);
    for (const auto& session : response.sessions()) {
      names.push_back(session.name());
    }
    request.set_page_token(response.next_page_token());
  } while (!request.page_token().empty());
  EXPECT_EQ(names.size(), 3u);
  EXPECT_TRUE(std::is_sorted(names.begin(), names.end()));

  v1::ListSessionsResponse response;
  grpc::ClientContext negative;
  request.set_page_size(-1);
  EXPECT_EQ(Describe(sessions_->ListSessions(&negative, request, &response)), "INVALID_ARGUMENT page_size");
  grpc::ClientContext strange;
  request.set_page_size(1);
  request.set_page_token("42");
  EXPECT_EQ(Describe(sessions_->ListSessions(&strange, request, &response)), "INVALID_ARGUMENT page_token");
}

TEST_F(ServerTest, NoSessionStartsAfterADrain) {
  const CreatedSession session = CreateSession();
  const v1::CreateSessionRequest request = CreateRequest();
  grpc::ClientContext drain_context, poses_context, health_context;
  v1::DrainResponse drained;
  ASSERT_EQ(Describe(admin_->Drain(&drain_context, {}, &drained)), "OK");
  CreatedSession refused;
  EXPECT_EQ(Describe(Create(request, &refused)), "UNAVAILABLE DRAINING");
  v1::Model model;
  EXPECT_EQ(Describe(Upload(UploadRequests(kCubeObj), &model)), "UNAVAILABLE DRAINING");
  RawTrack track(*sessions_);
  track.Attach(session.name(), session.resume_token());
  EXPECT_EQ(Describe(track.Finish()), "UNAVAILABLE DRAINING");
  v1::WatchPosesRequest poses;
  poses.set_session(session.name());
  EXPECT_EQ(Describe(sessions_->WatchPoses(&poses_context, poses)->Finish()), "UNAVAILABLE DRAINING");
  v1::WatchHealthRequest health;
  health.set_session(session.name());
  EXPECT_EQ(Describe(sessions_->WatchHealth(&health_context, health)->Finish()), "UNAVAILABLE DRAINING");
}

TEST_F(ServerTest, ReturnsServerInfo) {
  CreateSession();
  grpc::ClientContext context;
  v1::ServerInfo info;
  ASSERT_TRUE(admin_->GetServerInfo(&context, {}, &info).ok());
  EXPECT_NEAR(static_cast<double>(info.time().seconds()), absl::ToDoubleSeconds(absl::Now() - absl::UnixEpoch()), 60.0);
  EXPECT_EQ(info.active_sessions(), 1u);
  EXPECT_EQ(info.max_sessions(), 4u);
  EXPECT_EQ(info.store(), v1::STORE_KIND_MEMORY);
  EXPECT_EQ(info.max_chunk_bytes(), 64u * 1024);
  EXPECT_EQ(info.session_expiry().seconds(), 600);
  EXPECT_FALSE(info.draining());
  EXPECT_NE(info.version(), "");
  EXPECT_EQ(info.commit(), ThisBuild().commit);
}

TEST_F(ServerTest, DrainNotifiesTheStreamsAndTheProgram) {
  std::vector<absl::Duration> deadlines;
  ServerOptions options = Options();
  options.on_drain = [&deadlines](absl::Duration deadline) { deadlines.push_back(deadline); };
  Connect(options);
  const auto track = Attached(CreateSession());
  const v1::CreateSessionRequest create = CreateRequest();
  RawTrack unattached(*sessions_);
  v1::DrainRequest request;
  v1::DrainResponse response;
  const auto drain = [&] {
    grpc::ClientContext context;
    return Describe(admin_->Drain(&context, request, &response));
  };
  request.mutable_timeout()->set_nanos(-1);
  EXPECT_EQ(drain(), "INVALID_ARGUMENT timeout");
  EXPECT_TRUE(deadlines.empty());
  request.mutable_timeout()->set_nanos(0);
  request.mutable_timeout()->set_seconds(7);
  EXPECT_EQ(drain(), "OK");
  EXPECT_EQ(response.remaining_sessions(), 1u);
  EXPECT_EQ(drain(), "OK");
  EXPECT_THAT(deadlines, testing::ElementsAre(absl::Seconds(7))) << "the callback runs once";
  EXPECT_EQ(Describe(unattached.Finish()), "UNAVAILABLE DRAINING");
  v1::TrackResponse notice;
  ASSERT_TRUE(track->ReadUntil(v1::TrackResponse::kNotice, notice));
  EXPECT_EQ(notice.notice().go_away().deadline().seconds(), 7);
  CreatedSession refused;
  EXPECT_EQ(Describe(Create(create, &refused)), "UNAVAILABLE DRAINING");
  track->End();
  EXPECT_EQ(Describe(track->Finish()), "OK");
}

TEST_F(ServerTest, ServesHealthAndMoreThanOneAddress) {
  ServerOptions options = Options();
  options.listen_address = "127.0.0.1:0";
  Connect(options);
  ASSERT_GT(server_->port(), 0);
  const CreatedSession session = CreateSession();  // in process
  const auto socket =
      grpc::CreateChannel(absl::StrCat("127.0.0.1:", server_->port()), grpc::InsecureChannelCredentials());
  Use(socket);
  CreatedSession found;
  EXPECT_EQ(Describe(Get(session.name(), &found)), "OK") << "the same server";

  grpc::ClientContext context;
  grpc::health::v1::HealthCheckResponse health;
  ASSERT_TRUE(grpc::health::v1::Health::NewStub(socket)->Check(&context, {}, &health).ok());
  EXPECT_EQ(health.status(), grpc::health::v1::HealthCheckResponse::SERVING);

  server_->Shutdown(absl::ZeroDuration());
  EXPECT_EQ(Get(session.name(), &found).error_code(), grpc::StatusCode::UNAVAILABLE);
}

// Returns the serialized response of the reflection service to a request for the list of services.
std::string ListServicesByReflection(const std::shared_ptr<grpc::Channel>& channel) {
  grpc::GenericStub stub(channel);
  grpc::ClientContext context;
  grpc::CompletionQueue queue;
  const auto wait = [&queue] {
    void* tag = nullptr;
    bool ok = false;
    return queue.Next(&tag, &ok) && ok;
  };
  const auto call =
      stub.PrepareCall(&context, "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo", &queue);
  call->StartCall(nullptr);
  EXPECT_TRUE(wait());
  const grpc::Slice list_services("\x3a\x01*");  // field 7, a string
  call->Write(grpc::ByteBuffer(&list_services, 1), nullptr);
  EXPECT_TRUE(wait());
  grpc::ByteBuffer response;
  call->Read(&response, nullptr);
  EXPECT_TRUE(wait());
  grpc::Status status;
  context.TryCancel();
  call->Finish(&status, nullptr);
  wait();
  grpc::Slice bytes;
  EXPECT_TRUE(response.DumpToSingleSlice(&bytes).ok());
  return std::string(reinterpret_cast<const char*>(bytes.begin()), bytes.size());
}

TEST_F(ServerTest, DescribesItselfByReflection) {
  const std::string services = ListServicesByReflection(channel_);
  for (const char* service :
       {"evpose.v1.SessionService", "evpose.v1.ModelService", "evpose.v1.AdminService", "grpc.health.v1.Health"}) {
    EXPECT_THAT(services, testing::HasSubstr(service));
  }
}

TEST_F(ServerTest, CannotListenWhereAnotherDoes) {
  ServerOptions options = Options();
  options.listen_address = "127.0.0.1:0";
  Connect(options);
  options.listen_address = absl::StrCat("127.0.0.1:", server_->port());
  const auto second = StartServer(options, FakeTrackers());
  EXPECT_EQ(second.status().code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(std::string(second.status().message()),
              testing::AllOf(testing::HasSubstr(options.listen_address), testing::HasSubstr("in use")));
}

TEST(ServerOptionsTest, NamesTheFieldThatIsWrong) {
  const auto field_of = [](const ServerOptions& options) {
    const std::string message(options.Validate().message());
    return message.substr(0, message.find(':'));
  };
  EXPECT_TRUE(ServerOptions().Validate().ok());
  EXPECT_EQ(field_of({.listen_address = "nowhere"}), "listen_address");
  EXPECT_EQ(field_of({.worker_threads = -1}), "worker_threads");
  EXPECT_EQ(field_of({.max_sessions = 0}), "max_sessions");
  EXPECT_EQ(field_of({.max_session_memory = 0}), "max_session_memory");
  EXPECT_EQ(field_of({.max_model_bytes = 0}), "max_model_bytes");
  EXPECT_EQ(field_of({.max_model_store_bytes = 1}), "max_model_store_bytes");
  EXPECT_EQ(field_of({.max_chunk_bytes = 4}), "max_chunk_bytes");
  EXPECT_EQ(field_of({.credit_bytes = 4096}), "credit_bytes");
  EXPECT_EQ(field_of({.credit_bytes = 1ull << 63}), "credit_bytes") << "the memory of a session would overflow";
  EXPECT_EQ(field_of({.pose_log_capacity = 10}), "pose_log_capacity");
  EXPECT_EQ(field_of({.pose_log_bytes = 16}), "pose_log_bytes");
  EXPECT_EQ(field_of({.listener_timeout = absl::Milliseconds(999)}), "listener_timeout");
  EXPECT_EQ(field_of({.max_transport_bytes = 1u << 20}), "max_transport_bytes");
  EXPECT_EQ(field_of({.stream_idle_timeout = -absl::Seconds(1)}), "stream_idle_timeout");
  EXPECT_EQ(field_of({.session_expiry = absl::ZeroDuration()}), "session_expiry");
  EXPECT_EQ(field_of({.store_check_period = absl::ZeroDuration()}), "store_check_period");
}

}  // namespace
}  // namespace evpose::server

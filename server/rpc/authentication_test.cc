// SPDX-License-Identifier: Apache-2.0

// Tests authentication with tokens and certificates, and the separation of tenants.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <future>

#include "absl/strings/str_cat.h"
#include "grpc/health/v1/health.grpc.pb.h"
#include "server/rpc/authentication_testing.h"
#include "server/stores/memory/memory_store.h"
#include "server/telemetry/log_testing.h"

namespace evpose::server {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

std::vector<std::string> MethodsOfTheApi() {
  std::vector<std::string> methods;
  for (const char* name : {"AdminService", "ModelService", "SessionService"}) {
    const auto* service =
        google::protobuf::DescriptorPool::generated_pool()->FindServiceByName(absl::StrCat("evpose.v1.", name));
    for (int i = 0; i < service->method_count(); ++i) {
      methods.push_back("/" + service->full_name() + "/" + service->method(i)->name());
    }
  }
  return methods;
}

std::string HealthOver(const std::shared_ptr<grpc::Channel>& channel) {
  grpc::ClientContext context;
  grpc::health::v1::HealthCheckResponse response;
  return Describe(grpc::health::v1::Health::NewStub(channel)->Check(&context, {}, &response));
}

TEST_F(TokensTest, EveryMethodOfTheApiRequiresAToken) {
  const auto nobody = OpenChannel(server_->port(), "");
  const auto stranger = OpenChannel(server_->port(), MakeToken("lab", true)->token);
  const std::vector<std::string> methods = MethodsOfTheApi();
  EXPECT_GE(methods.size(), 12u);
  for (const std::string& method : methods) {
    EXPECT_EQ(Describe(CallWithEmptyMessage(nobody, method)), "UNAUTHENTICATED NO_TOKEN") << method;
    EXPECT_EQ(Describe(CallWithEmptyMessage(stranger, method)), "UNAUTHENTICATED BAD_TOKEN") << method;
    EXPECT_NE(CallWithEmptyMessage(channel_, method).error_code(), grpc::StatusCode::UNAUTHENTICATED) << method;
  }
}

TEST_F(TokensTest, HealthNeedsNoTokenAndReflectionIsDisabled) {
  const auto nobody = OpenChannel(server_->port(), "");
  EXPECT_EQ(HealthOver(nobody), "OK");
  const std::string reflection = "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo";
  EXPECT_EQ(Describe(CallWithEmptyMessage(nobody, reflection)), "UNIMPLEMENTED");
  EXPECT_EQ(Describe(CallWithEmptyMessage(channel_, reflection)), "UNIMPLEMENTED");
}

TEST_F(TokensTest, OnlyAnOperatorDrains) {
  const auto drain = [this](const NewToken& token) {
    grpc::ClientContext context;
    v1::DrainRequest request;
    v1::DrainResponse response;
    return Describe(
        v1::AdminService::NewStub(OpenChannel(server_->port(), token.token))->Drain(&context, request, &response));
  };
  EXPECT_EQ(drain(lab_), "PERMISSION_DENIED NOT_OPERATOR");
  EXPECT_EQ(HealthOver(channel_), "OK");
  (void)CreateSession();  // succeeds, because the server is not draining
  EXPECT_EQ(drain(operator_), "OK");
}

TEST_F(TokensTest, OnlyAnOperatorSetsTheLogLevel) {
  const auto set = [this](const NewToken& token, v1::LogLevel level, v1::SetLogLevelResponse& response) {
    grpc::ClientContext context;
    v1::SetLogLevelRequest request;
    request.set_level(level);
    return Describe(v1::AdminService::NewStub(OpenChannel(server_->port(), token.token))
                        ->SetLogLevel(&context, request, &response));
  };
  v1::SetLogLevelResponse response;
  SetLogLevel(LogLevel::kInfo);
  EXPECT_EQ(set(lab_, v1::LOG_LEVEL_DEBUG, response), "PERMISSION_DENIED NOT_OPERATOR");
  EXPECT_EQ(set(operator_, v1::LOG_LEVEL_UNSPECIFIED, response), "INVALID_ARGUMENT level");
  EXPECT_EQ(set(operator_, static_cast<v1::LogLevel>(6), response), "INVALID_ARGUMENT level");
  EXPECT_EQ(CurrentLogLevel(), LogLevel::kInfo);
  captured_log.Take();
  EXPECT_EQ(set(operator_, v1::LOG_LEVEL_OFF, response), "OK");
  EXPECT_EQ(response.previous_level(), v1::LOG_LEVEL_INFO);
  EXPECT_EQ(CurrentLogLevel(), LogLevel::kOff);
  const std::string log = captured_log.Take();
  EXPECT_THAT(log, HasSubstr("info log_level_changed tenant=admin peer="));
  EXPECT_THAT(log, HasSubstr(" from=info to=off\n"));
  EXPECT_EQ(set(operator_, v1::LOG_LEVEL_DEBUG, response), "OK");
  EXPECT_EQ(response.previous_level(), v1::LOG_LEVEL_OFF);
  EXPECT_THAT(captured_log.Take(), HasSubstr(" from=off to=debug\n"));
}

TEST_F(TokensTest, NoSecretIsInTheLog) {
  captured_log.Take();
  const CreatedSession session = CreateSession();
  v1::TrackResponse::Attached attached;
  const auto track = Attached(session, &attached);
  EXPECT_TRUE(track->Attach(session.name(), attached.resume_token()));  // the second one is an error
  const grpc::Status status = track->Finish();
  const auto stranger = OpenChannel(server_->port(), "evpose_stranger");
  CallWithEmptyMessage(stranger, "/evpose.v1.AdminService/GetServerInfo");
  EXPECT_EQ(Describe(Delete(session.name())), "OK");
  const std::string log = captured_log.Take();
  EXPECT_THAT(log, HasSubstr(session.name()));
  for (const std::string& secret :
       {session.resume_token(), attached.resume_token(), lab_.token, lab_.token.substr(7), std::string("stranger")}) {
    EXPECT_THAT(log, Not(HasSubstr(secret)));
    EXPECT_THAT(status.error_message() + status.error_details(), Not(HasSubstr(secret)));
  }
}

TEST_F(TokensTest, AnotherTenantsSessionsAndModelsAreNotFound) {
  const CreatedSession session = CreateSession();
  const std::string model = UploadCube();
  Use(OpenChannel(server_->port(), field_.token));
  CreatedSession read;
  EXPECT_EQ(Describe(Get(session.name(), &read)), "NOT_FOUND SESSION_NOT_FOUND");
  EXPECT_EQ(Describe(Delete(session.name())), "NOT_FOUND SESSION_NOT_FOUND");
  RawTrack track(*sessions_);
  track.Attach(session.name(), session.resume_token());
  EXPECT_EQ(Describe(track.Finish()), "NOT_FOUND SESSION_NOT_FOUND") << "also with the session's resume token";

  grpc::ClientContext watch_poses, watch_health, watch_events, get_model, geometry, delete_model, list_models,
      list_sessions, info;
  v1::WatchPosesRequest poses_request;
  poses_request.set_session(session.name());
  EXPECT_EQ(Describe(sessions_->WatchPoses(&watch_poses, poses_request)->Finish()), "NOT_FOUND SESSION_NOT_FOUND");
  v1::WatchHealthRequest health_request;
  health_request.set_session(session.name());
  EXPECT_EQ(Describe(sessions_->WatchHealth(&watch_health, health_request)->Finish()), "NOT_FOUND SESSION_NOT_FOUND");
  v1::WatchEventsRequest events_request;
  events_request.set_session(session.name());
  EXPECT_EQ(Describe(sessions_->WatchEvents(&watch_events, events_request)->Finish()), "NOT_FOUND SESSION_NOT_FOUND");
  v1::GetModelGeometryRequest geometry_request;
  geometry_request.set_name(model);
  v1::ModelGeometry read_geometry;
  EXPECT_EQ(Describe(models_->GetModelGeometry(&geometry, geometry_request, &read_geometry)),
            "NOT_FOUND MODEL_NOT_FOUND");
  v1::GetModelRequest model_request;
  model_request.set_name(model);
  v1::Model read_model;
  EXPECT_EQ(Describe(models_->GetModel(&get_model, model_request, &read_model)), "NOT_FOUND MODEL_NOT_FOUND");
  v1::DeleteModelRequest delete_request;
  delete_request.set_name(model);
  google::protobuf::Empty deleted;
  EXPECT_EQ(Describe(models_->DeleteModel(&delete_model, delete_request, &deleted)), "NOT_FOUND MODEL_NOT_FOUND");
  v1::ListModelsResponse models;
  EXPECT_EQ(Describe(models_->ListModels(&list_models, {}, &models)), "OK");
  EXPECT_EQ(models.models_size(), 0);
  v1::ListSessionsResponse sessions;
  EXPECT_EQ(Describe(sessions_->ListSessions(&list_sessions, {}, &sessions)), "OK");
  EXPECT_EQ(sessions.sessions_size(), 0);
  v1::ServerInfo server;
  EXPECT_EQ(Describe(admin_->GetServerInfo(&info, {}, &server)), "OK");
  EXPECT_EQ(server.active_sessions(), 0u);

  Use(OpenChannel(server_->port(), lab_.token));
  EXPECT_EQ(Describe(Get(session.name(), &read)), "OK");
  Use(OpenChannel(server_->port(), operator_.token));
  EXPECT_EQ(Describe(Get(session.name(), &read)), "NOT_FOUND SESSION_NOT_FOUND")
      << "an operator does not have access to other tenants";
  grpc::ClientContext operator_info;
  EXPECT_EQ(Describe(admin_->GetServerInfo(&operator_info, {}, &server)), "OK");
  EXPECT_EQ(server.active_sessions(), 1u);
}

TEST_F(TokensTest, AnotherTenantsDamagedSessionIsNotFound) {
  const std::string name = "sessions/0123456789abcdef0123456789abcdef";
  std::unique_ptr<Store> store = MakeMemoryStore();
  ASSERT_TRUE(store->CreateSession({.name = name, .tenant = "lab", .config = "no configuration"}, "no lifecycle").ok());
  ServerOptions options = Options();
  options.listen_address = "127.0.0.1:0";
  options.token_file = files_.Path("tokens");
  server_ = StartServer(options, FakeTrackers(gate_), std::move(store)).value();
  const auto errors = [&](const NewToken& token) {
    Use(OpenChannel(server_->port(), token.token));
    CreatedSession session;
    const std::string error = Describe(Get(name, &session));
    RawTrack track(*sessions_);
    track.Attach(name, "token");
    EXPECT_EQ(Describe(track.Finish()), error);
    grpc::ClientContext context;
    v1::WatchPosesRequest request;
    request.set_session(name);
    EXPECT_EQ(Describe(sessions_->WatchPoses(&context, request)->Finish()), error);
    return error;
  };
  EXPECT_EQ(errors(field_), "NOT_FOUND SESSION_NOT_FOUND");
  EXPECT_EQ(Describe(Delete(name)), "NOT_FOUND SESSION_NOT_FOUND");
  EXPECT_EQ(errors(lab_), "DATA_LOSS SESSION_DAMAGED") << "the session still exists";
  EXPECT_EQ(Describe(Delete(name)), "OK");
  EXPECT_EQ(errors(lab_), "NOT_FOUND SESSION_NOT_FOUND");
}

TEST_F(TokensTest, TheLimitsOfATenantDoNotAffectOthers) {
  ServerOptions options = Options();
  options.listen_address = "127.0.0.1:0";
  options.token_file = files_.Path("tokens");
  options.tenant.max_sessions = 1;
  options.tenant.max_watchers = 1;
  server_ = StartServer(options, FakeTrackers(gate_)).value();
  Use(OpenChannel(server_->port(), lab_.token));
  const CreatedSession session = CreateSession();
  CreatedSession second;
  const grpc::Status full = Create(CreateRequest(), &second);
  EXPECT_EQ(Describe(full), "RESOURCE_EXHAUSTED TENANT_QUOTA");
  EXPECT_EQ(DetailOf<google::rpc::QuotaFailure>(full).violations(0).subject(), "tenant_sessions");
  EXPECT_GT(DetailOf<google::rpc::RetryInfo>(full).retry_delay().seconds(), 0);

  v1::WatchHealthRequest request;
  request.set_session(session.name());
  const auto watch = [&](grpc::ClientContext& context) { return sessions_->WatchHealth(&context, request); };
  v1::WatchHealthResponse health;
  {
    grpc::ClientContext first_context, second_context;
    const auto first = watch(first_context);
    EXPECT_TRUE(first->Read(&health));
    EXPECT_EQ(Describe(watch(second_context)->Finish()), "RESOURCE_EXHAUSTED TENANT_QUOTA");
    grpc::ClientContext poses_context;
    v1::WatchPosesRequest poses;
    poses.set_session(session.name());
    const grpc::Status refused = sessions_->WatchPoses(&poses_context, poses)->Finish();
    EXPECT_EQ(Describe(refused), "RESOURCE_EXHAUSTED TENANT_QUOTA");
    EXPECT_EQ(DetailOf<google::rpc::QuotaFailure>(refused).violations(0).subject(), "tenant_watchers");
    EXPECT_EQ(Describe(Delete(session.name())), "OK");
    while (first->Read(&health)) continue;
    EXPECT_EQ(Describe(first->Finish()), "NOT_FOUND SESSION_DELETED");
  }
  Use(OpenChannel(server_->port(), field_.token));
  EXPECT_EQ(Describe(Create(CreateRequest(), &second)), "OK");
}

// Idle connections.
class IdleTest : public RpcTest {
 protected:
  static ServerOptions Impatient() {
    ServerOptions options = Options();
    options.attach_timeout = absl::Milliseconds(1);
    return options;
  }
};

TEST_F(IdleTest, AStreamThatNeverAttachesEnds) {
  server_ = StartServer(Impatient(), FakeTrackers(gate_)).value();
  Use(server_->InProcessChannel());
  EXPECT_EQ(Describe(RawTrack(*sessions_).Finish()), "DEADLINE_EXCEEDED ATTACH_TIMEOUT");
}

TEST_F(IdleTest, AnAttachedStreamWithoutMessagesEndsAndItsSessionContinues) {
  ServerOptions options = Options();
  options.stream_idle_timeout = absl::Milliseconds(300);
  server_ = StartServer(options, FakeTrackers(gate_)).value();
  Use(server_->InProcessChannel());
  CreatedSession session = CreateSession();
  v1::TrackResponse::Attached attached;
  const auto silent = Attached(session, &attached);
  EXPECT_EQ(attached.idle_timeout().nanos(), 300'000'000);
  EXPECT_EQ(Describe(silent->Finish()), "DEADLINE_EXCEEDED STREAM_IDLE");
  session.set_resume_token(attached.resume_token());
  const auto track = Attached(session);
  EXPECT_TRUE(track->Events(1, Flat64(SomeEvents(1, 11))));
  EXPECT_TRUE(track->End());
  EXPECT_EQ(Describe(track->Finish()), "OK");
}

// Keepalive chunks only keep the stream open: the poses are those of the events alone.
TEST_F(IdleTest, KeepaliveChunksKeepAStreamOpen) {
  ServerOptions options = Options();
  options.stream_idle_timeout = absl::Milliseconds(500);
  server_ = StartServer(options, FakeTrackers(gate_)).value();
  Use(server_->InProcessChannel());
  const auto track = Attached(CreateSession());
  const auto silent = Attached(CreateSession());  // it would end after the other one
  auto silent_end = std::async(std::launch::async, [&silent] { return silent->Finish(); });
  v1::TrackRequest keepalive;
  keepalive.mutable_events();
  while (silent_end.wait_for(std::chrono::seconds(0)) != std::future_status::ready) {
    ASSERT_TRUE(track->Write(keepalive));
  }
  EXPECT_EQ(Describe(silent_end.get()), "DEADLINE_EXCEEDED STREAM_IDLE");
  EXPECT_TRUE(track->Events(1, Flat64(SomeEvents(1, 11))));
  ASSERT_TRUE(track->Write(keepalive));
  EXPECT_TRUE(track->End());
  v1::TrackResponse response;
  ASSERT_TRUE(track->ReadUntil(v1::TrackResponse::kSummary, response));
  EXPECT_EQ(response.summary().health().poses(), 10u);
  EXPECT_EQ(Describe(track->Finish()), "OK");
}

// Neither while its chunk is in work, nor while the queue is full and nothing is read.
TEST_F(IdleTest, AClientThatWaitsForTheServerIsNotSilent) {
  ServerOptions options = Options();
  options.stream_idle_timeout = absl::Milliseconds(500);
  for (const uint64_t sent_bytes : {uint64_t{1}, options.credit_bytes}) {
    server_ = StartServer(options, FakeTrackers(gate_)).value();
    Use(server_->InProcessChannel());
    const auto waiting = Attached(CreateSession());
    gate_->Close();
    uint64_t seq = 0;
    for (uint64_t bytes = 0; bytes < sent_bytes;) {
      const auto begin_ms = static_cast<int64_t>(10 * ++seq);
      const std::string payload = Flat64(SomeEvents(begin_ms, begin_ms + 10, 300));
      ASSERT_TRUE(waiting->Events(seq, payload));
      bytes += payload.size();
      if (seq == 1) gate_->AwaitTracker();
    }
    const auto silent = Attached(CreateSession());  // its time begins after that of the other one
    EXPECT_EQ(Describe(silent->Finish()), "DEADLINE_EXCEEDED STREAM_IDLE");
    gate_->Open();
    EXPECT_TRUE(waiting->End());
    EXPECT_EQ(Describe(waiting->Finish()), "OK");
  }
}

TEST_F(IdleTest, WithoutALimitNoStreamIsIdle) {
  ServerOptions options = Options();
  options.stream_idle_timeout = absl::ZeroDuration();
  server_ = StartServer(options, FakeTrackers(gate_)).value();
  Use(server_->InProcessChannel());
  v1::TrackResponse::Attached attached;
  const auto track = Attached(CreateSession(), &attached);
  EXPECT_FALSE(attached.has_idle_timeout());
}

TEST_F(IdleTest, AnUploadThatStallsEndsAndItsRoomIsFree) {
  ServerOptions options = Impatient();
  options.max_model_store_bytes = options.max_model_bytes;
  server_ = StartServer(options, FakeTrackers(gate_)).value();
  Use(server_->InProcessChannel());
  for (int i = 0; i < 3; ++i) {
    grpc::ClientContext context;
    v1::Model model;
    const auto stream = models_->UploadModel(&context, &model);
    stream->Write(UploadHeader(options.max_model_bytes));
    EXPECT_EQ(Describe(stream->Finish()), "DEADLINE_EXCEEDED UPLOAD_TIMEOUT");
  }
}

TEST_F(IdleTest, AStreamBeyondTheLimitIsRejected) {
  ServerOptions options = Options();
  options.max_streams = 1;
  server_ = StartServer(options, FakeTrackers(gate_)).value();
  Use(server_->InProcessChannel());
  const CreatedSession session = CreateSession();
  {
    const auto track = Attached(session);
    const grpc::Status status = RawTrack(*sessions_).Finish();
    EXPECT_EQ(Describe(status), "RESOURCE_EXHAUSTED TOO_MANY_STREAMS");
    EXPECT_EQ(DetailOf<google::rpc::QuotaFailure>(status).violations(0).subject(), "max_streams");
    EXPECT_GT(DetailOf<google::rpc::RetryInfo>(status).retry_delay().seconds(), 0);
    grpc::ClientContext poses_context, health_context, events_context;
    v1::WatchPosesRequest poses;
    poses.set_session(session.name());
    EXPECT_EQ(Describe(sessions_->WatchPoses(&poses_context, poses)->Finish()), "RESOURCE_EXHAUSTED TOO_MANY_STREAMS");
    v1::WatchHealthRequest health;
    health.set_session(session.name());
    EXPECT_EQ(Describe(sessions_->WatchHealth(&health_context, health)->Finish()),
              "RESOURCE_EXHAUSTED TOO_MANY_STREAMS");
    v1::WatchEventsRequest events;
    events.set_session(session.name());
    EXPECT_EQ(Describe(sessions_->WatchEvents(&events_context, events)->Finish()),
              "RESOURCE_EXHAUSTED TOO_MANY_STREAMS");
    EXPECT_TRUE(track->End());
    v1::TrackResponse response;
    EXPECT_TRUE(track->ReadUntil(v1::TrackResponse::kSummary, response));
  }
}

TEST_F(IdleTest, AStreamThatIsTooFastIsReadMoreSlowly) {
  ServerOptions options = Options();
  options.tenant.max_bytes_per_s = 20'000;  // the bytes of one second may arrive in a burst
  options.max_chunk_bytes = 64;
  options.credit_bytes = 1 << 20;
  server_ = StartServer(options, FakeTrackers(gate_)).value();
  Use(server_->InProcessChannel());
  const CreatedSession session = CreateSession();
  const auto track = Attached(session);
  constexpr uint64_t kChunks = 400;
  for (uint64_t seq = 1; seq <= kChunks; ++seq) EXPECT_TRUE(track->Events(seq, std::string(64, '\0')));
  EXPECT_TRUE(track->End());
  v1::TrackResponse response;
  ASSERT_TRUE(track->ReadUntil(v1::TrackResponse::kSummary, response));
  EXPECT_EQ(response.summary().health().received_bytes(), kChunks * 64);
  EXPECT_EQ(Describe(track->Finish()), "OK");
}

TEST_F(IdleTest, AHeldStreamIsNotRead) {
  ServerOptions options = Options();
  options.listen_address = "127.0.0.1:0";  // a socket buffers the bytes that the server has not read
  options.tenant.max_bytes_per_s = 1;
  options.max_chunk_bytes = 64;
  server_ = StartServer(options, FakeTrackers(gate_)).value();
  Use(OpenChannel(server_->port(), ""));
  const CreatedSession session = CreateSession();
  const auto track = Attached(session);
  for (uint64_t seq = 1; seq <= 10; ++seq) EXPECT_TRUE(track->Events(seq, std::string(64, '\0')));
  v1::TrackResponse response;
  do {
    ASSERT_TRUE(track->ReadUntil(v1::TrackResponse::kAck, response));
  } while (response.ack().processed_seq() < 2);
  EXPECT_EQ(response.ack().processed_seq(), 2u)
      << "the first chunk is within the burst; the second exceeds the limit by the bytes of a minute";
  track->Cancel();
  EXPECT_EQ(Describe(track->Finish()), "CANCELLED");
  CreatedSession read;
  EXPECT_EQ(Describe(Get(session.name(), &read)), "OK");
  EXPECT_EQ(read.health().received_bytes(), 128u);
}

TEST_F(TlsTest, ClientsThatTrustTheAuthority) {
  Start(TlsOptions(false));
  std::string shown_pem;
  EXPECT_EQ(Call(ConnectTls(), &shown_pem), "OK");
  EXPECT_EQ(shown_pem, certificate_pem_);
  EXPECT_EQ(Call(OpenChannel(server_->port(), "", Tls(clients_.pem()))), "UNAVAILABLE");
  EXPECT_EQ(Call(OpenChannel(server_->port(), "")), "UNAVAILABLE") << "without TLS";
}

TEST_F(TlsTest, TokensThroughTls) {
  const NewToken lab = MakeToken("lab", false).value();
  ServerOptions options = TlsOptions(false);
  options.token_file = files_.Write("tokens", lab.line);
  Start(options);
  EXPECT_EQ(Call(ConnectTls(lab.token)), "OK");
  EXPECT_EQ(Call(ConnectTls()), "UNAUTHENTICATED NO_TOKEN");
}

TEST_F(TlsTest, ClientsPresentCertificates) {
  Start(TlsOptions(true));
  EXPECT_EQ(Call(ConnectTls("", clients_.Issue({.common_name = "lab", .alternative_names = ""}))), "OK");
  EXPECT_EQ(Call(ConnectTls("", clients_.Issue({.common_name = "John Doe"}))), "UNAUTHENTICATED BAD_CERTIFICATE");
  EXPECT_EQ(Call(ConnectTls()), "UNAVAILABLE");
  EXPECT_EQ(Call(ConnectTls("", authority_.Issue({.common_name = "lab"}))), "UNAVAILABLE")
      << "a certificate of another authority";
  const TestCertificateOptions old = {.common_name = "lab", .not_after = absl::Now() - absl::Minutes(1)};
  EXPECT_EQ(Call(ConnectTls("", clients_.Issue(old))), "UNAVAILABLE") << "expired";
}

TEST_F(TlsTest, ANewCertificateIsUsedForNewConnections) {
  Start(TlsOptions(false));
  Use(ConnectTls());
  const CreatedSession session = CreateSession();
  const auto track = Attached(session);
  const std::string old_pem = certificate_pem_;
  Write(authority_.Issue());
  std::string shown_pem;
  EXPECT_EQ(Call(ConnectTls(), &shown_pem), "OK");
  EXPECT_EQ(shown_pem, certificate_pem_);
  EXPECT_NE(shown_pem, old_pem);
  // The server gets a certificate of another authority; the clients still trust only the first one.
  Write(clients_.Issue());
  EXPECT_EQ(Call(ConnectTls()), "UNAVAILABLE");
  EXPECT_EQ(Call(OpenChannel(server_->port(), "", Tls(clients_.pem()))), "OK");

  EXPECT_TRUE(track->End());
  v1::TrackResponse response;
  EXPECT_TRUE(track->ReadUntil(v1::TrackResponse::kSummary, response)) << "the stream continues";
  EXPECT_EQ(Describe(track->Finish()), "OK");
}

TEST_F(TlsTest, AnInvalidNewCertificateKeepsThePreviousOne) {
  Start(TlsOptions(true));
  const TestCertificate client = clients_.Issue({.common_name = "lab"});
  EXPECT_EQ(Call(ConnectTls("", client)), "OK");
  files_.Write("server.key", authority_.Issue().key_pem);
  files_.Write("clients.crt", "nothing");
  EXPECT_EQ(Call(ConnectTls("", client)), "OK");
  files_.Write("clients.crt", authority_.pem());
  Write(authority_.Issue());
  EXPECT_EQ(Call(ConnectTls("", client)), "UNAVAILABLE") << "its authority is no longer trusted";
  EXPECT_EQ(Call(ConnectTls("", authority_.Issue({.common_name = "lab"}))), "OK");
}

TEST_F(TlsTest, ServersThatCannotStart) {
  const auto start = [this](const ServerOptions& options) {
    return std::string(StartServer(options, FakeTrackers(gate_)).status().message());
  };
  ServerOptions options = TlsOptions(true);
  options.tls.client_ca = files_.Path("none");
  EXPECT_THAT(start(options), HasSubstr(files_.Path("none")));
  options.tls = {"", "", "ca"};
  EXPECT_THAT(start(options), HasSubstr("tls: --tls-client-ca needs"));
  options.tls = {};
  options.token_file = files_.Write("tokens", "lab");
  EXPECT_THAT(start(options), HasSubstr("tokens:1:"));
}

}  // namespace
}  // namespace evpose::server

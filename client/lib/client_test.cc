// SPDX-License-Identifier: Apache-2.0
#include "evpose/client.h"

#include <gmock/gmock.h>
#include <grpcpp/server.h>
#include <grpcpp/server_builder.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <stop_token>
#include <string>

#include "absl/strings/escaping.h"
#include "client/lib/client_access.h"
#include "client/lib/stalled_server_testing.h"
#include "core/base/output_file.h"
#include "core/base/temporary_directory_testing.h"
#include "core/numerics/hash.h"
#include "evpose/v1/admin_service.grpc.pb.h"
#include "evpose/v1/model_service.grpc.pb.h"
#include "evpose/v1/session_service.grpc.pb.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

ClientOptions Impatient() {
  ClientOptions options;
  options.connect_timeout = absl::Milliseconds(300);
  return options;
}

// A port that is bound, but refuses connections, during the lifetime of the object.
class ClosedPort {
 public:
  ClosedPort() : socket_(socket(AF_INET, SOCK_STREAM, 0)) {
    sockaddr_in address = {};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof(address);
    EXPECT_EQ(bind(socket_, reinterpret_cast<sockaddr*>(&address), size), 0);
    EXPECT_EQ(getsockname(socket_, reinterpret_cast<sockaddr*>(&address), &size), 0);
    address_ = "127.0.0.1:" + std::to_string(ntohs(address.sin_port));
  }
  ~ClosedPort() { close(socket_); }
  const std::string& address() const { return address_; }

 private:
  int socket_;
  std::string address_;
};

TEST(Connect, AbsentServerIsNamedWithWhatWasTried) {
  const ClosedPort port;
  const auto client = Client::Connect(port.address(), Impatient());
  EXPECT_EQ(client.status().code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(client.status().message(), HasSubstr("no server at " + port.address()));
  EXPECT_THAT(client.status().message(), HasSubstr("tried to connect for 0.3 s; is evpose-server running there?"));
  EXPECT_THAT(client.status().message(), HasSubstr("refused"));
}

TEST(Connect, InvalidAddresses) {
  for (const char* address :
       {"", "localhost", ":80", "localhost:", "localhost:0", "localhost:65536", "localhost:http"}) {
    const auto client = Client::Connect(address, Impatient());
    EXPECT_EQ(client.status().code(), absl::StatusCode::kInvalidArgument) << address;
    EXPECT_THAT(client.status().message(), HasSubstr("HOST:PORT"));
  }
}

TEST(Connect, AnotherServiceIsDetected) {
  v1::ModelService::Service other;
  int port = 0;
  grpc::ServerBuilder builder;
  builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
  builder.RegisterService(&other);
  const auto server = builder.BuildAndStart();
  ASSERT_GT(port, 0);
  ClientOptions options;
  const auto client = Client::Connect("127.0.0.1:" + std::to_string(port), options);
  EXPECT_EQ(client.status().code(), absl::StatusCode::kUnimplemented);
  EXPECT_THAT(client.status().message(), HasSubstr("is not an evpose server"));
}

TEST(ClientOptions, ValidateNamesTheField) {
  ClientOptions options;
  options.connect_timeout = absl::ZeroDuration();
  EXPECT_THAT(Client::Connect("localhost:1", options).status().message(), HasSubstr("connect_timeout"));
}

class FakeModels final : public v1::ModelService::Service {
 public:
  grpc::Status UploadModel(grpc::ServerContext*, grpc::ServerReader<v1::UploadModelRequest>* reader,
                           v1::Model* model) override {
    v1::UploadModelRequest request;
    reader->Read(&request);
    header = request.header();
    bytes.clear();
    if (num_deleted-- > 0) return {grpc::StatusCode::ABORTED, "was deleted by another server"};
    if (is_rejecting) return {grpc::StatusCode::INVALID_ARGUMENT, "line 3: not a number"};
    while (reader->Read(&request)) bytes += request.chunk();
    model->set_name("models/1");
    model->set_size_bytes(bytes.size());
    return grpc::Status::OK;
  }
  grpc::Status ListModels(grpc::ServerContext*, const v1::ListModelsRequest* request,
                          v1::ListModelsResponse* response) override {
    const bool is_first = request->page_token().empty();
    response->add_models()->set_name(is_first ? "models/1" : "models/2");
    if (is_first) response->set_next_page_token("2");
    return grpc::Status::OK;
  }
  grpc::Status DeleteModel(grpc::ServerContext*, const v1::DeleteModelRequest*, google::protobuf::Empty*) override {
    return {grpc::StatusCode::FAILED_PRECONDITION, "in use"};
  }

  v1::UploadModelRequest::Header header;
  std::string bytes;
  bool is_rejecting = false;
  int num_deleted = 0;  // remaining uploads that fail because the model was deleted
};

class ModelsTest : public ::testing::Test {
 protected:
  void SetUp() override {
    grpc::ServerBuilder builder;
    builder.RegisterService(&models_);
    server_ = builder.BuildAndStart();
    client_ = ClientAccess::OverChannel(server_->InProcessChannel({}), "test server");
  }
  FakeModels models_;
  std::unique_ptr<grpc::Server> server_;
  std::unique_ptr<Client> client_;
};

TEST_F(ModelsTest, UploadStreamsTheFileWithItsDigest) {
  std::vector<uint8_t> file(1'000'001);
  for (size_t i = 0; i < file.size(); ++i) file[i] = static_cast<uint8_t>(i * 7 / 5);
  UploadOptions options;
  options.format = ModelFormat::kStl;
  options.metres_per_unit = 0.001;
  options.crease_angle_deg = 12.5;
  options.surface = ModelSurface::kAsIs;
  const auto model = client_->UploadModel(file, options);
  ASSERT_TRUE(model.ok()) << model.status();
  EXPECT_EQ(model->name, "models/1");
  EXPECT_EQ(models_.header.format(), v1::MODEL_FORMAT_STL);
  EXPECT_EQ(models_.header.metres_per_unit(), 0.001);
  EXPECT_EQ(models_.header.crease_angle_deg(), 12.5);
  EXPECT_EQ(models_.header.surface(), v1::MODEL_SURFACE_AS_IS);
  EXPECT_EQ(models_.header.size_bytes(), file.size());
  EXPECT_EQ(absl::BytesToHexString(models_.header.sha256()), Sha256Hex(file));
  EXPECT_EQ(models_.bytes, std::string(file.begin(), file.end()));
}

TEST_F(ModelsTest, AModelThatAnotherServerDeletedIsUploadedOnceMore) {
  models_.num_deleted = 1;
  EXPECT_TRUE(client_->UploadModel(std::vector<uint8_t>(100, 'x'), {}).ok());
  EXPECT_EQ(models_.bytes, std::string(100, 'x'));
  models_.num_deleted = 2;
  EXPECT_EQ(client_->UploadModel(std::vector<uint8_t>(100, 'x'), {}).status().code(), absl::StatusCode::kAborted);
}

TEST_F(ModelsTest, RejectedUploadReturnsTheServersMessage) {
  models_.is_rejecting = true;
  const auto model = client_->UploadModel(std::vector<uint8_t>(5'000'000), {});
  EXPECT_EQ(model.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(model.status().message(), "test server: line 3: not a number");
}

TEST_F(ModelsTest, AllPagesAreListed) {
  const auto models = client_->ListModels();
  ASSERT_TRUE(models.ok()) << models.status();
  ASSERT_EQ(models->size(), 2u);
  EXPECT_EQ((*models)[0].name, "models/1");
  EXPECT_EQ((*models)[1].name, "models/2");
}

TEST_F(ModelsTest, StatusKeepsItsCode) {
  EXPECT_EQ(client_->DeleteModel("models/1").code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(client_->GetModel("models/1").status().code(), absl::StatusCode::kUnimplemented);
}

class NamelessSessions final : public v1::SessionService::Service {
 public:
  grpc::Status CreateSession(grpc::ServerContext*, const v1::CreateSessionRequest*,
                             v1::CreateSessionResponse* response) override {
    response->set_resume_token("secret");
    return grpc::Status::OK;
  }
};

TEST(SessionsTest, ASessionWithoutANameViolatesTheProtocol) {
  NamelessSessions sessions;
  grpc::ServerBuilder builder;
  builder.RegisterService(&sessions);
  const std::unique_ptr<grpc::Server> server = builder.BuildAndStart();
  const auto session = ClientAccess::OverChannel(server->InProcessChannel({}), "test server")->CreateSession({});
  EXPECT_EQ(session.status().code(), absl::StatusCode::kInternal);
  EXPECT_EQ(session.status().message(), "test server: the server violates the protocol: the new session has no name");
}

TEST(StopTest, ARequestCancelsACallThatIsNotAnswered) {
  std::stop_source stop;
  StalledServer stalled([&](const std::string&) { stop.request_stop(); });
  using Stop = const std::stop_token&;
  const auto code_of = [&](const auto& call) {
    stop = std::stop_source();
    return call(stalled.client(), stop.get_token()).status().code();
  };
  for (const absl::StatusCode code : {
           code_of([](Client&client, Stop token) { return client.GetModel("models/1", token); }),
           code_of([](Client&client, Stop token) { return client.GetModelGeometry("models/1", 0, token); }),
           code_of([](Client&client, Stop token) { return client.GetSession("sessions/1", token); }),
           code_of([](Client&client, Stop token) { return client.ListSessions(token); }),
       }) {
    EXPECT_EQ(code, absl::StatusCode::kCancelled);
  }
}

class FakeAdmin : public v1::AdminService::Service {
 public:
  grpc::Status Drain(grpc::ServerContext*, const v1::DrainRequest* its_request, v1::DrainResponse* response) override {
    request = *its_request;
    response->set_remaining_sessions(3);
    return grpc::Status::OK;
  }
  grpc::Status GetServerInfo(grpc::ServerContext*, const v1::GetServerInfoRequest*, v1::ServerInfo* info) override {
    info->set_max_model_bytes(max_model_bytes);
    return grpc::Status::OK;
  }
  v1::DrainRequest request;
  uint64_t max_model_bytes = 0;
};

TEST(UploadModelFileTest, TheLimitIsThatOfTheServer) {
  FakeAdmin admin;
  FakeModels models;
  int port = 0;
  grpc::ServerBuilder builder;
  builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
  builder.RegisterService(&admin);
  builder.RegisterService(&models);
  const std::unique_ptr<grpc::Server> server = builder.BuildAndStart();
  const TemporaryDirectory directory;
  const std::string path = directory.File("model.obj");
  ASSERT_TRUE(WriteFile(path, "v 0 0 0\n").ok());
  for (const uint64_t limit : {0, 7, 8}) {
    admin.max_model_bytes = limit;
    const auto client = Client::Connect("127.0.0.1:" + std::to_string(port));
    ASSERT_TRUE(client.ok()) << client.status();
    const absl::Status status = (*client)->UploadModelFile(path).status();
    EXPECT_EQ(status.message(),
              limit == 7 ? path + ": has 8 bytes, but the server accepts models of at most 7" : std::string());
  }
}

TEST(DrainTest, UsesTheGivenTimeOrTheServersDefault) {
  FakeAdmin admin;
  grpc::ServerBuilder builder;
  builder.RegisterService(&admin);
  const std::unique_ptr<grpc::Server> server = builder.BuildAndStart();
  const std::unique_ptr<Client> client = ClientAccess::OverChannel(server->InProcessChannel({}), "test server");
  EXPECT_EQ(client->Drain().value(), 3u);
  EXPECT_FALSE(admin.request.has_timeout());
  EXPECT_EQ(client->Drain(absl::Seconds(5)).value(), 3u);
  EXPECT_EQ(admin.request.timeout().seconds(), 5);
}

}  // namespace
}  // namespace evpose::client

// SPDX-License-Identifier: Apache-2.0

// The creation of the session of a run: interrupts, and errors that name the options.
#include <gmock/gmock.h>
#include <grpcpp/server.h>
#include <grpcpp/server_builder.h>
#include <gtest/gtest.h>

#include <atomic>
#include <memory>
#include <sstream>
#include <string>

#include "client/cli/common/run_inputs.h"
#include "client/lib/client_access.h"
#include "client/lib/stalled_server_testing.h"
#include "evpose/v1/session_service.grpc.pb.h"
#include "google/rpc/error_details.pb.h"
#include "google/rpc/status.pb.h"

namespace evpose::client {
namespace {

// Refuses each session because of a field.
class RefusingSessions final : public v1::SessionService::Service {
 public:
  grpc::Status CreateSession(grpc::ServerContext*, const v1::CreateSessionRequest*,
                             v1::CreateSessionResponse*) override {
    google::rpc::BadRequest request;
    google::rpc::BadRequest::FieldViolation& violation = *request.add_field_violations();
    violation.set_field(field);
    violation.set_description("is wrong");
    google::rpc::Status details;
    details.add_details()->PackFrom(request);
    return {grpc::StatusCode::INVALID_ARGUMENT, message, details.SerializeAsString()};
  }
  std::string field, message;
};

class CreateSessionTest : public ::testing::Test {
 protected:
  CreateSessionTest() {
    arguments_.recording = "a.raw";
    arguments_.camera = "camera.yaml";
    inputs_.objects = {{.id = "left", .model_path = "left.obj"}, {.id = "right", .model_path = "right.obj"}};
  }
  absl::Status Create(Client& client) {
    return CreateSession(context_, client, SessionConfig(), arguments_, inputs_, /*request_id=*/"").status();
  }

  std::ostringstream out_, err_;
  CliContext context_{out_, err_};
  RunArguments arguments_;
  RunInputs inputs_;
};

TEST_F(CreateSessionTest, AnInterruptEndsTheWaitForTheSession) {
  std::atomic<bool> is_interrupted = false;
  context_.is_interrupted = [&] { return is_interrupted.load(); };
  StalledServer stalled([&](const std::string&) { is_interrupted = true; });
  arguments_.server.address = stalled.address();
  const absl::Status status = Create(stalled.client());
  EXPECT_EQ(status.code(), absl::StatusCode::kCancelled);
  EXPECT_EQ(status.message(), "a.raw: interrupted before the server had created a session");
}

TEST_F(CreateSessionTest, TheFieldOfAnErrorSaysWhichOptionIsWrong) {
  RefusingSessions sessions;
  grpc::ServerBuilder builder;
  builder.RegisterService(&sessions);
  const std::unique_ptr<grpc::Server> server = builder.BuildAndStart();
  const auto client = ClientAccess::OverChannel(server->InProcessChannel({}), "test server");
  sessions.field = "config.objects[1].initial_camera_from_object";
  sessions.message = sessions.field + ": is not a rotation";
  EXPECT_EQ(Create(*client).message(), "--init-pose of right: is not a rotation");
  sessions.message = "a text of a later server";
  EXPECT_EQ(Create(*client).message(),
            "--init-pose of right: test server: a text of a later server (" + sessions.field + ": is wrong)");
  sessions.field = "config.camera";
  sessions.message = "config.objects[1].initial_camera_from_object: is the text of another error";
  EXPECT_THAT(std::string(Create(*client).message()),
              ::testing::StartsWith("no session for left.obj, right.obj seen by camera.yaml: test server: "));
}

}  // namespace
}  // namespace evpose::client

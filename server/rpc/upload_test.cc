// SPDX-License-Identifier: Apache-2.0

// Uploads of models as calls.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "absl/time/time.h"
#include "server/rpc/server_testing.h"

namespace evpose::server {
namespace {

class UploadTest : public RpcTest {};

TEST_F(UploadTest, AnUploadHasADeadlineForTheWholeFile) {
  ServerOptions options = Options();
  options.attach_timeout = absl::Hours(1);
  options.upload_timeout = absl::Milliseconds(50);
  server_ = StartServer(options, FakeTrackers(gate_)).value();
  Use(server_->InProcessChannel());
  grpc::ClientContext context;
  v1::Model model;
  const auto stream = models_->UploadModel(&context, &model);
  v1::UploadModelRequest request = UploadHeader(options.max_model_bytes);
  for (bool is_open = stream->Write(request); is_open; is_open = stream->Write(request)) {
    request.set_chunk("");  // each message arrives in time
  }
  const grpc::Status status = stream->Finish();
  EXPECT_EQ(Describe(status), "DEADLINE_EXCEEDED UPLOAD_TIMEOUT");
  EXPECT_THAT(status.error_message(), testing::HasSubstr("the file did not arrive within"));
}

}  // namespace
}  // namespace evpose::server

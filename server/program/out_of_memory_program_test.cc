// SPDX-License-Identifier: Apache-2.0

// evpose-server as a process with little address space left: a failed allocation ends the one call.
#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/sanitized.h"
#include "evpose/v1/model_service.grpc.pb.h"
#include "evpose/v1/session_service.grpc.pb.h"
#include "server/program/program_testing.h"
#include "server/rpc/raw_requests_testing.h"
#include "server/sessions/session_testing.h"

namespace evpose::server {
namespace {

// Present size of the address space of a process, bytes.
uint64_t AddressSpace(pid_t pid) {
  std::ifstream file(absl::StrCat("/proc/", pid, "/status"));
  for (std::string word; file >> word;) {
    uint64_t kilobytes = 0;
    if (word == "VmSize:" && file >> kilobytes) return kilobytes * 1024;
  }
  return 0;
}

class OutOfMemoryProgramTest : public testing::Test {
 protected:
  OutOfMemoryProgramTest() {
    const auto channel = grpc::CreateChannel(program_.Announced("listening on "), grpc::InsecureChannelCredentials());
    sessions_ = v1::SessionService::NewStub(channel);
    models_ = v1::ModelService::NewStub(channel);
    v1::Model model;
    EXPECT_TRUE(UploadModel(*models_, UploadRequests(kCubeObj), &model).ok());
    request_ = CubeSessionRequest(model.name());
  }

  grpc::Status Create(const v1::CreateSessionRequest& request) {
    grpc::ClientContext context;
    CreatedSession created;
    return sessions_->CreateSession(&context, request, created.response());
  }

  // The default of --max-session-memory depends on the machine.
  Program program_{
      std::vector<std::string>{"--listen", "127.0.0.1:0", "--workers", "1", "--max-session-memory", "100000000000"}};
  std::unique_ptr<v1::SessionService::Stub> sessions_;
  std::unique_ptr<v1::ModelService::Stub> models_;
  v1::CreateSessionRequest request_;
};

TEST_F(OutOfMemoryProgramTest, AFailedAllocationEndsTheCallAndNotTheProcess) {
#ifdef EVPOSE_SANITIZED
  GTEST_SKIP() << "sanitizers reserve an address space that cannot be limited";
#endif
  ASSERT_TRUE(Create(request_).ok());
  const uint64_t used_bytes = AddressSpace(program_.pid());
  ASSERT_GT(used_bytes, 0u);
  // 100 MB, and what large allocations leave to small ones (memory_headroom.cc).
  constexpr rlim_t kFreeBytes = 100'000'000 + (rlim_t{32} << 20);
  const rlimit limit = {used_bytes + kFreeBytes, used_bytes + kFreeBytes};
  ASSERT_EQ(prlimit(program_.pid(), RLIMIT_AS, &limit, nullptr), 0);

  v1::CreateSessionRequest large = request_;
  v1::CameraModel& camera = *large.mutable_config()->mutable_camera();
  camera.set_width_px(4096);
  camera.set_height_px(4096);
  camera.set_fx_px(3000);
  camera.set_fy_px(3000);
  camera.set_cx_px(2048);
  camera.set_cy_px(2048);
  for (const double k : {-0.01, 0.0, 0.0, 0.0, 0.0}) camera.add_distortion(k);  // a table of 134 MB
  for (int i = 0; i < 3; ++i) {
    const grpc::Status status = Create(large);
    EXPECT_EQ(status.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED) << status.error_message();
    EXPECT_THAT(status.error_message(), testing::HasSubstr("memory is exhausted"));
  }
  EXPECT_TRUE(Create(request_).ok()) << "other calls succeed";
  program_.Signal(SIGTERM);
  EXPECT_EQ(program_.Wait(), 0);
}

}  // namespace
}  // namespace evpose::server

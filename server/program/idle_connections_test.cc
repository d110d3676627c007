// SPDX-License-Identifier: Apache-2.0

// Measures the cost of idle connections: evpose-server as a process, a thousand idle connections, and one active
// client.
#include <arpa/inet.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/socket.h>

#include <memory>
#include <string>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/string_view.h"
#include "core/base/sanitized.h"
#include "evpose/v1/model_service.grpc.pb.h"
#include "evpose/v1/session_service.grpc.pb.h"
#include "server/program/program_testing.h"
#include "server/rpc/raw_requests_testing.h"
#include "server/sessions/session_testing.h"

namespace evpose::server {
namespace {

// The memory of the server is checked without sanitizers only: they delay the reuse of freed memory, and their own
// memory grows with threads and cores.
#ifdef EVPOSE_SANITIZED
constexpr bool kCountsMemory = false;
#else
constexpr bool kCountsMemory = true;
#endif
constexpr int64_t kMaxBytesPerConnection = int64_t{64} * 1024;

// A TCP connection that sends nothing, or only the connection preface of HTTP/2.
class IdleConnection {
 public:
  IdleConnection(int port, bool begins_http2) : socket_(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address = {};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<uint16_t>(port));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    EXPECT_EQ(connect(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
    if (!begins_http2) return;
    constexpr absl::string_view kPreface("PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", 24);
    constexpr absl::string_view kSettings("\0\0\0\4\0\0\0\0\0", 9);  // an empty SETTINGS frame, RFC 9113 6.5
    EXPECT_EQ(send(socket_, kPreface.data(), kPreface.size(), 0), kPreface.size());
    EXPECT_EQ(send(socket_, kSettings.data(), kSettings.size(), 0), kSettings.size());
    char settings_of_server[9];
    EXPECT_EQ(recv(socket_, settings_of_server, sizeof(settings_of_server), MSG_WAITALL), 9);
  }
  ~IdleConnection() { close(socket_); }
  IdleConnection(const IdleConnection&) = delete;
  IdleConnection& operator=(const IdleConnection&) = delete;

 private:
  const int socket_;
};

class IdleConnectionsTest : public testing::Test {
 protected:
  // The server starts with a soft limit of descriptors that is below the number of connections.
  void SetUp() override {
    rlimit limit;
    ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &limit), 0);
    if (limit.rlim_max < 2500) GTEST_SKIP() << "the limit of open files cannot be raised above " << limit.rlim_max;
    limit.rlim_cur = 256;
    ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &limit), 0);
    program_ = std::make_unique<Program>(std::vector<std::string>{"--listen", "127.0.0.1:0", "--max-connections",
                                                                  "2000", "--max-connections-per-peer", "2000"});
    limit.rlim_cur = limit.rlim_max;
    ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &limit), 0);
    address_ = program_->Announced("listening on ");
    port_ = PortOf(address_);
    ASSERT_GT(port_, 0);
  }

  int64_t ResidentBytes() const {
    const std::string status = Contents("/proc/" + std::to_string(program_->pid()) + "/status");
    const size_t begin = status.find("VmRSS:") + 6;
    int64_t kilobytes = 0;
    EXPECT_TRUE(absl::SimpleAtoi(status.substr(begin, status.find("kB", begin) - begin), &kilobytes));
    return kilobytes * 1024;
  }

  // Streams a session on a new connection and returns its state at the end.
  v1::SessionHealth Track() const {
    grpc::ChannelArguments own;
    own.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
    const auto channel = grpc::CreateCustomChannel(address_, grpc::InsecureChannelCredentials(), own);
    const auto sessions = v1::SessionService::NewStub(channel);
    v1::Model model;
    EXPECT_TRUE(UploadModel(*v1::ModelService::NewStub(channel), UploadRequests(kCubeObj), &model).ok());
    CreatedSession session;
    grpc::ClientContext create;
    EXPECT_TRUE(sessions->CreateSession(&create, CubeSessionRequest(model.name()), session.response()).ok());
    RawTrack track(*sessions);
    track.Attach(session);
    track.Events(1, Flat64(SomeEvents(1, 301, 20)));
    track.End();
    v1::TrackResponse response;
    EXPECT_TRUE(track.ReadUntil(v1::TrackResponse::kSummary, response));
    EXPECT_TRUE(track.Finish().ok());
    return response.summary().health();
  }

  std::unique_ptr<Program> program_;
  std::string address_;
  int port_ = 0;
};

TEST_F(IdleConnectionsTest, AThousandIdleConnectionsCostLittleAndDelayNoClient) {
  constexpr int kConnections = 1000;
  const uint64_t num_events = Track().decoded_events();
  EXPECT_EQ(num_events, 6000u);
  (void)Track();
  const int64_t before_bytes = ResidentBytes();
  std::vector<std::unique_ptr<IdleConnection>> connections;
  for (int i = 0; i < kConnections; ++i) connections.push_back(std::make_unique<IdleConnection>(port_, i % 2 == 0));
  EXPECT_EQ(Track().decoded_events(), num_events);
  const int64_t grown_bytes = ResidentBytes() - before_bytes;
  RecordProperty("bytes_per_connection", std::to_string(grown_bytes / kConnections));
  if (kCountsMemory) {
    EXPECT_LT(grown_bytes, kConnections * kMaxBytesPerConnection);
  }
  program_->Signal(SIGTERM);
  EXPECT_EQ(program_->Wait(), 0) << "idle connections do not delay the shutdown";
}

}  // namespace
}  // namespace evpose::server

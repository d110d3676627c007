// SPDX-License-Identifier: Apache-2.0

// Tests connections to evpose-server as a process: descriptors that are used up, and probes beside connections that
// send nothing.
#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <boost/asio/read.hpp>
#include <csignal>
#include <deque>
#include <memory>
#include <string>
#include <vector>

#include "evpose/v1/admin_service.grpc.pb.h"
#include "server/http/http_client_testing.h"
#include "server/program/program_testing.h"
#include "server/telemetry/prometheus_testing.h"

namespace evpose::server {
namespace {

class ConnectionsTest : public testing::Test {
 protected:
  void Start(const std::vector<std::string>& more_options) {
    std::vector<std::string> options = {"--listen", "127.0.0.1:0", "--metrics-listen", "127.0.0.1:0"};
    options.insert(options.end(), more_options.begin(), more_options.end());
    program_ = std::make_unique<Program>(options);
    port_ = PortOf(program_->Announced("listening on "));
    metrics_port_ = PortOf(program_->Announced("metrics on "));
  }

  // Connects to the gRPC port. Returns true if the server has accepted the connection and begun with HTTP/2, false if
  // it has closed it.
  bool Connect() {
    boost::asio::ip::tcp::socket& socket = connections_.emplace_back(context_);
    socket.connect({boost::asio::ip::address_v4::loopback(), static_cast<uint16_t>(port_)});
    char byte = 0;
    boost::system::error_code error;
    boost::asio::read(socket, boost::asio::buffer(&byte, 1), error);
    return !error;
  }

  grpc::Status GetServerInfo() const {
    grpc::ChannelArguments own;
    own.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
    const auto channel =
        grpc::CreateCustomChannel("127.0.0.1:" + std::to_string(port_), grpc::InsecureChannelCredentials(), own);
    grpc::ClientContext context;
    context.set_wait_for_ready(true);
    v1::GetServerInfoRequest request;
    v1::ServerInfo info;
    return v1::AdminService::NewStub(channel)->GetServerInfo(&context, request, &info);
  }

  std::unique_ptr<Program> program_;
  int port_ = 0;
  int metrics_port_ = 0;
  boost::asio::io_context context_;
  std::deque<boost::asio::ip::tcp::socket> connections_;
};

TEST_F(ConnectionsTest, ServesAgainAfterItsDescriptorsWereUsedUp) {
  Start({"--max-connections", "1000", "--max-connections-per-peer", "1000"});
  const rlimit few = {.rlim_cur = 64, .rlim_max = 64};
  ASSERT_EQ(prlimit(program_->pid(), RLIMIT_NOFILE, &few, nullptr), 0);
  EXPECT_EQ(Ask(metrics_port_, "/readyz").status, 200);
  while (Connect()) continue;
  const HttpResponse answer = Ask(metrics_port_, "/readyz");
  EXPECT_EQ(answer.status, 503);
  EXPECT_THAT(answer.body, testing::HasSubstr("too few descriptors"));
  EXPECT_EQ(Ask(metrics_port_, "/healthz").status, 200) << "a restart would not help";
  const ParsedMetrics metrics = ParseMetrics(Ask(metrics_port_, "/metrics").body);
  EXPECT_GE(metrics.At("evpose_connections_refused_total{limit=\"descriptors\"}"), 1.0);
  EXPECT_GT(metrics.At("evpose_connections"), 1.0);
  EXPECT_EQ(metrics.At("evpose_listener_stalled"), 1.0);
  EXPECT_THAT(program_->Stderr(), testing::HasSubstr(" descriptors_exhausted "));

  connections_.clear();
  WaitUntilReadyIs(metrics_port_, 200);
  EXPECT_TRUE(GetServerInfo().ok());
  EXPECT_THAT(program_->Stderr(), testing::HasSubstr(" descriptors_free "));
  program_->Signal(SIGTERM);
  EXPECT_EQ(program_->Wait(), 0);
}

TEST_F(ConnectionsTest, ConnectionsBeyondTheLimitAreClosedAtOnce) {
  Start({"--max-connections", "3"});  // one of two addresses may have one
  EXPECT_TRUE(Connect());
  EXPECT_FALSE(Connect());
  EXPECT_EQ(ParseMetrics(Ask(metrics_port_, "/metrics").body)
                .At("evpose_connections_refused_total{limit=\"max_connections_per_peer\"}"),
            1.0);
  EXPECT_EQ(Ask(metrics_port_, "/readyz").status, 200);
  connections_.clear();
  EXPECT_TRUE(GetServerInfo().ok());
}

TEST_F(ConnectionsTest, ProbesAreAnsweredBesideConnectionsThatSendNothing) {
  Start({});
  std::deque<HttpConnection> silent;
  for (int i = 0; i < 30; ++i) silent.emplace_back(metrics_port_).Write("GET /heal");
  EXPECT_EQ(Ask(metrics_port_, "/healthz").status, 200);
  EXPECT_EQ(Ask(metrics_port_, "/readyz").status, 200);
  // The silent connections are open: the last one completes its request.
  silent.back().Write("thz HTTP/1.1\r\n\r\n");
  EXPECT_THAT(silent.back().ReadAll(), testing::HasSubstr("alive"));
}

}  // namespace
}  // namespace evpose::server

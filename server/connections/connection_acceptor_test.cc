// SPDX-License-Identifier: Apache-2.0
#include "server/connections/connection_acceptor.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <atomic>
#include <boost/asio/read.hpp>
#include <deque>
#include <future>
#include <mutex>
#include <string>
#include <vector>

#include "core/base/poll_testing.h"
#include "server/runtime/failing_allocations_testing.h"

namespace evpose::server {
namespace {

using boost::asio::ip::tcp;

class ConnectionAcceptorTest : public testing::Test {
 protected:
  ~ConnectionAcceptorTest() override {
    if (acceptor_ != nullptr) acceptor_->Stop();
    for (const int descriptor : handed_) close(descriptor);
  }

  void Start(ConnectionAcceptor::Options options) {
    options.metrics = metrics_;
    acceptor_ = ConnectionAcceptor::Listen({.host = "127.0.0.1", .port = 0}, std::move(options)).value();
    acceptor_->Start([this](int descriptor) {
      EXPECT_EQ(write(descriptor, "!", 1), 1);
      const std::lock_guard lock(mutex_);
      handed_.push_back(descriptor);
    });
  }
  // A connection from this address. Returns true if it was handed over, false if it was closed.
  bool Connect(const char* from = "127.0.0.1") {
    tcp::socket& socket = clients_.emplace_back(context_);
    socket.open(tcp::v4());
    socket.bind({boost::asio::ip::make_address(from), 0});
    socket.connect({boost::asio::ip::address_v4::loopback(), static_cast<uint16_t>(acceptor_->port())});
    char byte = 0;
    boost::system::error_code error;
    boost::asio::read(socket, boost::asio::buffer(&byte, 1), error);
    return byte == '!';
  }
  // Closes the connections at both ends, as gRPC would close its end.
  void CloseAll() {
    clients_.clear();
    const std::lock_guard lock(mutex_);
    for (const int descriptor : handed_) close(descriptor);
    handed_.clear();
  }
  uint64_t NumRefused(ConnectionRefusal reason) const { return metrics_->connection_refusals[reason].value(); }

  const std::shared_ptr<ServerMetrics> metrics_ = std::make_shared<ServerMetrics>();
  std::unique_ptr<ConnectionAcceptor> acceptor_;
  boost::asio::io_context context_;
  std::deque<tcp::socket> clients_;
  std::mutex mutex_;
  std::vector<int> handed_;
};

TEST_F(ConnectionAcceptorTest, AcceptsUpToItsLimitsAndAgainAfterwards) {
  Start({.max_connections = 3, .max_connections_per_peer = 2});
  EXPECT_TRUE(Connect());
  EXPECT_TRUE(Connect());
  EXPECT_FALSE(Connect()) << "the third of this peer";
  EXPECT_EQ(NumRefused(ConnectionRefusal::kMaxPerPeer), 1u);
  EXPECT_TRUE(Connect("127.0.0.2"));
  EXPECT_FALSE(Connect("127.0.0.3")) << "the fourth of all";
  EXPECT_EQ(NumRefused(ConnectionRefusal::kMaxConnections), 1u);
  EXPECT_EQ(acceptor_->num_connections(), 3u);
  EXPECT_TRUE(acceptor_->status().ok()) << "a full server is ready";
  CloseAll();
  ASSERT_TRUE(Poll([this] { return acceptor_->num_connections() == 0; }));
  EXPECT_TRUE(Connect());
}

TEST_F(ConnectionAcceptorTest, WithoutDescriptorsItIsNotReadyAndThenGoesOn) {
  Start({.max_connections = 1000, .max_connections_per_peer = 1000});
  rlimit before = {};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  rlimit few = before;
  few.rlim_cur = 128;  // of which connections may take 96
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &few), 0);
  int num_accepted = 0;
  while (Connect()) ++num_accepted;
  EXPECT_GT(num_accepted, 1);
  EXPECT_GE(NumRefused(ConnectionRefusal::kDescriptors), 1u);
  EXPECT_THAT(std::string(acceptor_->status().message()), testing::HasSubstr("too few descriptors"));
  const int reserved = dup(0);
  EXPECT_GE(reserved, 0) << "the rest of the process has descriptors left";
  close(reserved);
  CloseAll();
  EXPECT_TRUE(Poll([this] { return acceptor_->status().ok(); }));
  EXPECT_TRUE(Connect());
  setrlimit(RLIMIT_NOFILE, &before);
}

TEST_F(ConnectionAcceptorTest, AFailedAllocationEndsItsConnectionOnly) {
  // Number of allocations of the accepting thread that succeed after the next connection; negative: all.
  std::atomic<int> successes = -1;
  handed_.reserve(100);
  acceptor_ = ConnectionAcceptor::Listen({.host = "127.0.0.1", .port = 0}, {.metrics = metrics_}).value();
  acceptor_->Start([this, &successes](int descriptor) {
    ThisThreadsFailingAllocation().successes_before = successes.exchange(-1);
    EXPECT_EQ(write(descriptor, "!", 1), 1);
    const std::lock_guard lock(mutex_);
    handed_.push_back(descriptor);
  });
  int num_ended = 0;
  for (int i = 0; i < 4; ++i) {
    successes = i;
    EXPECT_TRUE(Connect());
    if (!Connect()) ++num_ended;
    EXPECT_TRUE(Connect());
  }
  EXPECT_GE(num_ended, 1);
}

TEST_F(ConnectionAcceptorTest, ReportsThatItHasStalled) {
  std::promise<void> released, stalled;
  const std::shared_future<void> release = released.get_future().share();
  acceptor_ =
      ConnectionAcceptor::Listen({.host = "127.0.0.1", .port = 0}, {.listener_timeout = absl::Milliseconds(100),
                                                                    .on_stalled = [&stalled] { stalled.set_value(); },
                                                                    .metrics = metrics_})
          .value();
  acceptor_->Start([release](int descriptor) {
    close(descriptor);
    release.wait();  // as a transport that does not return
  });
  EXPECT_FALSE(Connect());
  stalled.get_future().wait();
  EXPECT_TRUE(Poll([this] { return !acceptor_->status().ok(); }));
  released.set_value();
  EXPECT_TRUE(Poll([this] { return acceptor_->status().ok(); }));
  acceptor_->Stop();
}

}  // namespace
}  // namespace evpose::server

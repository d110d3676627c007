// SPDX-License-Identifier: Apache-2.0
#include "server/http/listener_thread.h"

#include <gtest/gtest.h>

#include <atomic>
#include <boost/asio/buffer.hpp>
#include <utility>
#include <vector>

#include "server/http/http_client_testing.h"
#include "server/runtime/failing_allocations_testing.h"

namespace evpose::server {
namespace {

// The sockets stay open, so that each connection needs memory of its own.
TEST(ListenerThreadTest, AFailedAllocationEndsItsConnectionOnly) {
  // Number of allocations of the listener's thread that succeed after the next connection; negative: all.
  std::atomic<int> successes = -1;
  std::vector<ListenerThread::Socket> sockets;
  ListenerThread listener([&](ListenerThread::Socket socket) {
    ThisThreadsFailingAllocation().successes_before = successes.exchange(-1);
    boost::system::error_code ignored;
    socket.write_some(boost::asio::buffer("!", 1), ignored);
    socket.shutdown(ListenerThread::Socket::shutdown_send, ignored);
    sockets.push_back(std::move(socket));
  });
  sockets.reserve(100);
  ASSERT_TRUE(listener.Listen({.host = "127.0.0.1", .port = 0}).ok());
  const auto is_served = [&listener] { return HttpConnection(listener.port()).ReadAll() == "!"; };
  int num_ended = 0;
  for (int i = 0; i < 4; ++i) {
    successes = i;
    EXPECT_TRUE(is_served());
    if (!is_served()) ++num_ended;
    EXPECT_TRUE(is_served()) << "after " << i << " allocations";
  }
  EXPECT_GE(num_ended, 1);
  listener.Stop();
  sockets.clear();
}

}  // namespace
}  // namespace evpose::server

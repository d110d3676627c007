// SPDX-License-Identifier: Apache-2.0
#include "server/connections/listen_address.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

namespace evpose::server {
namespace {

using boost::asio::ip::tcp;

TEST(ListenAddressTest, ReadsHostAndPort) {
  EXPECT_EQ(ParseListenAddress("127.0.0.1:80")->WithPort(81), "127.0.0.1:81");
  EXPECT_EQ(ParseListenAddress("[::1]:0")->WithPort(9), "[::1]:9");
  EXPECT_EQ(ParseListenAddress("[::1]:0")->host, "::1");
  for (const char* bad : {"", "host", ":80", "host:", "host:x", "host:70000", "host:-1", "::1:80"}) {
    EXPECT_EQ(ParseListenAddress(bad).status().code(), absl::StatusCode::kInvalidArgument) << bad;
  }
}

TEST(ListenAddressTest, DetectsAddressesThatOtherMachinesCanReach) {
  for (const char* local : {"127.0.0.1:1", "127.5.0.1:1", "localhost:1", "[::1]:1"}) {
    EXPECT_TRUE(ParseListenAddress(local)->IsLoopback()) << local;
  }
  for (const char* open : {"0.0.0.0:1", "[::]:1", "192.168.1.2:1", "example.org:1", "127.example.org:1"}) {
    EXPECT_FALSE(ParseListenAddress(open)->IsLoopback()) << open;
  }
}

// Whether a client of this address family reaches the port.
bool Reaches(const tcp::endpoint& endpoint) {
  boost::asio::io_context context;
  boost::system::error_code error;
  tcp::socket(context).connect(endpoint, error);
  return !error;
}

TEST(ListenAddressTest, ListensWithOnePortOnAllAddressesOfAName) {
  boost::asio::io_context context;
  for (const char* host : {"localhost:0", "0.0.0.0:0"}) {
    const auto acceptors = ListenOn(context, *ParseListenAddress(host)).value();
    const uint16_t port = acceptors.front().local_endpoint().port();
    EXPECT_GT(port, 0);
    for (const tcp::acceptor& acceptor : acceptors) EXPECT_EQ(acceptor.local_endpoint().port(), port);
    EXPECT_TRUE(Reaches({boost::asio::ip::address_v4::loopback(), port})) << host;
    const bool has_ipv6 = ListenOn(context, *ParseListenAddress("[::1]:0")).ok();
    if (has_ipv6 && acceptors.front().local_endpoint().address().is_unspecified()) {
      EXPECT_TRUE(Reaches({boost::asio::ip::address_v6::loopback(), port})) << host;
    }
  }
}

TEST(ListenAddressTest, AnErrorHasCauseAndRemedy) {
  boost::asio::io_context context;
  const auto first = ListenOn(context, *ParseListenAddress("127.0.0.1:0")).value();
  const std::string taken = "127.0.0.1:" + std::to_string(first.front().local_endpoint().port());
  const auto error = [&context](const std::string& address) {
    const auto acceptors = ListenOn(context, *ParseListenAddress(address));
    EXPECT_EQ(acceptors.status().code(), absl::StatusCode::kUnavailable) << address;
    return std::string(acceptors.status().message());
  };
  EXPECT_THAT(error(taken), testing::HasSubstr("cannot listen on " + taken + ": "));
  EXPECT_THAT(error(taken), testing::HasSubstr("give another, or 0 for a free one"));
  EXPECT_THAT(error("192.0.2.1:0"), testing::HasSubstr("cannot listen on 192.0.2.1:0: "));
  EXPECT_THAT(error("no.such.host.invalid:0"), testing::HasSubstr("cannot listen on no.such.host.invalid:0: "));
}

}  // namespace
}  // namespace evpose::server

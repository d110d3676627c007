// SPDX-License-Identifier: Apache-2.0
#include "server/connections/connection_ledger.h"

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <string>
#include <vector>

namespace evpose::server {
namespace {

using boost::asio::ip::make_address;

int Socket() { return socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0); }

TEST(ConnectionLedgerTest, CountsAllAndThoseOfAPeer) {
  ConnectionLedger ledger(3, 2);
  std::vector<int> sockets;
  const auto add = [&](const char* peer) {
    sockets.push_back(Socket());
    return ledger.Add(sockets.back(), make_address(peer));
  };
  EXPECT_EQ(add("192.0.2.1"), std::nullopt);
  EXPECT_EQ(add("::ffff:192.0.2.1"), std::nullopt);
  EXPECT_EQ(add("192.0.2.1"), ConnectionRefusal::kMaxPerPeer);
  EXPECT_EQ(add("192.0.2.2"), std::nullopt);
  EXPECT_EQ(add("192.0.2.3"), ConnectionRefusal::kMaxConnections);
  EXPECT_EQ(ledger.size(), 3u);
  for (const int descriptor : sockets) close(descriptor);
  EXPECT_EQ(ledger.RemoveClosed(), 3u);
  EXPECT_EQ(ledger.size(), 0u);
}

TEST(ConnectionLedgerTest, AReusedDescriptorIsAnotherConnection) {
  ConnectionLedger ledger(8, 1);
  const int first = Socket();
  EXPECT_EQ(ledger.Add(first, make_address("192.0.2.1")), std::nullopt);
  EXPECT_EQ(ledger.RemoveClosed(), 0u);
  close(first);
  const int other = Socket();  // not a connection of the ledger
  ASSERT_EQ(other, first) << "the kernel gives the lowest free number";
  EXPECT_EQ(ledger.RemoveClosed(), 1u);
  close(other);

  const int second = Socket();
  EXPECT_EQ(ledger.Add(second, make_address("192.0.2.1")), std::nullopt);
  close(second);
  const int third = Socket();
  ASSERT_EQ(third, second);
  EXPECT_EQ(ledger.Add(third, make_address("192.0.2.1")), std::nullopt) << "the former connection is closed";
  EXPECT_EQ(ledger.size(), 1u);
  close(third);
}

TEST(ConnectionLedgerTest, APeerIsAnAddressOrANetwork) {
  EXPECT_EQ(PeerOf(make_address("192.0.2.1")), make_address("192.0.2.1"));
  EXPECT_EQ(PeerOf(make_address("::ffff:192.0.2.1")), make_address("192.0.2.1"));
  EXPECT_EQ(PeerOf(make_address("2001:db8:1:2:3:4:5:6")), PeerOf(make_address("2001:db8:1:2::1")));
  EXPECT_NE(PeerOf(make_address("2001:db8:1:2::1")), PeerOf(make_address("2001:db8:1:3::1")));
}

}  // namespace
}  // namespace evpose::server

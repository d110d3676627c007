// SPDX-License-Identifier: Apache-2.0
#include "server/connections/listener_check.h"

#include <gtest/gtest.h>

#include <string>

namespace evpose::server {
namespace {

using boost::asio::ip::tcp;
using State = ListenerCheck::State;

class ListenerCheckTest : public testing::Test {
 protected:
  boost::asio::io_context context_;
  tcp::acceptor listener_{context_, tcp::endpoint(boost::asio::ip::address_v4::loopback(), 0)};
};

TEST_F(ListenerCheckTest, AListenerThatAcceptsNothingIsStalledAfterSomeSteps) {
  ListenerCheck check(listener_.local_endpoint());
  EXPECT_EQ(check.Step(7), State::kAccepts) << "nothing is known yet";
  for (int i = 1; i < ListenerCheck::kStepsToStall; ++i) EXPECT_EQ(check.Step(7), State::kSilent) << i;
  EXPECT_EQ(check.Step(7), State::kStalled);
  EXPECT_EQ(check.Step(8), State::kAccepts) << "any connection counts";
  EXPECT_EQ(check.Step(8), State::kSilent);
}

TEST_F(ListenerCheckTest, KnowsItsConnection) {
  ListenerCheck check({boost::asio::ip::address_v4::any(), listener_.local_endpoint().port()});
  check.Step(0);
  tcp::endpoint peer;
  const tcp::socket accepted = listener_.accept(peer);
  EXPECT_TRUE(check.IsMine(peer));
  EXPECT_TRUE(check.IsMine({boost::asio::ip::make_address("::ffff:127.0.0.1"), peer.port()}));
  tcp::socket client(context_);
  client.connect(listener_.local_endpoint());
  const tcp::socket other = listener_.accept(peer);
  EXPECT_FALSE(check.IsMine(peer));
}

TEST_F(ListenerCheckTest, AClosedListenerIsSilent) {
  ListenerCheck check(listener_.local_endpoint());
  listener_.close();
  check.Step(0);
  EXPECT_EQ(check.Step(0), State::kSilent);
}

}  // namespace
}  // namespace evpose::server

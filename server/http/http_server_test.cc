// SPDX-License-Identifier: Apache-2.0
#include "server/http/http_server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <deque>
#include <string>

#include "server/http/http_client_testing.h"

namespace evpose::server {
namespace {

using testing::HasSubstr;

class HttpServerTest : public testing::Test {
 protected:
  HttpServerTest() {
    const HttpServer::Pages pages = {
        {"/count", [this](const std::string&) { return HttpPage{.body = std::to_string(++num_made_)}; }},
        {"/broken",
         [](const std::string&) { return HttpPage{.status = 503, .content_type = "text/html", .body = "no\n"}; }},
        {"/large", [](const std::string&) { return HttpPage{.body = std::string(1 << 20, 'x')}; }},
        {"/accept", [](const std::string& accept) { return HttpPage{.body = accept}; }},
    };
    server_ = HttpServer::Start("127.0.0.1:0", pages).value();
    port_ = server_->port();
  }
  static std::string StartError(const std::string& address) {
    const auto started = HttpServer::Start(address, {});
    EXPECT_FALSE(started.ok()) << address;
    return std::string(started.status().message());
  }

  std::atomic<int> num_made_ = 0;
  std::unique_ptr<HttpServer> server_;
  int port_ = 0;
};

TEST_F(HttpServerTest, RendersThePageForEachRequest) {
  const HttpResponse first = Ask(port_, "/count");
  EXPECT_EQ(first.status, 200);
  EXPECT_EQ(first.body, "1");
  EXPECT_THAT(first.head, HasSubstr("Content-Type: text/plain; charset=utf-8\r\n"));
  EXPECT_THAT(first.head, HasSubstr("Content-Length: 1\r\n"));
  EXPECT_EQ(Ask(port_, "/count?what=ever").body, "2");
  EXPECT_EQ(Ask(port_, "/large").body.size(), 1u << 20);
  const HttpResponse broken = Ask(port_, "/broken");
  EXPECT_EQ(broken.status, 503);
  EXPECT_EQ(broken.body, "no\n");
  EXPECT_THAT(broken.head, HasSubstr("Content-Type: text/html\r\n"));
}

TEST_F(HttpServerTest, ThePageDependsOnTheHeaderAccept) {
  EXPECT_EQ(Ask(port_, "/accept").body, "");
  EXPECT_EQ(Ask(port_, "/accept", "GET", "", "Accept: a/b;q=0.5\r\naccept: c/d\r\n").body, "a/b;q=0.5,c/d");
}

TEST_F(HttpServerTest, HeadIsThePageWithoutItsBody) {
  const HttpResponse answer = Ask(port_, "/count", "HEAD");
  EXPECT_EQ(answer.status, 200);
  EXPECT_THAT(answer.head, HasSubstr("Content-Length: 1\r\n"));
  EXPECT_EQ(answer.body, "");
}

TEST_F(HttpServerTest, RejectsOtherMethodsAndTheirBodies) {
  for (const char* method : {"POST", "PUT", "DELETE", "OPTIONS", "PATCH"}) {
    const HttpResponse answer = Ask(port_, "/count", method, "some body");
    EXPECT_EQ(answer.status, 405) << method;
    EXPECT_THAT(answer.head, HasSubstr("Allow: GET, HEAD\r\n")) << method;
  }
  EXPECT_EQ(Ask(port_, "/count", "NONSENSE").status, 400);
  EXPECT_EQ(num_made_, 0);
}

TEST_F(HttpServerTest, UnknownPathsAreNotFound) {
  for (const char* path : {"/", "/counts", "/count/", "/../etc/passwd", "/%2e%2e/etc/passwd", "/COUNT"}) {
    EXPECT_EQ(Ask(port_, path).status, 404) << path;
  }
  EXPECT_THAT(Ask(port_, "/").body, HasSubstr("/broken /count /large"));
  EXPECT_EQ(num_made_, 0);
}

TEST_F(HttpServerTest, InvalidHttpDoesNotStopTheServer) {
  for (const std::string& bytes : {std::string("nonsense\r\n\r\n"), std::string(64, '\0') + "\r\n\r\n",
                                   "GET /count HTTP/1.1\r\nX: " + std::string(100'000, 'x') + "\r\n\r\n"}) {
    HttpConnection connection(port_);
    connection.Write(bytes);
    EXPECT_THAT(connection.ReadAll(), testing::Not(HasSubstr("200 OK")));
  }
  EXPECT_EQ(Ask(port_, "/count").body, "1");
}

TEST_F(HttpServerTest, SilentClientsDoNotDelayOthers) {
  std::deque<HttpConnection> silent;
  for (int i = 0; i < 30; ++i) silent.emplace_back(port_).Write("GET /co");
  EXPECT_EQ(Ask(port_, "/count").body, "1");
  silent.back().Write("unt HTTP/1.1\r\n\r\n");
  EXPECT_THAT(silent.back().ReadAll(), HasSubstr("\r\n\r\n2")) << "it was still open";
}

TEST_F(HttpServerTest, ClosesTheOldestOfTooManyConnections) {
  std::deque<HttpConnection> silent;
  for (int i = 0; i < 200; ++i) silent.emplace_back(port_).Write("GET /co");
  EXPECT_EQ(Ask(port_, "/count").body, "1");
  for (int i = 0; i < 160; ++i) EXPECT_EQ(silent[static_cast<size_t>(i)].ReadAll(), "") << i;
}

// A probe that is delayed between its connection and its request, while another address connects continuously.
TEST_F(HttpServerTest, AFloodOfConnectionsClosesNoneOfAnotherAddress) {
  std::deque<HttpConnection> flood;
  const auto connect = [&](int count) {
    for (int i = 0; i < count; ++i) flood.emplace_back(port_, "127.0.0.2");
  };
  connect(100);
  HttpConnection probe(port_), half(port_);
  half.Write("GET /co");
  connect(200);
  EXPECT_EQ(Ask(port_, "/count").body, "1") << "the 200 have been accepted before it";
  probe.Write("GET /count HTTP/1.1\r\n\r\n");
  EXPECT_THAT(probe.ReadAll(), HasSubstr("\r\n\r\n2"));
  half.Write("unt HTTP/1.1\r\n\r\n");
  EXPECT_THAT(half.ReadAll(), HasSubstr("\r\n\r\n3"));
  for (size_t i = 0; i < 200; ++i) EXPECT_EQ(flood[i].ReadAll(), "") << i;
}

TEST_F(HttpServerTest, TwoAtATime) {
  const auto second =
      HttpServer::Start("localhost:0", {{"/", [](const std::string&) { return HttpPage{.body = "second"}; }}}).value();
  EXPECT_NE(second->port(), port_);
  EXPECT_EQ(Ask(second->port(), "/").body, "second");
  EXPECT_EQ(Ask(port_, "/count").body, "1");
}

TEST_F(HttpServerTest, AnErrorExplainsWhyItCannotListen) {
  const std::string taken = "127.0.0.1:" + std::to_string(port_);
  EXPECT_THAT(StartError(taken), testing::MatchesRegex("cannot listen on " + taken + ": .*in use.*give another.*"));
  EXPECT_THAT(StartError("nowhere"), HasSubstr("has no port"));
  EXPECT_THAT(StartError("127.0.0.1:70000"), HasSubstr("0 to 65535"));
  EXPECT_THAT(StartError("no.such.host.invalid:0"), HasSubstr("cannot listen on no.such.host.invalid:0: "));
  EXPECT_THAT(StartError("192.0.2.1:0"), HasSubstr("cannot listen on 192.0.2.1:0: "));
}

}  // namespace
}  // namespace evpose::server

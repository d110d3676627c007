// SPDX-License-Identifier: Apache-2.0

// Tests a client of one address behind which a load balancer of connections, such as a Service of Kubernetes, has two
// servers. One of them refuses sessions and streams.
#include "client/lib/endpoint.h"

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <grpcpp/server.h>
#include <grpcpp/server_builder.h>
#include <grpcpp/server_posix.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/synchronization/notification.h"
#include "client/lib/client_access.h"
#include "client/lib/fake_clock_testing.h"
#include "client/lib/messages/status_details.h"
#include "client/lib/stream/scripted_server_testing.h"
#include "evpose/client.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

// A server behind the balancer. Its calls are recorded, and end with `refusal` unless that is OK.
class ServerBehind final : private v1::SessionService::Service, private v1::AdminService::Service {
 public:
  ServerBehind() {
    grpc::ServerBuilder builder;
    builder.RegisterService(static_cast<v1::SessionService::Service*>(this));
    builder.RegisterService(static_cast<v1::AdminService::Service*>(this));
    server_ = builder.BuildAndStart();
  }
  ~ServerBehind() override { server_->Shutdown(); }

  std::vector<std::string> TakeCalls() {
    const std::lock_guard lock(mutex_);
    return std::exchange(calls_, {});
  }
  // `socket`: a connection that a client has made.
  void Accept(int socket) { grpc::AddInsecureChannelFromFd(server_.get(), socket); }

  grpc::Status refusal;
  absl::Notification ends_streams;  // a stream is open until then

 private:
  grpc::Status Record(const std::string& call) {
    const std::lock_guard lock(mutex_);
    calls_.push_back(call);
    return refusal;
  }
  grpc::Status GetServerInfo(grpc::ServerContext*, const v1::GetServerInfoRequest*, v1::ServerInfo*) override {
    Record("GetServerInfo").ok();
    return grpc::Status::OK;
  }
  grpc::Status CreateSession(grpc::ServerContext*, const v1::CreateSessionRequest*,
                             v1::CreateSessionResponse* response) override {
    response->mutable_session()->set_name("sessions/1");
    return Record("CreateSession");
  }
  grpc::Status GetSession(grpc::ServerContext*, const v1::GetSessionRequest*, v1::Session*) override {
    return Record("GetSession");
  }
  grpc::Status Track(grpc::ServerContext*, ServerStream* stream) override {
    const grpc::Status status = Record("Track");
    if (!status.ok()) return status;
    stream->Write(Attached(1000));
    ReadToEnd(*stream);
    ends_streams.WaitForNotification();
    stream->Write(SummaryMessage(0));
    return status;
  }

  std::mutex mutex_;
  std::vector<std::string> calls_;  // guarded by mutex_
  std::unique_ptr<grpc::Server> server_;
};

// Gives the connections to the servers in turn.
class Balancer {
 public:
  explicit Balancer(std::vector<ServerBehind*> servers) : listener_(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in place = {};
    place.sin_family = AF_INET;
    place.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof(place);
    auto* const generic = reinterpret_cast<sockaddr*>(&place);
    EXPECT_EQ(bind(listener_, generic, size), 0);
    EXPECT_EQ(listen(listener_, 16), 0);
    EXPECT_EQ(getsockname(listener_, generic, &size), 0);
    address = "127.0.0.1:" + std::to_string(ntohs(place.sin_port));
    thread_ = std::thread([this, servers] {
      for (size_t n = 0;; ++n) {
        const int connection = accept4(listener_, nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC);
        if (connection < 0) return;
        servers[n % servers.size()]->Accept(connection);
      }
    });
  }
  ~Balancer() { Stop(); }
  // Refuses further connections.
  void Stop() {
    if (!thread_.joinable()) return;
    shutdown(listener_, SHUT_RDWR);
    thread_.join();
    close(listener_);
  }

  std::string address;

 private:
  const int listener_;
  std::thread thread_;
};

class EndpointTest : public ::testing::Test {
 protected:
  void SetUp() override {
    client_ = Client::Connect(balancer_.address).value();
    ClientAccess::SetClock(*client_, clock_);
    EXPECT_THAT(full_.TakeCalls(), ElementsAre("GetServerInfo"));
  }
  absl::StatusOr<TrackSummary> Track() {
    Session session;
    session.name = "sessions/1";
    session.resume_token = "secret";
    TrackOptions options;
    options.clock = &clock_;
    TrackCallbacks callbacks;
    callbacks.on_connection = [this](const ConnectionChange& change) { causes_.push_back(change.cause); };
    return client_->Track(
        session, [] { return EventChunk{}; }, callbacks, options);
  }

  FakeClock clock_;
  ServerBehind full_;
  ServerBehind free_;
  Balancer balancer_{{&full_, &free_}};
  std::unique_ptr<Client> client_;
  std::vector<absl::Status> causes_;
};

TEST_F(EndpointTest, ARefusedSessionIsCreatedAtTheServerOfANewConnection) {
  for (const char* reason : {"OVERLOADED", "TOO_MANY_SESSIONS", "SESSION_MEMORY", "OUT_OF_MEMORY"}) {
    full_.refusal = Refusal(reason, 5);
    const absl::Time begin = clock_.Now();
    const absl::Status status = client_->CreateSession({}).status();
    EXPECT_TRUE(status.ok()) << reason << ": " << status;
    EXPECT_EQ(clock_.Now() - begin, absl::Seconds(5));
    EXPECT_TRUE(client_->GetSession("sessions/1").ok());
    EXPECT_THAT(full_.TakeCalls(), ElementsAre("CreateSession"));
    EXPECT_THAT(free_.TakeCalls(), ElementsAre("CreateSession", "GetSession"));
    client_ = Client::Connect(balancer_.address).value();
    ClientAccess::SetClock(*client_, clock_);
    full_.TakeCalls();
  }
}

TEST_F(EndpointTest, TheCallAfterARefusalHasANewConnection) {
  full_.refusal = Refusal("OVERLOADED", 5);
  EXPECT_EQ(client_->CreateSession({}, "", absl::ZeroDuration()).status().code(), absl::StatusCode::kResourceExhausted);
  EXPECT_THAT(free_.TakeCalls(), IsEmpty());
  EXPECT_TRUE(client_->CreateSession({}, "", absl::ZeroDuration()).ok());
  EXPECT_THAT(free_.TakeCalls(), ElementsAre("CreateSession"));
}

TEST_F(EndpointTest, ARefusedStreamAttachesAtTheServerOfANewConnection) {
  for (const char* reason : {"TOO_MANY_SESSIONS", "TENANT_QUOTA"}) {
    causes_.clear();
    full_.refusal = Refusal(reason, 5);
    if (!free_.ends_streams.HasBeenNotified()) free_.ends_streams.Notify();
    const absl::Status status = Track().status();
    EXPECT_TRUE(status.ok()) << status;
    EXPECT_THAT(full_.TakeCalls(), ElementsAre("Track"));
    EXPECT_THAT(free_.TakeCalls(), ElementsAre("Track"));
    ASSERT_EQ(causes_.size(), 2u) << "a refusal and an attach";
    EXPECT_EQ(causes_[0].code(), absl::StatusCode::kResourceExhausted);
    client_ = Client::Connect(balancer_.address).value();
    full_.TakeCalls();
  }
}

TEST_F(EndpointTest, AStreamKeepsItsConnectionWhileASessionIsRefused) {
  std::thread stream([this] { EXPECT_TRUE(Track().ok()); });
  while (full_.TakeCalls().empty()) std::this_thread::yield();
  full_.refusal = Refusal("OVERLOADED", 5);
  const absl::Status status = client_->CreateSession({}).status();
  EXPECT_TRUE(status.ok()) << status;
  EXPECT_THAT(free_.TakeCalls(), ElementsAre("CreateSession"));
  full_.ends_streams.Notify();
  stream.join();
  EXPECT_THAT(causes_, IsEmpty()) << "the stream was broken";
}

TEST_F(EndpointTest, TheConnectionRemainsIfThereIsNoNewOne) {
  full_.refusal = Refusal("OVERLOADED", 5);
  balancer_.Stop();
  EXPECT_EQ(client_->CreateSession({}, "", absl::Seconds(9)).status().message(),
            balancer_.address + ": because of OVERLOADED; gave up after 1 more tries in 5s");
  EXPECT_THAT(full_.TakeCalls(), ElementsAre("CreateSession", "CreateSession"));
}

}  // namespace
}  // namespace evpose::client

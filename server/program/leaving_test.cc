// SPDX-License-Identifier: Apache-2.0

// Tests the shutdown of evpose-server while unresponsive clients are attached.
#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <memory>
#include <string>

#include "absl/strings/str_cat.h"
#include "evpose/v1/admin_service.grpc.pb.h"
#include "evpose/v1/model_service.grpc.pb.h"
#include "evpose/v1/session_service.grpc.pb.h"
#include "grpc/health/v1/health.grpc.pb.h"
#include "server/program/program_testing.h"
#include "server/rpc/raw_requests_testing.h"
#include "server/sessions/session_testing.h"

namespace evpose::server {
namespace {

TEST(StartTest, ASignalEndsAStartThatWaitsForTheStore) {
  using boost::asio::ip::tcp;
  boost::asio::io_context context;
  tcp::acceptor silent(context, {boost::asio::ip::address_v4::loopback(), 0});
  const std::string store = absl::StrCat("redis://127.0.0.1:", silent.local_endpoint().port());
  Program program({"--listen", "127.0.0.1:0", "--store", store});
  const tcp::socket connection = silent.accept();
  program.Signal(SIGTERM);
  EXPECT_EQ(program.Wait(), -SIGTERM) << program.Stderr();
  EXPECT_THAT(program.Stderr(), testing::HasSubstr("signal 15 ended the start"));
}

class LeavingTest : public testing::Test {
 protected:
  void Start(const std::string& shutdown_timeout_s, const std::string& shutdown_notice_s = "0") {
    program_ = std::make_unique<Program>(std::vector<std::string>{
        "--listen", "127.0.0.1:0", "--shutdown-timeout", shutdown_timeout_s, "--shutdown-notice", shutdown_notice_s});
    const std::string address = program_->Announced("listening on ");
    // Keeps the flow-control windows small: gRPC would let them grow to many MB, even when the client does not read.
    grpc::ChannelArguments arguments;
    arguments.SetInt(GRPC_ARG_HTTP2_BDP_PROBE, 0);
    arguments.SetInt(GRPC_ARG_HTTP2_STREAM_LOOKAHEAD_BYTES, 16 * 1024);
    const auto channel = grpc::CreateCustomChannel(address, grpc::InsecureChannelCredentials(), arguments);
    sessions_ = v1::SessionService::NewStub(channel);
    models_ = v1::ModelService::NewStub(channel);
    admin_ = v1::AdminService::NewStub(channel);
    health_ = grpc::health::v1::Health::NewStub(channel);
  }

  void AwaitNotServing() {
    grpc::ClientContext context;
    const auto changes = health_->Watch(&context, {});
    grpc::health::v1::HealthCheckResponse health;
    while (changes->Read(&health) && health.status() == grpc::health::v1::HealthCheckResponse::SERVING) continue;
    EXPECT_EQ(health.status(), grpc::health::v1::HealthCheckResponse::NOT_SERVING);
    context.TryCancel();
    changes->Finish();
  }

  CreatedSession CreateSession() {
    CreatedSession session;
    grpc::ClientContext context;
    v1::Model model;
    EXPECT_TRUE(UploadModel(*models_, UploadRequests(kCubeObj), &model).ok());
    v1::CreateSessionRequest request = CubeSessionRequest(model.name());
    request.mutable_config()->mutable_objects(0)->clear_initial_camera_from_object();
    EXPECT_TRUE(sessions_->CreateSession(&context, request, session.response()).ok());
    return session;
  }

  std::unique_ptr<RawTrack> Attach(const CreatedSession& session) {
    auto track = std::make_unique<RawTrack>(*sessions_);
    EXPECT_TRUE(track->Attach(session));
    v1::TrackResponse response;
    EXPECT_TRUE(track->Read(response));
    return track;
  }
  // Makes the server send one notice for each chunk, more than windows and queues hold.
  void FillTheWindow(const CreatedSession& session, RawTrack& track) {
    constexpr uint64_t kChunks = 6000;
    const std::string outside = Flat64({{1000, 5000, 5000, 1}});
    for (uint64_t seq = 1; seq <= kChunks; ++seq) ASSERT_TRUE(track.Events(seq, outside));
    // The session stops processing before the last chunk.
    CreatedSession state;
    uint64_t processed = 0, same = 0;
    while (same < 20) {
      grpc::ClientContext context;
      v1::GetSessionRequest request;
      request.set_name(session.name());
      ASSERT_TRUE(sessions_->GetSession(&context, request, state.mutable_session()).ok());
      same = state.health().processed_bytes() == processed && processed >= 1024 * outside.size() ? same + 1 : 0;
      processed = state.health().processed_bytes();
      ASSERT_LT(processed, kChunks * outside.size()) << "the window is too large to be filled by the notices";
    }
  }

  static void AwaitGoAway(RawTrack& track) {
    v1::TrackResponse response;
    do {
      ASSERT_TRUE(track.Read(response));
    } while (!response.notice().has_go_away());
  }
  // Ends the session; its summary is the last message.
  static void End(RawTrack& track) {
    ASSERT_TRUE(track.End());
    v1::TrackResponse response;
    while (track.Read(response)) continue;
    EXPECT_TRUE(response.has_summary());
    EXPECT_TRUE(track.Finish().ok());
  }

  std::unique_ptr<Program> program_;
  std::unique_ptr<v1::SessionService::Stub> sessions_;
  std::unique_ptr<v1::ModelService::Stub> models_;
  std::unique_ptr<v1::AdminService::Stub> admin_;
  std::unique_ptr<grpc::health::v1::Health::Stub> health_;
};

void Cancel(RawTrack& track) {
  track.Cancel();
  track.Finish();
}

TEST_F(LeavingTest, ExitsWithStalledClientsAttached) {
  for (const bool by_signal : {true, false}) {
    Start("3");
    const auto silent = Attach(CreateSession());
    const CreatedSession session = CreateSession();
    const auto full = Attach(session);
    FillTheWindow(session, *full);
    grpc::ClientContext watch_context;
    v1::WatchHealthRequest watch;
    watch.set_session(session.name());
    watch.mutable_period()->set_nanos(10'000'000);
    const auto watcher = sessions_->WatchHealth(&watch_context, watch);  // never read from
    RawTrack unattached(*sessions_);  // last: the server ends it if it does not attach in time

    if (by_signal) {
      program_->Signal(SIGTERM);
    } else {
      grpc::ClientContext context;
      v1::DrainRequest request;
      request.mutable_timeout()->set_seconds(2);
      v1::DrainResponse response;
      ASSERT_TRUE(admin_->Drain(&context, request, &response).ok());
      EXPECT_EQ(response.remaining_sessions(), 2u);
    }
    EXPECT_EQ(unattached.Finish().error_code(), grpc::StatusCode::UNAVAILABLE)
        << "a stream that has not attached has nothing to finish";
    EXPECT_EQ(program_->Wait(), 0);
    EXPECT_THAT(program_->Stderr(), testing::HasSubstr("all streams are finished"));
    Cancel(*silent);
    Cancel(*full);
    watch_context.TryCancel();
  }
}

TEST_F(LeavingTest, ASecondSignalEndsItAtOnce) {
  for (const bool is_drained : {false, true}) {
    Start("100000");
    const auto silent = Attach(CreateSession());
    if (is_drained) {
      grpc::ClientContext context;
      v1::DrainResponse response;
      ASSERT_TRUE(admin_->Drain(&context, {}, &response).ok());
    } else {
      program_->Signal(SIGTERM);
    }
    // The GoAway shows that the server has received the first signal.
    AwaitGoAway(*silent);
    // The GoAway may arrive before the main thread can take a second signal; so the signal is repeated until the
    // process ends.
    program_->SignalUntilExit(SIGINT);
    EXPECT_EQ(program_->Wait(), -SIGINT);
    Cancel(*silent);
  }
}

// During the shutdown notice the server accepts and serves new clients, and its health tells load balancers to send
// none.
TEST_F(LeavingTest, TheShutdownNoticePrecedesGoAway) {
  Start("100000", "100000");
  program_->Signal(SIGTERM);
  AwaitNotServing();
  const auto late = Attach(CreateSession());
  grpc::ClientContext context;
  v1::DrainRequest drain;
  drain.mutable_timeout()->set_seconds(3661);
  v1::DrainResponse drained;
  ASSERT_TRUE(admin_->Drain(&context, drain, &drained).ok()) << "a Drain call skips the notice";
  EXPECT_EQ(drained.remaining_sessions(), 1u);
  AwaitGoAway(*late);
  End(*late);
  EXPECT_EQ(program_->Wait(), 0);
  const std::string log = program_->Stderr();
  EXPECT_THAT(log, testing::HasSubstr("server_leaving"));
  EXPECT_THAT(log, testing::HasSubstr("1h1m1s")) << "the timeout of the Drain call";
}

TEST_F(LeavingTest, ASecondSignalEndsTheNoticeAndTheServer) {
  Start("100000", "100000");
  program_->Signal(SIGTERM);
  AwaitNotServing();
  const auto late = Attach(CreateSession());
  program_->SignalUntilExit(SIGTERM);
  EXPECT_EQ(program_->Wait(), -SIGTERM);
  Cancel(*late);
}

TEST_F(LeavingTest, TheNoticeEndsAfterItsTime) {
  Start("100000", "0.01");
  const auto silent = Attach(CreateSession());
  program_->Signal(SIGTERM);
  AwaitGoAway(*silent);
  program_->SignalUntilExit(SIGINT);
  EXPECT_EQ(program_->Wait(), -SIGINT);
  Cancel(*silent);
}

TEST_F(LeavingTest, ASecondDrainChangesNothing) {
  Start("100000");
  auto silent = Attach(CreateSession());
  v1::DrainRequest request;
  v1::DrainResponse response;
  for (int i = 0; i < 3; ++i) {
    grpc::ClientContext context;
    ASSERT_TRUE(admin_->Drain(&context, request, &response).ok());
    request.mutable_timeout()->set_seconds(0);  // a later Drain call changes nothing, also with a shorter timeout
  }
  EXPECT_EQ(response.remaining_sessions(), 1u);
  End(*silent);
  EXPECT_EQ(program_->Wait(), 0) << "no stream is left";
}

}  // namespace
}  // namespace evpose::server

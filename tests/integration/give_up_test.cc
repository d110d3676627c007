// SPDX-License-Identifier: Apache-2.0

// Tests replays that a fake server ends with an error: the poses received before are kept.
#include <gmock/gmock.h>
#include <grpcpp/server.h>
#include <grpcpp/server_builder.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <memory>
#include <string>

#include "client/lib/fake_clock_testing.h"
#include "client/lib/stream/scripted_server_testing.h"
#include "evpose/v1/admin_service.grpc.pb.h"
#include "evpose/v1/model_service.grpc.pb.h"
#include "evpose/v1/session_service.grpc.pb.h"
#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

class FakeAdmin final : public v1::AdminService::Service {
 public:
  grpc::Status GetServerInfo(grpc::ServerContext*, const v1::GetServerInfoRequest*, v1::ServerInfo*) override {
    return grpc::Status::OK;
  }
};

class FakeModels final : public v1::ModelService::Service {
 public:
  grpc::Status UploadModel(grpc::ServerContext*, grpc::ServerReader<v1::UploadModelRequest>* reader,
                           v1::Model* model) override {
    v1::UploadModelRequest request;
    while (reader->Read(&request)) continue;
    model->set_name("models/1");
    return grpc::Status::OK;
  }
};

// Sends poses after the first chunk, and ends the stream with an error.
class FailingSessions final : public v1::SessionService::Service {
 public:
  grpc::Status CreateSession(grpc::ServerContext*, const v1::CreateSessionRequest*,
                             v1::CreateSessionResponse* response) override {
    if (num_refusals > 0) {
      --num_refusals;
      return client::Refusal("OVERLOADED", 30);
    }
    response->mutable_session()->set_name("sessions/1");
    return grpc::Status::OK;
  }
  grpc::Status DeleteSession(grpc::ServerContext*, const v1::DeleteSessionRequest*, google::protobuf::Empty*) override {
    ++num_deleted;
    return grpc::Status::OK;
  }
  grpc::Status Track(grpc::ServerContext*, client::ServerStream* stream) override {
    v1::TrackRequest request;
    if (num_streams++ > 0 || !stream->Read(&request)) return {grpc::StatusCode::UNAVAILABLE, "unreachable"};
    stream->Write(client::Attached(1 << 20));
    stream->Read(&request);
    for (uint64_t seq = 1; seq <= num_poses; ++seq) {
      v1::TrackResponse pose = client::PoseMessage(seq);
      pose.mutable_pose()->set_object_id(object_id);
      pose.mutable_pose()->set_state(state);
      pose.mutable_pose()->set_t_us(16'000'000 + 1000 * static_cast<int64_t>(seq));
      stream->Write(pose);
    }
    return end;
  }

  grpc::Status end;
  uint64_t num_poses = 3;
  std::string object_id = "object";
  v1::TrackState state = v1::TRACK_STATE_TRACKING;
  int num_refusals = 0;  // creations that are still refused
  std::atomic<int> num_streams = 0;
  std::atomic<int> num_deleted = 0;
};

class GiveUpTest : public CliTest {
 protected:
  void SetUp() override {
    CliTest::SetUp();
    SimulateCube(0.02);
    grpc::ServerBuilder builder;
    int port = 0;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
    builder.RegisterService(&admin_);
    builder.RegisterService(&models_);
    builder.RegisterService(&sessions_);
    server_ = builder.BuildAndStart();
    address_ = "127.0.0.1:" + std::to_string(port);
  }
  void TearDown() override {
    server_->Shutdown();
    CliTest::TearDown();
  }

  // Returns the error of a replay.
  std::string Replay() {
    const CliResult result = Run(ReplayArguments("poses.tum", {"--server", address_}), &clock_);
    EXPECT_EQ(result.status, 1) << result.out;
    return result.err;
  }
  int NumWritten() const {
    const std::string poses = ReadText("poses.tum");
    return static_cast<int>(std::count(poses.begin(), poses.end(), '\n'));
  }

  client::FakeClock clock_;
  FakeAdmin admin_;
  FakeModels models_;
  FailingSessions sessions_;
  std::unique_ptr<grpc::Server> server_;
  std::string address_;
};

TEST_F(GiveUpTest, AnErrorOfTheServerKeepsThePoses) {
  sessions_.end = client::WithReason(grpc::StatusCode::INTERNAL, "STORE_FAILED");
  EXPECT_THAT(Replay(), AllOf(HasSubstr("because of STORE_FAILED"),
                              HasSubstr("; " + Path("poses.tum") + ": 3 poses up to 16.003000 s\n")));
  EXPECT_EQ(NumWritten(), 3);
  EXPECT_EQ(sessions_.num_deleted, 1);
}

TEST_F(GiveUpTest, AnOverloadedServerIsAskedAgainWhenItSays) {
  sessions_.num_refusals = 3;
  sessions_.end = client::WithReason(grpc::StatusCode::INTERNAL, "STORE_FAILED");
  const absl::Time begin = clock_.Now();
  EXPECT_THAT(Replay(), HasSubstr("because of STORE_FAILED"));
  EXPECT_EQ(NumWritten(), 3) << "the fourth creation was accepted";
  EXPECT_GE(clock_.Now() - begin, absl::Seconds(90)) << "30 s after each refusal";
}

TEST_F(GiveUpTest, AServerThatStaysOverloadedIsGivenUp) {
  sessions_.num_refusals = 100;
  EXPECT_THAT(Replay(), HasSubstr("because of OVERLOADED"));
  EXPECT_GT(sessions_.num_refusals, 90) << "four in the two minutes of an outage";
  EXPECT_EQ(sessions_.num_streams, 0);
}

TEST_F(GiveUpTest, ALongOutageKeepsThePoses) {
  sessions_.end = grpc::Status(grpc::StatusCode::UNAVAILABLE, "unreachable");
  EXPECT_THAT(Replay(),
              AllOf(HasSubstr("gave up after"), HasSubstr(Path("poses.tum") + ": 3 poses up to 16.003000 s\n")));
  EXPECT_EQ(NumWritten(), 3);
  EXPECT_GT(sessions_.num_streams, 1);
}

TEST_F(GiveUpTest, AFullStoreKeepsThePosesAndTheSession) {
  sessions_.end = client::WithReason(grpc::StatusCode::RESOURCE_EXHAUSTED, "STORE_FULL");
  EXPECT_THAT(Replay(), AllOf(HasSubstr(": 3 poses up to 16.003000 s; sessions/1 is kept until it expires"),
                              HasSubstr("only a run with --resume FILE can continue\n")));
  EXPECT_EQ(NumWritten(), 3);
  EXPECT_EQ(sessions_.num_deleted, 0);
}

TEST_F(GiveUpTest, WithoutAPoseAnEarlierFileStays) {
  WriteText("poses.tum", "earlier\n");
  sessions_.num_poses = 0;
  sessions_.end = client::WithReason(grpc::StatusCode::INTERNAL, "STORE_FAILED");
  EXPECT_THAT(Replay(), ::testing::Not(HasSubstr("poses.tum")));
  EXPECT_EQ(ReadText("poses.tum"), "earlier\n");
}

TEST_F(GiveUpTest, WithAmbiguousPosesOnlyAnEarlierTumFileStays) {
  WriteText("poses.tum", "earlier\n");
  sessions_.state = v1::TRACK_STATE_AMBIGUOUS;
  sessions_.end = client::WithReason(grpc::StatusCode::INTERNAL, "STORE_FAILED");
  EXPECT_THAT(Replay(),
              HasSubstr("; " + Path("poses.tum") +
                        ": not written, because there is no pose for it; the earlier file stays as it was\n"));
  EXPECT_EQ(ReadText("poses.tum"), "earlier\n");
  EXPECT_EQ(FilesBeginning("poses.tum").size(), 1u) << "no temporary file";
}

TEST_F(GiveUpTest, APoseOfAnotherObjectIsRefused) {
  WriteText("poses.tum", "earlier\n");
  sessions_.object_id = "../../etc/x";
  EXPECT_THAT(Replay(),
              HasSubstr("the server violates the protocol: pose 1: the session has no object \"../../etc/x\""));
  EXPECT_EQ(ReadText("poses.tum"), "earlier\n");
}

}  // namespace
}  // namespace evpose

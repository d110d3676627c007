// SPDX-License-Identifier: Apache-2.0

// Tests calls of a client with two servers. One of the servers stops, or refuses the call.
#include "client/lib/server_choice.h"

#include <gmock/gmock.h>
#include <grpcpp/create_channel.h>
#include <grpcpp/server.h>
#include <grpcpp/server_builder.h>
#include <gtest/gtest.h>

#include <chrono>
#include <functional>
#include <memory>
#include <mutex>
#include <stop_token>
#include <string>
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
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// One of two servers. Its calls are recorded, and end with `status`.
class OneOfTwo final : private v1::SessionService::Service,
                       private v1::ModelService::Service,
                       private v1::AdminService::Service {
 public:
  explicit OneOfTwo(const std::string& listen = "127.0.0.1:0") {
    int port = 0;
    grpc::ServerBuilder builder;
    builder.AddListeningPort(listen, grpc::InsecureServerCredentials(), &port);
    builder.RegisterService(static_cast<v1::SessionService::Service*>(this));
    builder.RegisterService(static_cast<v1::ModelService::Service*>(this));
    builder.RegisterService(static_cast<v1::AdminService::Service*>(this));
    server_ = builder.BuildAndStart();
    EXPECT_NE(server_, nullptr) << listen << " is taken";
    address = "127.0.0.1:" + std::to_string(port);
  }
  ~OneOfTwo() override { Stop(); }

  // Ends the calls, and refuses connections.
  void Stop() {
    if (server_ == nullptr) return;
    stops_.Notify();
    server_->Shutdown(std::chrono::system_clock::now());
    server_ = nullptr;
  }
  std::vector<std::string> TakeCalls() {
    const std::lock_guard lock(mutex_);
    return std::exchange(calls_, {});
  }

  std::string address;
  grpc::Status status;
  std::function<void()> on_call = [] {};
  std::vector<std::string> request_ids;
  uint64_t first_pose_seq = 1;  // of the only pose that WatchPoses() delivers
  bool stays = false;           // streams stay open until the server stops

 private:
  grpc::Status Record(const std::string& call) {
    {
      const std::lock_guard lock(mutex_);
      calls_.push_back(call);
    }
    on_call();
    return status;
  }
  grpc::Status EndOfStream() {
    if (!stays) return status;
    stops_.WaitForNotification();
    return {grpc::StatusCode::UNAVAILABLE, "the server stops"};
  }

  grpc::Status CreateSession(grpc::ServerContext*, const v1::CreateSessionRequest* request,
                             v1::CreateSessionResponse* response) override {
    request_ids.push_back(request->request_id());
    response->mutable_session()->set_name("sessions/1");
    return Record("CreateSession");
  }
  grpc::Status GetSession(grpc::ServerContext*, const v1::GetSessionRequest*, v1::Session*) override {
    return Record("GetSession");
  }
  grpc::Status ListSessions(grpc::ServerContext*, const v1::ListSessionsRequest*, v1::ListSessionsResponse*) override {
    return Record("ListSessions");
  }
  grpc::Status DeleteSession(grpc::ServerContext*, const v1::DeleteSessionRequest* request,
                             google::protobuf::Empty*) override {
    return Record(request->allow_missing() ? "DeleteSession if any" : "DeleteSession");
  }
  grpc::Status WatchPoses(grpc::ServerContext*, const v1::WatchPosesRequest* request,
                          grpc::ServerWriter<v1::WatchPosesResponse>* writer) override {
    Record("WatchPoses after " + std::to_string(request->after_pose_seq())).ok();
    v1::WatchPosesResponse response;
    *response.add_poses() = PoseMessage(first_pose_seq).pose();
    if (status.ok()) writer->Write(response);
    return EndOfStream();
  }
  grpc::Status WatchHealth(grpc::ServerContext*, const v1::WatchHealthRequest*,
                           grpc::ServerWriter<v1::WatchHealthResponse>* writer) override {
    Record("WatchHealth").ok();
    if (status.ok()) writer->Write({});
    return EndOfStream();
  }
  grpc::Status WatchEvents(grpc::ServerContext*, const v1::WatchEventsRequest*,
                           grpc::ServerWriter<v1::WatchEventsResponse>* writer) override {
    Record("WatchEvents").ok();
    v1::WatchEventsResponse response;
    response.mutable_image()->set_cell_px(2);
    response.mutable_image()->set_width(1);
    response.mutable_image()->set_height(1);
    response.mutable_image()->set_encoding(v1::EventImage::ENCODING_PACKED);
    response.mutable_image()->set_cells(std::string(1, '\0'));
    if (status.ok()) writer->Write(response);
    return EndOfStream();
  }
  grpc::Status UploadModel(grpc::ServerContext*, grpc::ServerReader<v1::UploadModelRequest>* reader,
                           v1::Model* model) override {
    v1::UploadModelRequest request;
    while (reader->Read(&request)) model->set_size_bytes(model->size_bytes() + request.chunk().size());
    return Record("UploadModel");
  }
  grpc::Status GetModel(grpc::ServerContext*, const v1::GetModelRequest*, v1::Model*) override {
    return Record("GetModel");
  }
  grpc::Status ListModels(grpc::ServerContext*, const v1::ListModelsRequest*, v1::ListModelsResponse*) override {
    return Record("ListModels");
  }
  grpc::Status GetModelGeometry(grpc::ServerContext*, const v1::GetModelGeometryRequest*, v1::ModelGeometry*) override {
    return Record("GetModelGeometry");
  }
  grpc::Status DeleteModel(grpc::ServerContext*, const v1::DeleteModelRequest* request,
                           google::protobuf::Empty*) override {
    return Record(request->allow_missing() ? "DeleteModel if any" : "DeleteModel");
  }
  grpc::Status GetServerInfo(grpc::ServerContext*, const v1::GetServerInfoRequest*, v1::ServerInfo*) override {
    return Record("GetServerInfo");
  }
  grpc::Status Drain(grpc::ServerContext*, const v1::DrainRequest*, v1::DrainResponse*) override {
    return Record("Drain");
  }
  grpc::Status SetLogLevel(grpc::ServerContext*, const v1::SetLogLevelRequest*, v1::SetLogLevelResponse*) override {
    return Record("SetLogLevel");
  }

  std::mutex mutex_;
  std::vector<std::string> calls_;  // guarded by mutex_
  absl::Notification stops_;
  std::unique_ptr<grpc::Server> server_;
};

const grpc::Status kRefused(grpc::StatusCode::UNAVAILABLE, "the server shuts down");

class ServerChoiceTest : public ::testing::Test {
 protected:
  void SetUp() override { client_ = ClientWith(clock_); }
  std::unique_ptr<Client> ClientWith(Clock& clock) const {
    std::vector<std::pair<std::string, std::shared_ptr<grpc::Channel>>> servers;
    for (const OneOfTwo* server : {&first_, &second_}) {
      servers.emplace_back(server->address, grpc::CreateChannel(server->address, grpc::InsecureChannelCredentials()));
    }
    return ClientAccess::OverChannels(servers, clock);
  }
  absl::Duration elapsed() { return clock_.Now() - absl::UnixEpoch(); }

  FakeClock clock_;
  OneOfTwo first_;
  OneOfTwo second_;
  std::unique_ptr<Client> client_;
};

TEST_F(ServerChoiceTest, CallsGoToTheServerThatIsAlive) {
  EXPECT_TRUE(client_->GetServerInfo().ok());
  EXPECT_THAT(first_.TakeCalls(), ElementsAre("GetServerInfo"));
  first_.Stop();
  const std::vector<uint8_t> file(1000);
  const std::vector<std::pair<std::string, std::function<absl::Status()>>> calls = {
      {"GetServerInfo", [&] { return client_->GetServerInfo().status(); }},
      {"UploadModel", [&] { return client_->UploadModel(file, {}).status(); }},
      {"GetModel", [&] { return client_->GetModel("models/1").status(); }},
      {"ListModels", [&] { return client_->ListModels().status(); }},
      {"GetModelGeometry", [&] { return client_->GetModelGeometry("models/1").status(); }},
      {"DeleteModel", [&] { return client_->DeleteModel("models/1"); }},
      {"CreateSession", [&] { return client_->CreateSession({}).status(); }},
      {"GetSession", [&] { return client_->GetSession("sessions/1").status(); }},
      {"ListSessions", [&] { return client_->ListSessions().status(); }},
      {"DeleteSession if any", [&] { return client_->DeleteSession("sessions/1"); }},
  };
  for (const auto& [name, call] : calls) {
    const absl::Status status = call();
    EXPECT_TRUE(status.ok()) << name << ": " << status;
    EXPECT_THAT(second_.TakeCalls(), ElementsAre(name == "DeleteModel" ? "DeleteModel" : name));
  }
  EXPECT_EQ(clock_.Now(), absl::UnixEpoch());  // the other server is tried at once
}

TEST_F(ServerChoiceTest, EveryCallIsRepeatedWithTheEffectOfOneCall) {
  const std::vector<uint8_t> file(1000);
  const std::vector<std::pair<std::string, std::function<absl::Status(Client&)>>> calls = {
      {"UploadModel", [&](Client& client) { return client.UploadModel(file, {}).status(); }},
      {"GetModelGeometry", [](Client& client) { return client.GetModelGeometry("models/1").status(); }},
      {"DeleteModel", [](Client& client) { return client.DeleteModel("models/1"); }},
      {"GetSession", [](Client& client) { return client.GetSession("sessions/1").status(); }},
      {"DeleteSession if any", [](Client& client) { return client.DeleteSession("sessions/1"); }},
  };
  first_.status = kRefused;
  for (const auto& [name, call] : calls) {
    SetUp();  // makes a new client, which calls the first server first
    EXPECT_TRUE(call(*client_).ok()) << name;
    EXPECT_THAT(first_.TakeCalls(), ElementsAre(name));
    // The first server may have deleted the model before it became unreachable.
    EXPECT_THAT(second_.TakeCalls(), ElementsAre(name == "DeleteModel" ? "DeleteModel if any" : name));
  }
}

TEST_F(ServerChoiceTest, ARepeatedCreationHasTheSameRequestId) {
  first_.status = kRefused;
  EXPECT_TRUE(client_->CreateSession({}).ok());
  SetUp();
  EXPECT_TRUE(client_->CreateSession({}).ok());
  SetUp();
  EXPECT_TRUE(client_->CreateSession({}, "mine").ok());
  ASSERT_EQ(first_.request_ids.size(), 3u);
  EXPECT_EQ(first_.request_ids, second_.request_ids);
  EXPECT_EQ(first_.request_ids[0].size(), 32u);
  EXPECT_NE(first_.request_ids[0], first_.request_ids[1]);  // two calls are two sessions
  EXPECT_EQ(first_.request_ids[2], "mine");
}

TEST_F(ServerChoiceTest, ASessionIsCreatedAtTheServerWithRoom) {
  for (const char* reason : {"OVERLOADED", "TOO_MANY_SESSIONS", "SESSION_MEMORY", "OUT_OF_MEMORY"}) {
    SetUp();
    first_.status = Refusal(reason, 5);
    const absl::Status status = client_->CreateSession({}).status();
    EXPECT_TRUE(status.ok()) << reason << ": " << status;
    // The session may be known to the second server alone.
    EXPECT_TRUE(client_->GetSession("sessions/1").ok());
    EXPECT_THAT(first_.TakeCalls(), ElementsAre("CreateSession"));
    EXPECT_THAT(second_.TakeCalls(), ElementsAre("CreateSession", "GetSession"));
  }
  EXPECT_EQ(first_.request_ids, second_.request_ids);
  EXPECT_EQ(elapsed(), absl::ZeroDuration());
}

TEST_F(ServerChoiceTest, FullServersAreWaitedForAsTheyRequest) {
  first_.status = Refusal("OVERLOADED", 7);
  second_.status = WithReason(grpc::StatusCode::RESOURCE_EXHAUSTED, "OUT_OF_MEMORY");  // does not say for how long
  int num_calls = 0;
  first_.on_call = [&] {
    if (++num_calls == 2) first_.status = Refusal("TOO_MANY_SESSIONS", 5);
    if (num_calls == 3) first_.status = grpc::Status::OK;
  };
  const absl::Status status = client_->CreateSession({}).status();
  EXPECT_TRUE(status.ok()) << status;
  EXPECT_EQ(elapsed(), absl::Seconds(7 + 5));
  EXPECT_THAT(first_.request_ids, ElementsAre(first_.request_ids[0], first_.request_ids[0], first_.request_ids[0]));
  EXPECT_THAT(second_.request_ids, ElementsAre(first_.request_ids[0], first_.request_ids[0]));
}

TEST_F(ServerChoiceTest, TheWaitForRoomIsBounded) {
  first_.status = Refusal("OVERLOADED", 60);
  second_.status = Refusal("TOO_MANY_SESSIONS", 5);  // is the shortest delay
  const std::string servers = first_.address + ", " + second_.address;
  absl::Status status = client_->CreateSession({}).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(status.message(), second_.address + ": because of TOO_MANY_SESSIONS; none of the servers " + servers +
                                  " accepts the session; gave up after 6 more tries in 30s");
  EXPECT_EQ(GetDetails(status).reason, "TOO_MANY_SESSIONS");
  EXPECT_EQ(GetDetails(status).retry_in, absl::Seconds(5));
  EXPECT_EQ(elapsed(), absl::Seconds(30));
  EXPECT_EQ(first_.TakeCalls().size(), 7u);
  EXPECT_EQ(second_.TakeCalls().size(), 7u);

  std::swap(first_.status, second_.status);
  status = client_->CreateSession({}, "", absl::Seconds(4)).status();
  EXPECT_EQ(status.message(),
            second_.address + ": because of OVERLOADED; none of the servers " + servers + " accepts the session");
  EXPECT_EQ(GetDetails(status).retry_in, absl::Seconds(5));
  EXPECT_EQ(elapsed(), absl::Seconds(30));
  EXPECT_EQ(first_.TakeCalls().size() + second_.TakeCalls().size(), 2u);
}

TEST_F(ServerChoiceTest, ARefusalThatNeitherAServerNorADelayChangesIsFinal) {
  first_.status = second_.status = Refusal("TENANT_QUOTA", 5);
  EXPECT_EQ(client_->CreateSession({}).status().message(), first_.address + ": because of TENANT_QUOTA");
  EXPECT_THAT(second_.TakeCalls(), IsEmpty());
  first_.TakeCalls();
  first_.status = second_.status = WithReason(grpc::StatusCode::RESOURCE_EXHAUSTED, "SESSION_MEMORY");
  EXPECT_EQ(client_->CreateSession({}).status().code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(first_.TakeCalls().size(), 1u);
  EXPECT_EQ(second_.TakeCalls().size(), 1u);
  EXPECT_EQ(elapsed(), absl::ZeroDuration());
}

TEST_F(ServerChoiceTest, AFullServerIsWaitedForWhileTheOtherOneIsAway) {
  for (OneOfTwo* full : {&first_, &second_}) {
    OneOfTwo& unreachable = full == &first_ ? second_ : first_;
    SetUp();
    unreachable.status = kRefused;
    full->status = Refusal("OVERLOADED", 5);
    unreachable.TakeCalls();
    full->TakeCalls();
    EXPECT_THAT(client_->CreateSession({}, "", absl::ZeroDuration()).status().message(),
                HasSubstr(full->address + ": because of OVERLOADED; none of the servers"));
    EXPECT_THAT(unreachable.TakeCalls(), ElementsAre("CreateSession"));
    EXPECT_LE(full->TakeCalls().size(), 2u);
    const absl::Time before = clock_.Now();
    full->on_call = [&] {
      if (clock_.Now() > before) full->status = grpc::Status::OK;
    };
    const absl::Status status = client_->CreateSession({}).status();
    EXPECT_TRUE(status.ok()) << status;
    EXPECT_EQ(clock_.Now() - before, absl::Seconds(5));
    full->on_call = [] {};
  }
}

TEST_F(ServerChoiceTest, AFullServerIsWaitedForIfTheOtherOneDoesNotKnowTheModel) {
  first_.status = Refusal("OVERLOADED", 5);
  second_.status = WithReason(grpc::StatusCode::NOT_FOUND, "MODEL_NOT_FOUND");
  const absl::Status refusal = client_->CreateSession({}, "", absl::ZeroDuration()).status();
  EXPECT_THAT(refusal.message(), HasSubstr(first_.address + ": because of OVERLOADED; none of the servers"));
  EXPECT_THAT(refusal.message(), HasSubstr("accepts the session; " + second_.address + ": because of MODEL_NOT_FOUND"));
  EXPECT_EQ(GetDetails(refusal).reason, "OVERLOADED");
  EXPECT_EQ(GetDetails(refusal).retry_in, absl::Seconds(5));
  EXPECT_THAT(first_.TakeCalls(), ElementsAre("CreateSession"));
  EXPECT_THAT(second_.TakeCalls(), ElementsAre("CreateSession"));
  // The other calls stay at the server that knows the model.
  first_.on_call = [&] { first_.status = elapsed() < absl::Seconds(5) ? first_.status : grpc::Status::OK; };
  EXPECT_TRUE(client_->CreateSession({}).ok());
  EXPECT_EQ(elapsed(), absl::Seconds(5));
  EXPECT_THAT(first_.TakeCalls(), ElementsAre("CreateSession", "CreateSession"));
  EXPECT_THAT(second_.TakeCalls(), ElementsAre("CreateSession"));
}

TEST_F(ServerChoiceTest, AServerWithoutTheModelIsTheLastOneIfNoneWasFull) {
  first_.status = WithReason(grpc::StatusCode::NOT_FOUND, "MODEL_NOT_FOUND");
  second_.status = Refusal("OVERLOADED", 5);
  EXPECT_EQ(client_->CreateSession({}).status().message(), first_.address + ": because of MODEL_NOT_FOUND");
  EXPECT_THAT(second_.TakeCalls(), IsEmpty());
}

TEST_F(ServerChoiceTest, TheOnlyServerIsWaitedFor) {
  client_ = ClientAccess::OverChannel(grpc::CreateChannel(first_.address, grpc::InsecureChannelCredentials()),
                                      first_.address, clock_);
  first_.status = Refusal("OVERLOADED", 5);
  EXPECT_EQ(client_->CreateSession({}, "", absl::Seconds(9)).status().message(),
            first_.address + ": because of OVERLOADED; gave up after 1 more tries in 5s");
  EXPECT_EQ(first_.TakeCalls().size(), 2u);
}

TEST_F(ServerChoiceTest, AStopRequestEndsTheWaitForRoom) {
  class StoppingClock final : public Clock {
   public:
    absl::Time Now() override { return absl::UnixEpoch(); }
    bool SleepUntil(absl::Time, std::stop_token token) override {
      stop.request_stop();
      return !token.stop_requested();
    }
    std::stop_source stop;
  };
  StoppingClock clock;
  first_.status = second_.status = Refusal("OVERLOADED", 5);
  const auto session = ClientWith(clock)->CreateSession({}, "", absl::Seconds(30), clock.stop.get_token());
  EXPECT_EQ(session.status().code(), absl::StatusCode::kCancelled);
  EXPECT_EQ(second_.TakeCalls().size(), 1u);
}

TEST_F(ServerChoiceTest, CallsAboutOneServerAreNotRepeated) {
  first_.status = kRefused;
  EXPECT_EQ(client_->Drain().status().code(), absl::StatusCode::kUnavailable);
  EXPECT_EQ(client_->SetLogLevel(LogLevel::kDebug).status().code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(first_.TakeCalls(), ElementsAre("Drain", "SetLogLevel"));
  EXPECT_THAT(second_.TakeCalls(), IsEmpty());
}

TEST_F(ServerChoiceTest, LaterCallsStayWithTheServerThatResponded) {
  first_.status = kRefused;
  EXPECT_TRUE(client_->GetSession("sessions/1").ok());
  first_.status = grpc::Status::OK;
  first_.TakeCalls();
  EXPECT_TRUE(client_->GetSession("sessions/1").ok());
  EXPECT_THAT(first_.TakeCalls(), IsEmpty());
  second_.status = kRefused;
  EXPECT_TRUE(client_->GetSession("sessions/1").ok());
  EXPECT_THAT(first_.TakeCalls(), ElementsAre("GetSession"));
}

TEST_F(ServerChoiceTest, AResponseThatIsAnErrorIsFinal) {
  for (const grpc::Status& status :
       {grpc::Status(grpc::StatusCode::NOT_FOUND, "no such session"),
        WithReason(grpc::StatusCode::INTERNAL, "STORE_FAILED"), WithReason(grpc::StatusCode::ABORTED, "FENCED"),
        WithReason(grpc::StatusCode::RESOURCE_EXHAUSTED, "TENANT_QUOTA")}) {
    first_.status = status;
    EXPECT_EQ(static_cast<int>(client_->GetSession("sessions/1").status().code()), status.error_code());
    EXPECT_THAT(first_.TakeCalls(), ElementsAre("GetSession"));
    EXPECT_THAT(second_.TakeCalls(), IsEmpty());
  }
}

TEST_F(ServerChoiceTest, TheAttemptsAreBounded) {
  first_.status = second_.status = kRefused;
  const absl::Status status = client_->GetSession("sessions/1").status();
  EXPECT_EQ(status.code(), absl::StatusCode::kUnavailable);
  EXPECT_EQ(status.message(),
            second_.address + ": the server shuts down; 3 attempts each at " + first_.address + ", " + second_.address);
  EXPECT_EQ(first_.TakeCalls().size(), 3u);
  EXPECT_EQ(second_.TakeCalls().size(), 3u);
  // The delays are 0.1 and 0.2 s, which the jitter reduces by at most a half.
  EXPECT_GE(clock_.Now() - absl::UnixEpoch(), absl::Seconds(0.15));
  EXPECT_LE(clock_.Now() - absl::UnixEpoch(), absl::Seconds(0.3));
  const auto ignore = [](const SessionHealth&) {};
  EXPECT_EQ(client_->WatchHealth("sessions/1", absl::Seconds(1), ignore).code(), absl::StatusCode::kUnavailable);
  EXPECT_EQ(first_.TakeCalls().size(), 3u);
  EXPECT_EQ(second_.TakeCalls().size(), 3u);
}

TEST_F(ServerChoiceTest, NoServerIsAlive) {
  first_.Stop();
  second_.Stop();
  const absl::Status status = client_->GetSession("sessions/1").status();
  EXPECT_EQ(status.code(), absl::StatusCode::kUnavailable) << status;
  EXPECT_THAT(status.message(), HasSubstr("3 attempts each at " + first_.address + ", " + second_.address));
}

TEST_F(ServerChoiceTest, TheOnlyServerIsFoundByTheFirstCallAfterItsStart) {
  const std::string address = first_.address;
  const auto channel = grpc::CreateChannel(address, grpc::InsecureChannelCredentials());
  const std::unique_ptr<Client> client = ClientAccess::OverChannels({{address, channel}}, clock_);
  EXPECT_TRUE(client->ListSessions().ok());
  first_.Stop();
  EXPECT_EQ(client->ListSessions().status().code(), absl::StatusCode::kUnavailable);
  EXPECT_EQ(client->ListSessions().status().code(), absl::StatusCode::kUnavailable);
  const OneOfTwo again(address);
  EXPECT_TRUE(client->ListSessions().ok());
}

TEST_F(ServerChoiceTest, AStopRequestEndsTheAttempts) {
  std::stop_source stop;
  first_.status = kRefused;
  first_.on_call = [&] { stop.request_stop(); };
  EXPECT_EQ(client_->GetSession("sessions/1", stop.get_token()).status().code(), absl::StatusCode::kCancelled);
  EXPECT_THAT(second_.TakeCalls(), IsEmpty());
}

TEST_F(ServerChoiceTest, WatchersContinueAtTheServerThatIsAlive) {
  first_.stays = true;
  second_.first_pose_seq = 2;
  std::vector<uint64_t> seqs;
  const auto on_poses = [&](const std::vector<Pose>& poses, uint64_t) {
    for (const Pose& pose : poses) seqs.push_back(pose.seq);
    first_.Stop();
  };
  const absl::Status status = client_->WatchPoses("sessions/1", {}, on_poses);
  EXPECT_TRUE(status.ok()) << status;
  EXPECT_THAT(seqs, ElementsAre(1, 2));
  EXPECT_THAT(first_.TakeCalls(), ElementsAre("WatchPoses after 0"));
  EXPECT_THAT(second_.TakeCalls(), ElementsAre("WatchPoses after 1"));
}

TEST_F(ServerChoiceTest, HealthAndImagesContinueAtTheServerThatIsAlive) {
  first_.stays = true;
  int num_images = 0;
  const auto on_image = [&](const EventImage&) {
    ++num_images;
    first_.Stop();
  };
  absl::Status status = client_->WatchEvents("sessions/1", {}, on_image);
  EXPECT_TRUE(status.ok()) << status;
  EXPECT_EQ(num_images, 2);
  SetUp();
  int num_healths = 0;
  status = client_->WatchHealth("sessions/1", absl::Seconds(1), [&](const SessionHealth&) { ++num_healths; });
  EXPECT_TRUE(status.ok()) << status;
  EXPECT_EQ(num_healths, 1);
  EXPECT_THAT(second_.TakeCalls(), ElementsAre("WatchEvents", "WatchHealth"));
}

TEST_F(ServerChoiceTest, TheServersThatAreAliveDoNotTrackTheEvents) {
  first_.status = kRefused;
  second_.status = WithReason(grpc::StatusCode::FAILED_PRECONDITION, "SESSION_NOT_TRACKED_HERE");
  const absl::Status status = client_->WatchEvents("sessions/1", {}, [](const EventImage&) {});
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition) << status;
  EXPECT_EQ(first_.TakeCalls().size(), second_.TakeCalls().size());
}

}  // namespace
}  // namespace evpose::client

// SPDX-License-Identifier: Apache-2.0

// Tests, through raw stubs, errors of an unreachable, full, failing or damaged store, and servers that share a store.
#include <future>
#include <numeric>
#include <thread>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "core/base/byte_order.h"
#include "core/base/poll_testing.h"
#include "core/numerics/hash.h"
#include "grpc/health/v1/health.grpc.pb.h"
#include "server/rpc/server_testing.h"
#include "server/sessions/store_testing.h"
#include "server/stores/memory/memory_store.h"

namespace evpose::server {
namespace {

using Health = grpc::health::v1::HealthCheckResponse;
using Kind = v1::TrackResponse;

// Two readers of a session that has poses, one of poses and one of health; both have received their first response.
class Watchers {
 public:
  Watchers(v1::SessionService::Stub& stub, const std::string& session) {
    v1::WatchPosesRequest poses;
    poses.set_session(session);
    poses_ = stub.WatchPoses(&poses_context_, poses);
    v1::WatchHealthRequest health;
    health.set_session(session);
    health_ = stub.WatchHealth(&health_context_, health);
    v1::WatchPosesResponse first_poses;
    EXPECT_TRUE(poses_->Read(&first_poses));
    v1::WatchHealthResponse first_health;
    EXPECT_TRUE(health_->Read(&first_health));
  }
  // The final status of both.
  std::string Errors() const {
    v1::WatchPosesResponse poses;
    while (poses_->Read(&poses)) continue;
    v1::WatchHealthResponse health;
    while (health_->Read(&health)) continue;
    return Describe(poses_->Finish()) + ", " + Describe(health_->Finish());
  }

 private:
  grpc::ClientContext poses_context_, health_context_;
  std::unique_ptr<grpc::ClientReader<v1::WatchPosesResponse>> poses_;
  std::unique_ptr<grpc::ClientReader<v1::WatchHealthResponse>> health_;
};

// An error of the store and the error that clients receive for it.
std::vector<std::pair<absl::Status, std::string>> FullAndFailing() {
  return {{absl::ResourceExhaustedError("disk full"), "RESOURCE_EXHAUSTED STORE_FULL"},
          {absl::InternalError("bad page"), "INTERNAL STORE_FAILED"}};
}

class StoreErrorsTest : public RpcTest {
 protected:
  StoreErrorsTest() { Use(StartOnStore()); }

  static ServerOptions StoreOptions() {
    ServerOptions options = Options();
    options.store_check_period = absl::Milliseconds(1);
    return options;
  }
  // Starts another server with the same store; the first one continues.
  std::shared_ptr<grpc::Channel> StartOnStore(const ServerOptions& options = StoreOptions()) {
    servers_.push_back(
        StartServer(options, FakeTrackers(gate_), std::make_unique<FaultInjectingStore>(store_, fault_)).value());
    return servers_.back()->InProcessChannel();
  }
  std::string GetError(const std::string& name) {
    CreatedSession session;
    return Describe(Get(name, &session));
  }
  std::string ListError() {
    grpc::ClientContext context;
    v1::ListSessionsResponse response;
    return Describe(sessions_->ListSessions(&context, {}, &response));
  }
  std::string DeleteModelError(const std::string& name) {
    grpc::ClientContext context;
    v1::DeleteModelRequest request;
    request.set_name(name);
    google::protobuf::Empty response;
    return Describe(models_->DeleteModel(&context, request, &response));
  }
  // The error of a reader of poses, which must equal that of a reader of health.
  std::string WatchError(const std::string& name) {
    grpc::ClientContext context;
    v1::WatchPosesRequest poses;
    poses.set_session(name);
    const std::string error = Describe(sessions_->WatchPoses(&context, poses)->Finish());
    grpc::ClientContext health_context;
    v1::WatchHealthRequest health;
    health.set_session(name);
    EXPECT_EQ(Describe(sessions_->WatchHealth(&health_context, health)->Finish()), error);
    return error;
  }
  grpc::Status AttachError(const std::string& name, const std::string& token) {
    RawTrack track(*sessions_);
    track.Attach(name, token);
    return track.Finish();
  }
  static void MakePoses(RawTrack& track) {
    ASSERT_TRUE(track.Events(1, Flat64(SomeEvents(1, 11))));
    v1::TrackResponse response;
    ASSERT_TRUE(track.ReadUntil(Kind::kAck, response));
  }
  // The final status of a stream that is open while the store returns this error.
  grpc::Status TrackError(const absl::Status& error) {
    const CreatedSession session = CreateSession();
    const auto track = Attached(session);
    fault_->Set(error);
    EXPECT_TRUE(track->Events(1, Flat64(SomeEvents(1, 11))));
    return track->Finish();
  }

  const std::shared_ptr<InjectedFault> fault_ = std::make_shared<InjectedFault>();
  const std::shared_ptr<Store> store_ = MakeMemoryStore();
  std::vector<std::unique_ptr<Server>> servers_;
};

TEST_F(StoreErrorsTest, HealthIsNotServingWhileTheStoreIsUnreachable) {
  const auto health = grpc::health::v1::Health::NewStub(channel_);
  grpc::ClientContext context;
  const auto watch = health->Watch(&context, {});
  Health response;
  ASSERT_TRUE(watch->Read(&response));
  EXPECT_EQ(response.status(), Health::SERVING);
  for (int i = 0; i < 3; ++i) {
    fault_->Set(absl::UnavailableError("gone"));
    ASSERT_TRUE(watch->Read(&response));
    EXPECT_EQ(response.status(), Health::NOT_SERVING);
    fault_->Set(absl::OkStatus());
    ASSERT_TRUE(watch->Read(&response));
    EXPECT_EQ(response.status(), Health::SERVING);
  }
  context.TryCancel();
  while (watch->Read(&response)) continue;
  (void)watch->Finish();
}

TEST_F(StoreErrorsTest, AServerThatShutsDownDoesNotBecomeReadyAgain) {
  const auto health = grpc::health::v1::Health::NewStub(channel_);
  grpc::ClientContext context;
  const auto watch = health->Watch(&context, {});
  Health response;
  ASSERT_TRUE(watch->Read(&response));
  fault_->Set(absl::UnavailableError("gone"));
  ASSERT_TRUE(watch->Read(&response));
  ASSERT_EQ(response.status(), Health::NOT_SERVING);
  grpc::ClientContext drain;
  v1::DrainResponse drained;
  ASSERT_TRUE(admin_->Drain(&drain, {}, &drained).ok());
  fault_->Set(absl::OkStatus());
  std::thread leaving([this] { servers_.back()->Shutdown(absl::ZeroDuration()); });
  while (watch->Read(&response)) EXPECT_NE(response.status(), Health::SERVING);
  (void)watch->Finish();
  leaving.join();
}

TEST_F(StoreErrorsTest, ASessionWaitsForAnUnreachableStoreAndLosesNothing) {
  const CreatedSession session = CreateSession();
  const auto track = Attached(session);
  fault_->Set(absl::UnavailableError("gone"));
  ASSERT_TRUE(track->Events(1, Flat64(SomeEvents(1, 11))));
  v1::TrackResponse response;
  std::vector<v1::TrackResponse> before;
  ASSERT_TRUE(track->ReadUntil(Kind::kAck, response, &before));
  EXPECT_EQ(response.ack().processed_seq(), 1u);
  EXPECT_EQ(response.ack().durable_seq(), 0u);
  EXPECT_EQ(before.size(), 9u) << "poses do not wait for the store";
  ASSERT_TRUE(track->Events(2, Flat64(SomeEvents(11, 21))));
  ASSERT_TRUE(track->End());
  before.clear();
  ASSERT_TRUE(track->ReadUntil(Kind::kAck, response, &before));
  EXPECT_EQ(response.ack().durable_seq(), 0u);
  fault_->Set(absl::OkStatus());
  ASSERT_TRUE(track->ReadUntil(Kind::kSummary, response, &before));
  EXPECT_EQ(response.summary().health().poses(), 20u);
  EXPECT_EQ(Describe(track->Finish()), "OK");
  uint64_t pose_seq = 9;
  for (const v1::TrackResponse& earlier : before) {
    if (!earlier.has_pose()) continue;
    EXPECT_EQ(earlier.pose().pose_seq(), ++pose_seq);
  }
  EXPECT_EQ(pose_seq, 20u);
}

TEST_F(StoreErrorsTest, CallsThatNeedAnUnreachableStoreFail) {
  const CreatedSession here = CreateSession();
  const v1::CreateSessionRequest request = CreateRequest();
  Use(StartOnStore());
  fault_->Set(absl::UnavailableError("gone"));
  CreatedSession session;
  EXPECT_EQ(Describe(Create(request, &session)), "UNAVAILABLE STORE_UNAVAILABLE");
  v1::CreateSessionRequest again = request;
  again.set_request_id("again");
  EXPECT_EQ(Describe(Create(again, &session)), "UNAVAILABLE STORE_UNAVAILABLE");
  EXPECT_EQ(GetError(here.name()), "UNAVAILABLE STORE_UNAVAILABLE");
  EXPECT_EQ(ListError(), "UNAVAILABLE STORE_UNAVAILABLE");
  EXPECT_EQ(Describe(Delete(here.name())), "UNAVAILABLE STORE_UNAVAILABLE");
  const grpc::Status attached = AttachError(here.name(), here.resume_token());
  EXPECT_EQ(Describe(attached), "UNAVAILABLE STORE_UNAVAILABLE");
  EXPECT_THAT(attached.error_message(), testing::HasSubstr("does not respond"));
  v1::Model model;
  std::string other = kCubeObj;
  other.insert(0, "# other\n");
  EXPECT_EQ(Describe(Upload(UploadRequests(other), &model)), "UNAVAILABLE STORE_UNAVAILABLE");
  EXPECT_EQ(DeleteModelError(here.config().objects(0).model()), "UNAVAILABLE STORE_UNAVAILABLE");
  EXPECT_EQ(DeleteModelError("models/elsewhere"), "UNAVAILABLE STORE_UNAVAILABLE");
  fault_->Set(absl::OkStatus());
  EXPECT_EQ(DeleteModelError(here.config().objects(0).model()), "FAILED_PRECONDITION MODEL_IN_USE");
  EXPECT_EQ(Describe(Create(request, &session)), "OK");
  EXPECT_EQ(GetError(here.name()), "OK") << "no session is lost";
}

TEST_F(StoreErrorsTest, ARequestThatIsKnownDoesNotWaitForTheStoreEither) {
  v1::CreateSessionRequest request = CreateRequest();
  request.set_request_id("capture 1");
  CreatedSession made;
  ASSERT_EQ(Describe(Create(request, &made)), "OK");
  Use(StartOnStore());
  CreatedSession acquired;
  ASSERT_EQ(Describe(Create(request, &acquired)), "OK");
  EXPECT_EQ(acquired.name(), made.name());
  Use(StartOnStore());
  fault_->Set(absl::UnavailableError("gone"));
  EXPECT_EQ(Describe(Create(request, &acquired)), "UNAVAILABLE STORE_UNAVAILABLE");
  fault_->Set(absl::OkStatus());
  ASSERT_EQ(Describe(Create(request, &acquired)), "OK");
  EXPECT_EQ(acquired.name(), made.name());
}

TEST_F(StoreErrorsTest, CallsThatNeedAStoreThatIsFullOrFails) {
  const CreatedSession session = CreateSession();
  const v1::CreateSessionRequest request = CreateRequest();
  CreatedSession ignored;
  v1::Model unused, uploaded;
  ASSERT_EQ(Describe(Upload(UploadRequests(std::string("# unused\n") + kCubeObj), &unused)), "OK");
  for (const auto& [fault, error] : FullAndFailing()) {
    fault_->Set(fault);
    EXPECT_EQ(Describe(Create(request, &ignored)), error);
    EXPECT_EQ(Describe(Upload(UploadRequests(std::string("# other\n") + kCubeObj), &uploaded)), error);
    EXPECT_EQ(DeleteModelError(unused.name()), error);
    EXPECT_EQ(Describe(Delete(session.name())), error);
    fault_->Set(absl::OkStatus());
  }
  EXPECT_EQ(Describe(Create(request, &ignored)), "OK");
  EXPECT_EQ(Describe(Delete(session.name())), "OK");
}

TEST_F(StoreErrorsTest, ARepeatedRequestForADamagedSessionIsAnError) {
  v1::CreateSessionRequest request = CreateRequest();
  request.set_request_id("capture 1");
  CreatedSession session;
  ASSERT_EQ(Describe(Create(request, &session)), "OK");
  auto acquired = store_->AcquireSession(session.name()).value();
  std::promise<absl::Status> done;
  acquired.lease->Commit({.lifecycle = "no lifecycle"},
                         [&done](const absl::Status& status) { done.set_value(status); });
  ASSERT_TRUE(done.get_future().get().ok());
  Use(StartOnStore());
  EXPECT_EQ(Describe(Create(request, &session)), "DATA_LOSS SESSION_DAMAGED");
  EXPECT_EQ(Describe(Delete(session.name())), "OK");
  EXPECT_EQ(Describe(Create(request, &session)), "OK");
}

TEST_F(StoreErrorsTest, AnotherServerFencesTheStreamAndTheWatchers) {
  const CreatedSession session = CreateSession();
  v1::TrackResponse::Attached attached;
  const auto track = Attached(session, &attached);
  MakePoses(*track);
  const Watchers watchers(*sessions_, session.name());
  Use(StartOnStore());
  CreatedSession moved = session;
  moved.set_resume_token(attached.resume_token());
  const auto elsewhere = Attached(moved);
  (void)track->Events(2, Flat64(SomeEvents(11, 1200, 1)));  // enough for a checkpoint, unless one was fenced already
  EXPECT_EQ(Describe(track->Finish()), "ABORTED FENCED");
  EXPECT_EQ(watchers.Errors(), "ABORTED FENCED, ABORTED FENCED");
}

TEST_F(StoreErrorsTest, WatchersReceiveTheErrorThatEndsTheirSession) {
  for (const auto& [fault, error] : FullAndFailing()) {
    const CreatedSession session = CreateSession();
    const auto track = Attached(session);
    MakePoses(*track);
    const Watchers watchers(*sessions_, session.name());
    fault_->Set(fault);
    (void)track->Events(2, Flat64(SomeEvents(11, 1200, 1)));  // enough for a checkpoint, unless one has failed already
    EXPECT_EQ(watchers.Errors(), absl::StrCat(error, ", ", error));
    EXPECT_EQ(Describe(track->Finish()), error);
    fault_->Set(absl::OkStatus());
  }
}

TEST_F(StoreErrorsTest, AnIncomingSessionNeedsASlot) {
  CreatedSession session = CreateSession();
  Use(StartOnStore());
  std::string last;
  for (uint32_t i = 0; i < Options().max_sessions; ++i) last = CreateSession().name();
  const grpc::Status status = AttachError(session.name(), session.resume_token());
  EXPECT_EQ(Describe(status), "RESOURCE_EXHAUSTED TOO_MANY_SESSIONS");
  EXPECT_GT(DetailOf<google::rpc::RetryInfo>(status).retry_delay().seconds(), 0);
  ASSERT_EQ(Describe(Delete(last)), "OK");
  (void)Attached(session);
}

TEST_F(StoreErrorsTest, AnIncomingSessionCountsForItsTenant) {
  const CreatedSession session = CreateSession();
  ServerOptions options = StoreOptions();
  options.tenant.max_sessions = 1;
  Use(StartOnStore(options));
  const std::string only = CreateSession().name();
  const grpc::Status status = AttachError(session.name(), session.resume_token());
  EXPECT_EQ(Describe(status), "RESOURCE_EXHAUSTED TENANT_QUOTA");
  EXPECT_EQ(DetailOf<google::rpc::QuotaFailure>(status).violations(0).subject(), "tenant_sessions");
  EXPECT_GT(DetailOf<google::rpc::RetryInfo>(status).retry_delay().seconds(), 0);
  ASSERT_EQ(Describe(Delete(only)), "OK");
  (void)Attached(session);
}

TEST_F(StoreErrorsTest, AnUploadOfAModelDeletedByAnotherServerIsAborted) {
  const std::string file = kCubeObj;
  std::vector<v1::UploadModelRequest> requests = UploadRequests(file);
  requests[0].mutable_header()->set_sha256(absl::HexStringToBytes(Sha256Hex(AsBytes(file))));
  v1::Model model;
  ASSERT_EQ(Describe(Upload(requests, &model)), "OK");
  const auto here = channel_;
  Use(StartOnStore());
  ASSERT_EQ(DeleteModelError(model.name()), "OK");
  Use(here);
  const std::string name = model.name();
  const grpc::Status status = Upload(requests, &model);
  EXPECT_EQ(Describe(status), "ABORTED MODEL_DELETED");
  EXPECT_EQ(DetailOf<google::rpc::ErrorInfo>(status).metadata().at("model"), name);
  EXPECT_EQ(Describe(Upload(requests, &model)), "OK") << "the error advises to upload again";
  EXPECT_EQ(model.name(), name);
}

TEST_F(StoreErrorsTest, AFullStoreEndsTheStreamAndTheSessionContinuesLater) {
  const v1::CreateSessionRequest request = CreateRequest();
  CreatedSession session = CreateSession();
  v1::TrackResponse::Attached attached;
  auto track = Attached(session, &attached);
  fault_->Set(absl::ResourceExhaustedError("disk full"));
  ASSERT_TRUE(track->Events(1, Flat64(SomeEvents(1, 11))));
  const grpc::Status status = track->Finish();
  EXPECT_EQ(Describe(status), "RESOURCE_EXHAUSTED STORE_FULL");
  EXPECT_THAT(status.error_message(), testing::HasSubstr("make room"));
  CreatedSession ignored;
  EXPECT_EQ(Describe(Create(request, &ignored)), "RESOURCE_EXHAUSTED STORE_FULL");

  fault_->Set(absl::OkStatus());
  session.set_resume_token(attached.resume_token());
  track = Attached(session, &attached);
  EXPECT_EQ(attached.next_seq(), 1u) << "nothing was acknowledged as durable";
  ASSERT_TRUE(track->Events(1, Flat64(SomeEvents(1, 11))));
  ASSERT_TRUE(track->End());
  v1::TrackResponse response;
  ASSERT_TRUE(track->ReadUntil(Kind::kSummary, response));
  EXPECT_EQ(response.summary().health().poses(), 10u);
  EXPECT_EQ(Describe(track->Finish()), "OK");
}

TEST_F(StoreErrorsTest, AnImpossiblePoseNumberIsRefusedAfterAMoveToo) {
  const CreatedSession session = CreateSession();
  Use(StartOnStore());
  for (const uint64_t last_pose_seq : {uint64_t{10'000}, UINT64_MAX}) {
    RawTrack track(*sessions_);
    track.Attach(session.name(), session.resume_token(), last_pose_seq);
    EXPECT_EQ(Describe(track.Finish()), "INVALID_ARGUMENT attach.last_pose_seq");
  }
  const auto track = Attached(session);
  ASSERT_TRUE(track->Events(1, Flat64(SomeEvents(1, 11))));
  ASSERT_TRUE(track->End());
  v1::TrackResponse response;
  ASSERT_TRUE(track->ReadUntil(Kind::kSummary, response));
  EXPECT_EQ(response.summary().health().poses(), 10u);
}

TEST_F(StoreErrorsTest, WatchersAtAnotherServerSeeEveryPose) {
  CreatedSession session = CreateSession();
  v1::TrackResponse::Attached attached;
  auto track = Attached(session, &attached);
  const auto elsewhere = v1::SessionService::NewStub(StartOnStore());
  grpc::ClientContext context;
  v1::WatchPosesRequest request;
  request.set_session(session.name());
  const auto watcher = elsewhere->WatchPoses(&context, request);
  std::vector<uint64_t> seqs;
  const auto read_until = [&](size_t num_poses) {
    v1::WatchPosesResponse response;
    while (seqs.size() < num_poses && watcher->Read(&response)) {
      EXPECT_EQ(response.num_skipped(), 0u);
      for (const v1::Pose& pose : response.poses()) seqs.push_back(pose.pose_seq());
    }
  };
  MakePoses(*track);
  track.reset();  // its session stays in the store
  read_until(1);
  session.set_resume_token(attached.resume_token());
  track = Attached(session);
  ASSERT_TRUE(track->Events(2, Flat64(SomeEvents(11, 31))));
  ASSERT_TRUE(track->End());
  EXPECT_EQ(Describe(track->Finish()), "OK");
  read_until(1000);
  EXPECT_EQ(Describe(watcher->Finish()), "OK");
  std::vector<uint64_t> expected(30);
  std::iota(expected.begin(), expected.end(), 1);
  EXPECT_EQ(seqs, expected);
}

TEST_F(StoreErrorsTest, WatchersAtAnotherServerSeeHealthUntilTheEnd) {
  const CreatedSession session = CreateSession();
  const auto track = Attached(session);
  const auto elsewhere = v1::SessionService::NewStub(StartOnStore());
  grpc::ClientContext context;
  v1::WatchHealthRequest request;
  request.set_session(session.name());
  request.mutable_period()->set_nanos(10'000'000);
  const auto watcher = elsewhere->WatchHealth(&context, request);
  v1::WatchHealthResponse response;
  ASSERT_TRUE(watcher->Read(&response));
  EXPECT_EQ(response.health().poses(), 0u);
  MakePoses(*track);
  ASSERT_TRUE(track->End());
  EXPECT_EQ(Describe(track->Finish()), "OK");
  while (watcher->Read(&response)) continue;
  EXPECT_EQ(response.health().poses(), 10u);
  EXPECT_EQ(Describe(watcher->Finish()), "OK");
}

TEST_F(StoreErrorsTest, ImagesOfEventsAreMadeWhereTheyAreTracked) {
  const CreatedSession session = CreateSession();
  const auto track = Attached(session);
  const auto elsewhere = v1::SessionService::NewStub(StartOnStore());
  v1::WatchEventsRequest request;
  request.set_session(session.name());
  const auto watch_elsewhere = [&] {
    grpc::ClientContext context;
    return Describe(elsewhere->WatchEvents(&context, request)->Finish());
  };
  EXPECT_EQ(watch_elsewhere(), "FAILED_PRECONDITION SESSION_NOT_TRACKED_HERE");
  MakePoses(*track);
  ASSERT_TRUE(track->End());
  EXPECT_EQ(Describe(track->Finish()), "OK");
  EXPECT_TRUE(Poll([&] { return watch_elsewhere() == "OK"; })) << "the session has ended, which it reads later";
}

TEST_F(StoreErrorsTest, WatchersAtAnotherServerReceiveErrorsOfTheStore) {
  const CreatedSession session = CreateSession();
  { MakePoses(*Attached(session)); }
  ASSERT_TRUE(Poll([&] { return !store_->ReadSession(session.name())->poses.empty(); }));  // else an error loses them
  Use(StartOnStore());
  EXPECT_EQ(WatchError("sessions/unknown"), "NOT_FOUND SESSION_NOT_FOUND");
  fault_->Set(absl::UnavailableError("gone"));
  EXPECT_EQ(WatchError(session.name()), "UNAVAILABLE STORE_UNAVAILABLE");
  // In the second case the store also fails when the server asks for the tenant of the damaged session.
  for (const absl::Status& fault : {absl::InternalError("bad page"), absl::DataLossError("bad page")}) {
    fault_->Set(fault);
    EXPECT_EQ(WatchError(session.name()), "INTERNAL STORE_FAILED");
    EXPECT_EQ(GetError(session.name()), "INTERNAL STORE_FAILED");
    EXPECT_EQ(ListError(), "INTERNAL STORE_FAILED");
  }
  fault_->Set(absl::OkStatus());
  const Watchers watchers(*sessions_, session.name());
  fault_->Set(absl::UnavailableError("gone"));
  fault_->Set(absl::OkStatus());
  ASSERT_EQ(Describe(Delete(session.name())), "OK");
  EXPECT_EQ(watchers.Errors(), "NOT_FOUND SESSION_DELETED, NOT_FOUND SESSION_DELETED");
}

TEST_F(StoreErrorsTest, AStoreThatFailsEndsTheStream) {
  const grpc::Status status = TrackError(absl::DataLossError("bad page"));
  EXPECT_EQ(Describe(status), "INTERNAL STORE_FAILED");
  EXPECT_THAT(status.error_message(), testing::HasSubstr("bad page"));
}

TEST_F(StoreErrorsTest, ADamagedSessionIsNamedAndCanBeDeleted) {
  const std::string name = "sessions/0123456789abcdef0123456789abcdef";
  ASSERT_TRUE(store_->CreateSession({.name = name, .config = "no configuration"}, "no lifecycle").ok());
  CreatedSession session;
  const grpc::Status status = Get(name, &session);
  EXPECT_EQ(Describe(status), "DATA_LOSS SESSION_DAMAGED");
  EXPECT_EQ(DetailOf<google::rpc::ErrorInfo>(status).metadata().at("session"), name);
  EXPECT_EQ(Describe(AttachError(name, "token")), "DATA_LOSS SESSION_DAMAGED");
  EXPECT_EQ(WatchError(name), "DATA_LOSS SESSION_DAMAGED");
  EXPECT_EQ(ListError(), "OK") << "the other sessions are listed";
  EXPECT_EQ(Describe(Delete(name)), "OK");
  EXPECT_EQ(GetError(name), "NOT_FOUND SESSION_NOT_FOUND");
}

}  // namespace
}  // namespace evpose::server

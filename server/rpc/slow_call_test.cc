// SPDX-License-Identifier: Apache-2.0

// Tests calls whose slow work, the creation of trackers, takes longer than anybody waits.
#include <atomic>
#include <chrono>
#include <functional>
#include <future>

#include "core/base/poll_testing.h"
#include "core/base/yield_point.h"
#include "server/rpc/authentication_testing.h"
#include "server/stores/memory/memory_store.h"

namespace evpose::server {
namespace {

constexpr std::chrono::minutes kPatience{4};

// A factory whose work, which has yield points, goes on until Release() if it begins while `is_long` is set.
class LongCreation {
 public:
  TrackerFactory factory() {
    return [this, make = FakeTrackers()](const SessionConfig& config,
                                         const std::vector<std::shared_ptr<const ObjectModel>>& models) {
      if (is_long) ++num_begun_;
      for (const bool goes_on = is_long; goes_on && !is_released_;) YieldPoint();
      return make(config, models);
    };
  }
  void Await(int num_begun) const {
    EXPECT_TRUE(Poll([&] { return num_begun_ >= num_begun; }));
  }
  void Release() { is_released_ = true; }

  std::atomic<bool> is_long = false;

 private:
  std::atomic<bool> is_released_ = false;
  std::atomic<int> num_begun_ = 0;
};

class SlowCallTest : public TokensTest {
 protected:
  SlowCallTest() { Start(); }
  ~SlowCallTest() override {
    creation_.Release();
    server_.reset();
  }

  void Start() {
    ServerOptions options = Options();
    options.listen_address = "127.0.0.1:0";
    options.token_file = files_.Path("tokens");
    options.slow_threads = 1;
    server_ = StartServer(options, creation_.factory(), MakeMemoryStore(stored_)).value();
    UseTokenOf(lab_);
  }
  void UseTokenOf(const NewToken& token) { Use(OpenChannel(server_->port(), token.token)); }
  // Calls CreateSession, and returns when its work, which is long, has begun.
  std::future<grpc::Status> BeginCreate(grpc::ClientContext& context) {
    const v1::CreateSessionRequest request = CreateRequest();
    creation_.is_long = true;
    auto call = std::async(std::launch::async, [this, &context, request] {
      CreatedSession session;
      return sessions_->CreateSession(&context, request, session.response());
    });
    creation_.Await(1);
    return call;
  }
  // Creates a session whose work is not long. DEADLINE_EXCEEDED if the call waits for other work.
  std::string CreateAnother() {
    creation_.is_long = false;
    const v1::CreateSessionRequest request = CreateRequest();
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + kPatience);
    CreatedSession session;
    return Describe(sessions_->CreateSession(&context, request, session.response()));
  }

  const std::shared_ptr<MemorySessions> stored_ = std::make_shared<MemorySessions>(UINT64_MAX);
  LongCreation creation_;
};

TEST_F(SlowCallTest, TheWorkOfACancelledCallEnds) {
  grpc::ClientContext context;
  auto call = BeginCreate(context);
  context.TryCancel();
  EXPECT_EQ(call.get().error_code(), grpc::StatusCode::CANCELLED);
  EXPECT_EQ(CreateAnother(), "OK") << "of the same tenant, which has one item at a time";
  EXPECT_EQ(server_->state().sessions.detached, 1u);
}

TEST_F(SlowCallTest, TheEndOfTheServerEndsTheWorkOfCalls) {
  grpc::ClientContext context;
  auto call = BeginCreate(context);
  auto end = std::async(std::launch::async, [this] { server_->Shutdown(absl::ZeroDuration()); });
  EXPECT_EQ(end.wait_for(kPatience), std::future_status::ready);
  creation_.Release();
  EXPECT_FALSE(call.get().ok());
}

TEST_F(SlowCallTest, LongWorkDoesNotDelayAnotherTenant) {
  grpc::ClientContext context;
  auto call = BeginCreate(context);
  const auto of_lab = std::move(sessions_);
  UseTokenOf(field_);
  EXPECT_EQ(CreateAnother(), "OK") << "with --slow-threads 1";
  context.TryCancel();
  EXPECT_EQ(call.get().error_code(), grpc::StatusCode::CANCELLED);
}

// A session of an earlier process is restored for the first call that needs it.
class RestoringCallTest : public SlowCallTest {
 protected:
  RestoringCallTest() : session_(CreateSession()) {
    server_.reset();
    Start();
    UploadCube();
    creation_.is_long = true;
  }

  const CreatedSession session_;
};

TEST_F(RestoringCallTest, TheWorkOfACancelledGetSessionEnds) {
  grpc::ClientContext context;
  auto call = std::async(std::launch::async, [&] {
    v1::GetSessionRequest request;
    request.set_name(session_.name());
    v1::Session response;
    return sessions_->GetSession(&context, request, &response);
  });
  creation_.Await(1);
  context.TryCancel();
  EXPECT_EQ(call.get().error_code(), grpc::StatusCode::CANCELLED);
  EXPECT_EQ(CreateAnother(), "OK");
  CreatedSession read;
  EXPECT_EQ(Describe(Get(session_.name(), &read)), "OK") << "the next call restores it";
}

TEST_F(RestoringCallTest, TheWorkOfACancelledTrackStreamEnds) {
  RawTrack track(*sessions_);
  ASSERT_TRUE(track.Attach(session_));
  creation_.Await(1);
  track.Cancel();
  EXPECT_EQ(track.Finish().error_code(), grpc::StatusCode::CANCELLED);
  EXPECT_EQ(CreateAnother(), "OK");
  Attached(session_);
}

TEST_F(RestoringCallTest, TheWorkOfACancelledWatchStreamEnds) {
  grpc::ClientContext context;
  v1::WatchPosesRequest request;
  request.set_session(session_.name());
  const auto poses = sessions_->WatchPoses(&context, request);
  creation_.Await(1);
  context.TryCancel();
  EXPECT_EQ(poses->Finish().error_code(), grpc::StatusCode::CANCELLED);
  EXPECT_EQ(CreateAnother(), "OK");
  Attached(session_);
}

}  // namespace
}  // namespace evpose::server

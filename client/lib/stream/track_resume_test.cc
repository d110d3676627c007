// SPDX-License-Identifier: Apache-2.0

// Streams that break and are re-established, against servers that run the script of each test. No test waits: the
// clock is a fake one.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <future>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "client/lib/stream/track_resume_testing.h"
#include "evpose/client.h"
#include "evpose/v1/admin_service.grpc.pb.h"
#include "google/rpc/error_details.pb.h"
#include "google/rpc/status.pb.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

grpc::Status WrongField(const std::string& field) {
  google::rpc::Status details;
  google::rpc::BadRequest bad_request;
  bad_request.add_field_violations()->set_field(field);
  details.add_details()->PackFrom(bad_request);
  return grpc::Status(grpc::StatusCode::INVALID_ARGUMENT, field + ": wrong", details.SerializeAsString());
}

TEST_F(TrackResumeTest, ContinuesAtTheServersPositionAndDropsRepeatedPoses) {
  scripts_ = {BreakAfter(3, 1, 4, kCut, "T1"), FinishFrom(2, 3, 9, "T2")};
  session_.resume_token = "T0";
  const auto summary = Run();
  ASSERT_TRUE(summary.ok()) << summary.status();
  EXPECT_THAT(PoseSeqs(), ElementsAre(1, 2, 3, 4, 5, 6, 7, 8, 9));
  EXPECT_EQ(summary->poses, 9u);
  EXPECT_EQ(summary->lost_poses, 0u);
  EXPECT_EQ(summary->sent_bytes, 40u);
  EXPECT_EQ(summary->sent_chunks, 5u);
  ASSERT_EQ(attaches_.size(), 2u);
  EXPECT_EQ(attaches_[0].resume_token(), "T0");
  EXPECT_EQ(attaches_[1].resume_token(), "T1");
  EXPECT_EQ(attaches_[1].last_pose_seq(), 4u);
  ASSERT_EQ(positions_.size(), 2u);
  EXPECT_EQ(positions_[0].resume_token, "T1");
  EXPECT_EQ(positions_[0].previous_token, "T0");
  EXPECT_EQ(positions_[1].last_pose_seq, 4u);
  ASSERT_EQ(changes_.size(), 2u);
  EXPECT_TRUE(changes_[0].is_unreachable);
  EXPECT_THAT(changes_[0].cause.message(), HasSubstr("connection reset"));
  EXPECT_EQ(changes_[0].next_try_in, absl::Milliseconds(100));
  EXPECT_EQ(changes_[0].kept_bytes, 40u);
  EXPECT_FALSE(changes_[1].is_unreachable);
  EXPECT_EQ(changes_[1].outage, absl::Milliseconds(100));
}

// The server, the callbacks, the summary and the errors have the same IDs.
TEST_F(TrackResumeTest, EachStreamHasASpanInTheTraceOfTheSession) {
  scripts_ = {BreakAfter(3, 1, 4, kCut, "T1"), FinishFrom(2, 3, 9, "T2")};
  const auto summary = Run();
  ASSERT_TRUE(summary.ok()) << summary.status();
  ASSERT_EQ(service_.traceparents.size(), 2u);
  ASSERT_EQ(changes_.size(), 2u);
  const std::string trace_id = TraceId("sessions/1");
  EXPECT_EQ(trace_id.size(), 32u);
  for (size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(changes_[i].trace.trace_id, trace_id);
    EXPECT_EQ(service_.traceparents[i], "00-" + trace_id + "-" + changes_[i].trace.span_id + "-01");
  }
  EXPECT_NE(changes_[0].trace.span_id, changes_[1].trace.span_id);
  EXPECT_EQ(summary->trace, changes_[1].trace);

  ClearStreams();
  scripts_ = {Refuse(WithReason(grpc::StatusCode::NOT_FOUND, "SESSION_DELETED"))};
  const auto failed = Run();
  ASSERT_EQ(service_.traceparents.size(), 3u);
  const std::string span_id = service_.traceparents[2].substr(36, 16);
  ExpectError(failed, absl::StatusCode::kNotFound, "; trace_id=" + trace_id + " span_id=" + span_id);
}

// The poses 3 and 4 were not stored. Those of the new search have their numbers, and are delivered, unless the server
// has a version that does not say from where on it sends them.
TEST_F(TrackResumeTest, DeliversThePosesOfANewSearchThatReplaceDeliveredOnes) {
  for (const bool has_pose_seq : {true, false}) {
    SCOPED_TRACE(has_pose_seq);
    ClearStreams();
    poses_.clear();
    notices_.clear();
    const auto restarted = [has_pose_seq](const v1::TrackRequest::Attach&, ServerStream& stream) {
      stream.Write(AttachedAt(2, 3, "T2"));
      v1::TrackResponse notice;
      notice.mutable_notice()->mutable_tracking_restarted()->set_after_seq(1);
      if (has_pose_seq) notice.mutable_notice()->mutable_tracking_restarted()->set_after_pose_seq(2);
      stream.Write(notice);
      ReadToEnd(stream);
      for (uint64_t seq = 3; seq <= 6; ++seq) stream.Write(PoseMessage(seq));
      stream.Write(SummaryMessage(6));
      return grpc::Status::OK;
    };
    scripts_ = {BreakAfter(3, 1, 4, kCut, "T1"), restarted};
    const auto summary = Run();
    ASSERT_TRUE(summary.ok()) << summary.status();
    EXPECT_EQ(PoseSeqs(), has_pose_seq ? std::vector<uint64_t>({1, 2, 3, 4, 3, 4, 5, 6})
                                       : std::vector<uint64_t>({1, 2, 3, 4, 5, 6}));
    EXPECT_EQ(summary->poses, 6u);
    EXPECT_EQ(summary->lost_poses, 0u);
    ASSERT_EQ(notices_.size(), 1u);
    EXPECT_EQ(std::get<TrackingRestarted>(notices_[0]).after_pose_seq,
              has_pose_seq ? std::optional<uint64_t>(2) : std::nullopt);
  }
}

TEST_F(TrackResumeTest, BreaksAtEveryChunk) {
  for (uint64_t chunk = 1; chunk <= 5; ++chunk) {
    scripts_.push_back(BreakAfter(chunk, chunk, chunk, kCut, "T" + std::to_string(chunk), chunk));
  }
  scripts_.push_back(FinishFrom(6, 6, 6));
  const auto summary = Run();
  ASSERT_TRUE(summary.ok()) << summary.status();
  EXPECT_THAT(PoseSeqs(), ElementsAre(1, 2, 3, 4, 5, 6));
  EXPECT_EQ(attaches_[5].resume_token(), "T5");
}

TEST_F(TrackResumeTest, DelaysDoubleUntilTheServerMakesProgress) {
  scripts_ = {Refuse(kCut), Refuse(kCut), Refuse(kCut), BreakAfter(1, 1, 0, kCut), Refuse(kCut), FinishFrom(1, 1, 0)};
  ASSERT_TRUE(Run().ok());
  std::vector<double> delays_ms;
  for (const ConnectionChange& change : changes_) {
    if (change.is_unreachable) delays_ms.push_back(absl::ToDoubleMilliseconds(change.next_try_in));
  }
  EXPECT_THAT(delays_ms, ElementsAre(100, 200, 400, 100, 200));
}

TEST_F(TrackResumeTest, ALongIdleStreamCountsAsSuccess) {
  options_.retry.max_outage = absl::Seconds(30);
  const StreamScript idle = [this](const v1::TrackRequest::Attach&, ServerStream& stream) {
    stream.Write(AttachedAt(1, 1, ""));
    v1::TrackRequest request;
    stream.Read(&request);  // the client has processed `attached`
    clock_.Advance(absl::Hours(1));
    return kCut;
  };
  scripts_ = {idle, idle, FinishFrom(1, 1, 0)};
  EXPECT_TRUE(Run().ok());
}

TEST_F(TrackResumeTest, GivesUpAfterTheMaximumOutage) {
  options_.retry.max_outage = absl::Seconds(1);
  scripts_ = {BreakAfter(2, 1, 1, kCut)};
  for (int i = 0; i < 10; ++i) scripts_.push_back(Refuse(kCut));
  const absl::Time begin = clock_.Now();
  // Delays of 0.1, 0.2 and 0.4 s; another one of 0.8 s would exceed max_outage.
  ExpectError(Run(), absl::StatusCode::kUnavailable,
              " bytes sent, 1 poses received); gave up after 3 more tries in 700ms");
  EXPECT_EQ(clock_.Now() - begin, absl::Milliseconds(700));
}

TEST_F(TrackResumeTest, ALostAttachedMessageDoesNotInvalidateTheToken) {
  // The server issued T1, but the client has not received it: the server still accepts T0.
  scripts_ = {Refuse(kCut), FinishFrom(1, 1, 2, "T2")};
  session_.resume_token = "T0";
  ASSERT_TRUE(Run().ok());
  EXPECT_EQ(attaches_[1].resume_token(), "T0");
}

TEST_F(TrackResumeTest, ThePreviousTokenIsSentIfTheNewOneIsRejected) {
  scripts_ = {BreakAfter(1, 1, 1, kCut, "T1"), Refuse(WithReason(grpc::StatusCode::PERMISSION_DENIED, "WRONG_TOKEN")),
              FinishFrom(2, 2, 2, "T2")};
  session_.resume_token = "T0";
  ASSERT_TRUE(Run().ok());
  EXPECT_EQ(attaches_[1].resume_token(), "T1");
  EXPECT_EQ(attaches_[2].resume_token(), "T0");
}

TEST_F(TrackResumeTest, TwoRejectedTokensEndTheStream) {
  const grpc::Status wrong = WithReason(grpc::StatusCode::PERMISSION_DENIED, "WRONG_TOKEN");
  scripts_ = {BreakAfter(1, 1, 1, kCut, "T1"), Refuse(wrong), Refuse(wrong)};
  const auto result = Run();
  ExpectError(result, absl::StatusCode::kPermissionDenied, "WRONG_TOKEN");
  EXPECT_EQ(attaches_.size(), 3u);
  EXPECT_THAT(std::string(result.status().message()), ::testing::Not(HasSubstr("T1")));
}

TEST_F(TrackResumeTest, AServerThatIsBehindTheReceivedPosesContinues) {
  // The server resumed from a checkpoint and has computed two poses; the client has received five.
  scripts_ = {BreakAfter(3, 1, 5, kCut), Refuse(WrongField("attach.last_pose_seq")), FinishFrom(1, 1, 7)};
  const auto summary = Run();
  ASSERT_TRUE(summary.ok()) << summary.status();
  EXPECT_EQ(attaches_[1].last_pose_seq(), 5u);
  EXPECT_EQ(attaches_[2].last_pose_seq(), 0u);
  EXPECT_THAT(PoseSeqs(), ElementsAre(1, 2, 3, 4, 5, 6, 7));
}

TEST_F(TrackResumeTest, PosesDeletedByTheServerAreReportedAndCounted) {
  scripts_ = {BreakAfter(3, 1, 2, WithReason(grpc::StatusCode::ABORTED, "POSES_EXPIRED")), FinishFrom(4, 6, 8)};
  const auto summary = Run();
  ASSERT_TRUE(summary.ok()) << summary.status();
  EXPECT_THAT(PoseSeqs(), ElementsAre(1, 2, 6, 7, 8));
  EXPECT_EQ(summary->poses, 5u);
  EXPECT_EQ(summary->lost_poses, 3u);
  ASSERT_EQ(notices_.size(), 1u);
  EXPECT_EQ(std::get<PosesLost>(notices_[0]).first_seq, 3u);
  EXPECT_EQ(std::get<PosesLost>(notices_[0]).last_seq, 5u);
}

TEST_F(TrackResumeTest, PermanentErrorsAreNotRetried) {
  for (const auto& [code, reason] :
       std::vector<std::pair<grpc::StatusCode, std::string>>{{grpc::StatusCode::ABORTED, "FENCED"},
                                                             {grpc::StatusCode::NOT_FOUND, "SESSION_NOT_FOUND"},
                                                             {grpc::StatusCode::NOT_FOUND, "SESSION_DELETED"},
                                                             {grpc::StatusCode::INTERNAL, "STORE_FAILED"},
                                                             {grpc::StatusCode::RESOURCE_EXHAUSTED, "STORE_FULL"}}) {
    ClearStreams();
    scripts_ = {BreakAfter(1, 1, 0, WithReason(code, reason))};
    ExpectError(Run(), static_cast<absl::StatusCode>(code), reason);
    EXPECT_EQ(attaches_.size(), 1u) << reason;
  }
  EXPECT_THAT(changes_, IsEmpty());
}

TEST_F(TrackResumeTest, ADamagedChunkIsSentAgainUpToALimit) {
  const grpc::Status damaged = WithReason(grpc::StatusCode::DATA_LOSS, "CRC_MISMATCH");
  scripts_ = {BreakAfter(2, 1, 0, damaged), FinishFrom(2, 1, 0)};
  EXPECT_TRUE(Run().ok());
  ClearStreams();
  scripts_.assign(20, Refuse(damaged));
  ExpectError(Run(), absl::StatusCode::kDataLoss, "CRC_MISMATCH");
  EXPECT_EQ(attaches_.size(), 5u);
}

TEST_F(TrackResumeTest, ANewTokenIsPersistedBeforeItsUse) {
  bool was_kept = false, was_used_before = false;
  scripts_ = {[&](const v1::TrackRequest::Attach&, ServerStream& stream) {
    stream.Write(AttachedAt(1, 1, "T1"));
    v1::TrackRequest request;
    stream.Read(&request);
    was_used_before = !was_kept;
    while (stream.Read(&request) && !request.has_end()) continue;
    stream.Write(SummaryMessage(0));
    return grpc::Status::OK;
  }};
  TrackCallbacks callbacks;
  callbacks.on_position = [&](const TrackPosition& position, bool has_new_token) {
    was_kept = was_kept || (has_new_token && position.resume_token == "T1");
    return absl::OkStatus();
  };
  ASSERT_TRUE(client_->Track(session_, Source({8}), callbacks, options_).ok());
  EXPECT_TRUE(was_kept);
  EXPECT_FALSE(was_used_before);

  ClearStreams();
  const auto has_come = std::make_shared<std::promise<bool>>();
  scripts_ = {[has_come](const v1::TrackRequest::Attach&, ServerStream& stream) {
    stream.Write(AttachedAt(1, 1, "T1"));
    v1::TrackRequest request;
    has_come->set_value(stream.Read(&request));
    return grpc::Status::OK;
  }};
  callbacks.on_position = [](const TrackPosition&, bool) { return absl::ResourceExhaustedError("disk full"); };
  ExpectError(client_->Track(session_, Source({8}), callbacks, options_), absl::StatusCode::kResourceExhausted,
              "disk full");
  EXPECT_FALSE(has_come->get_future().get()) << "a token that is not kept must not be used";
}

TEST_F(TrackResumeTest, AServerWithASmallerChunkLimitIsAnError) {
  scripts_ = {BreakAfter(2, 1, 0, kCut), [](const v1::TrackRequest::Attach&, ServerStream& stream) {
                v1::TrackResponse attached = AttachedAt(3, 1, "");
                attached.mutable_attached()->set_max_chunk_bytes(1 << 10);
                stream.Write(attached);
                v1::TrackRequest request;
                while (stream.Read(&request)) continue;
                return grpc::Status::OK;
              }};
  ExpectError(Run(), absl::StatusCode::kFailedPrecondition, "takes chunks of at most 1024 bytes");
}

TEST_F(TrackResumeTest, AStopRequestEndsTheWait) {
  scripts_ = {Refuse(kCut), Refuse(kCut), Refuse(kCut)};
  TrackCallbacks callbacks;
  callbacks.on_connection = [this](const ConnectionChange& change) {
    if (change.outage > absl::ZeroDuration()) options_.stop.request_stop();
  };
  ExpectError(client_->Track(session_, Source({8}), callbacks, options_), absl::StatusCode::kCancelled, "cancelled");
}

// The sessions of this only server end with the process: after GoAway its client keeps the stream until the summary.
TEST_F(TrackResumeTest, GoAwayOfTheOnlyServer) {
  scripts_ = {[](const v1::TrackRequest::Attach&, ServerStream& stream) {
    stream.Write(AttachedAt(1, 1, ""));
    stream.Write(GoAwayNotice());
    ReadToEnd(stream);
    stream.Write(SummaryMessage(0));
    return grpc::Status::OK;
  }};
  EXPECT_TRUE(Run().ok());
  EXPECT_EQ(attaches_.size(), 1u);
  ASSERT_EQ(notices_.size(), 1u);
}

// Two servers that share their sessions.
class TwoServersTest : public TrackResumeTest {
 protected:
  void SetUp() override {
    TrackResumeTest::SetUp();
    std::string addresses;
    for (ScriptedService* service : {&service_, &other_}) {
      int port = 0;
      grpc::ServerBuilder builder;
      builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
      builder.RegisterService(service);
      builder.RegisterService(&admin_[service == &other_]);
      sockets_.push_back(builder.BuildAndStart());
      names_.push_back("127.0.0.1:" + std::to_string(port));
      addresses += (addresses.empty() ? "" : ",") + names_.back();
    }
    other_.script = [this](ServerStream& stream) {
      ++num_other_;
      return service_.script(stream);
    };
    auto client = Client::Connect(addresses);
    ASSERT_TRUE(client.ok()) << client.status();
    client_ = *std::move(client);
  }
  void TearDown() override {
    for (const auto& socket : sockets_) socket->Shutdown();
    TrackResumeTest::TearDown();
  }

  class Admin final : public v1::AdminService::Service {
   public:
    grpc::Status GetServerInfo(grpc::ServerContext*, const v1::GetServerInfoRequest*, v1::ServerInfo* info) override {
      info->set_store(v1::STORE_KIND_REDIS);
      return grpc::Status::OK;
    }
  };

  ScriptedService other_;
  Admin admin_[2];
  std::vector<std::unique_ptr<grpc::Server>> sockets_;
  std::vector<std::string> names_;
  int num_other_ = 0;  // streams of the second server
};

TEST_F(TwoServersTest, TheOtherServerIsTriedAtOnce) {
  scripts_ = {BreakAfter(3, 1, 2, kCut), FinishFrom(4, 3, 5)};
  const auto summary = Run();
  ASSERT_TRUE(summary.ok()) << summary.status();
  EXPECT_EQ(num_other_, 1);
  EXPECT_THAT(PoseSeqs(), ElementsAre(1, 2, 3, 4, 5));
  EXPECT_EQ(clock_.Now(), absl::UnixEpoch());
  ASSERT_EQ(changes_.size(), 2u);
  EXPECT_EQ(changes_[1].server, names_[1]);
}

TEST_F(TwoServersTest, WaitsAfterBothServersHaveFailed) {
  scripts_ = {Refuse(kCut), Refuse(kCut), FinishFrom(1, 1, 0)};
  ASSERT_TRUE(Run().ok());
  EXPECT_EQ(num_other_, 1);
  EXPECT_EQ(clock_.Now() - absl::UnixEpoch(), absl::Milliseconds(100));
}

TEST_F(TwoServersTest, ASessionThatNoServerHas) {
  scripts_.assign(5, Refuse(WithReason(grpc::StatusCode::NOT_FOUND, "SESSION_NOT_FOUND")));
  EXPECT_EQ(Run().status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(attaches_.size(), 2u);
}

TEST_F(TwoServersTest, ADrainingServerIsReplaced) {
  scripts_ = {[](const v1::TrackRequest::Attach&, ServerStream& stream) {
                stream.Write(AttachedAt(1, 1, ""));
                v1::TrackRequest request;
                stream.Read(&request);
                stream.Write(GoAwayNotice());
                uint64_t last_seq = request.events().seq();
                // Reads until the client half-closes, which it does without `end` unless it has already sent `end`.
                while (stream.Read(&request)) last_seq = request.has_end() ? 6 : request.events().seq();
                stream.Write(PoseMessage(1));
                stream.Write(AckUpTo(std::min<uint64_t>(last_seq, 5), 0));
                return grpc::Status::OK;
              },
              [](const v1::TrackRequest::Attach&, ServerStream& stream) {
                stream.Write(AttachedAt(6, 2, ""));
                ReadToEnd(stream);
                stream.Write(SummaryMessage(1));
                return grpc::Status::OK;
              }};
  const auto summary = Run();
  ASSERT_TRUE(summary.ok()) << summary.status();
  EXPECT_EQ(num_other_, 1);
  EXPECT_THAT(PoseSeqs(), ElementsAre(1));
}

}  // namespace
}  // namespace evpose::client

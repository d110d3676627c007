// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/stream/stream_gate.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <vector>

#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

constexpr uint64_t kCredit = 100;
const absl::Time kCreated = absl::UnixEpoch();

std::string ReasonOf(const absl::Status& status) { return GetErrorDetails(status).reason; }

class StreamGateTest : public testing::Test {
 protected:
  StreamGateTest() : gate_(MakeGate({.lifecycle = {.token_digest = TokenDigest("first"), .detached_at = kCreated}})) {}

  StreamGate MakeGate(StreamGate::Start start, OverloadPolicy policy = OverloadPolicy::kBlock) {
    if (start.resume_token.empty()) start.resume_token = "first";
    return StreamGate({.session = "sessions/a",
                       .credit_bytes = kCredit,
                       .overload_policy = policy,
                       .on_transition = [this](const GateTransition& change) { changes_.push_back(change); }},
                      std::move(start));
  }
  static uint64_t Attach(StreamGate& gate, const std::string& token = "first", const std::string& next = "second",
                         uint64_t queued_bytes = 0) {
    return gate.Attach(next, TokenDigest(token), queued_bytes, 0);
  }

  std::vector<GateTransition> changes_;
  StreamGate gate_;
};

TEST(ResumeTokenTest, OnlyTheCurrentAndAnUnconfirmedPreviousTokenAreGood) {
  const SessionLifecycle both = {.token_digest = TokenDigest("new"), .previous_token_digest = TokenDigest("old")};
  EXPECT_TRUE(IsDigestValid(TokenDigest("new"), both));
  EXPECT_TRUE(IsDigestValid(TokenDigest("old"), both));
  EXPECT_FALSE(IsDigestValid(TokenDigest("older"), both));
  const SessionLifecycle one = {.token_digest = TokenDigest("new")};
  EXPECT_FALSE(IsDigestValid(TokenDigest("old"), one));
  EXPECT_FALSE(IsDigestValid("", one)) << "an absent previous token is not a token";
}

TEST_F(StreamGateTest, StartsDetachedAndOpen) {
  EXPECT_EQ(gate_.state(), GateState());
  EXPECT_FALSE(gate_.is_attached());
  EXPECT_EQ(gate_.stream(), 0u);
  EXPECT_EQ(gate_.next_seq(), 1u);
  EXPECT_EQ(gate_.detached_at(), kCreated);
  EXPECT_EQ(gate_.resume_token(), "first");
  EXPECT_EQ(gate_.SendLimit(), kCredit);
  EXPECT_FALSE(gate_.TakeChangedLifecycle().has_value()) << "the store has the record of the beginning";
}

TEST_F(StreamGateTest, ResumesFromACheckpoint) {
  const absl::Time now = kCreated + absl::Seconds(5);
  const StreamGate attached = MakeGate({.lifecycle = {.token_digest = TokenDigest("first"), .num_attaches = 3},
                                        .detached_at = now,
                                        .processed_seq = 7,
                                        .has_ended = true});
  EXPECT_EQ(attached.detached_at(), now) << "the stream ended with its server";
  EXPECT_EQ(attached.stream(), 3u);
  EXPECT_EQ(attached.next_seq(), 8u);
  EXPECT_TRUE(attached.has_ended());
  const StreamGate detached = MakeGate({.lifecycle = {.detached_at = kCreated}, .detached_at = now});
  EXPECT_EQ(detached.detached_at(), kCreated);
}

TEST_F(StreamGateTest, AttachChecksTokenAndPosition) {
  EXPECT_TRUE(gate_.CheckAttach(TokenDigest("first"), 5, 5).ok());
  const absl::Status wrong = gate_.CheckAttach(TokenDigest("guess"), 0, 0);
  EXPECT_EQ(wrong.code(), absl::StatusCode::kPermissionDenied);
  EXPECT_EQ(ReasonOf(wrong), "WRONG_TOKEN");
  const absl::Status ahead = gate_.CheckAttach(TokenDigest("first"), 6, 5);
  EXPECT_EQ(ahead.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(GetErrorDetails(ahead).field, "attach.last_pose_seq");

  const StreamGate resumed = MakeGate({.lifecycle = {.token_digest = TokenDigest("first")}, .max_seen_pose_seq = 9});
  EXPECT_TRUE(resumed.CheckAttach(TokenDigest("first"), 9, 5).ok());
  EXPECT_TRUE(resumed.CheckAttach(TokenDigest("first"), 10, 10).ok());
  EXPECT_EQ(GetErrorDetails(resumed.CheckAttach(TokenDigest("first"), 10, 5)).field, "attach.last_pose_seq");

  EXPECT_TRUE(gate_.Close(absl::NotFoundError("deleted")));
  EXPECT_EQ(gate_.CheckAttach(TokenDigest("guess"), 0, 0).code(), absl::StatusCode::kNotFound);
}

TEST_F(StreamGateTest, OnlyItsClientCanReportLostItems) {
  StreamGate gate = MakeGate({.lifecycle = {.token_digest = TokenDigest("first")}, .processed_seq = 4});
  EXPECT_TRUE(gate.CheckFirstSeq(TokenDigest("first"), 0).ok());
  EXPECT_TRUE(gate.CheckFirstSeq(TokenDigest("first"), 5).ok());
  EXPECT_TRUE(gate.CheckFirstSeq(TokenDigest("guessed"), 6).ok());
  EXPECT_EQ(ReasonOf(gate.CheckFirstSeq(TokenDigest("first"), 6)), "ROLLED_BACK");
  ASSERT_TRUE(gate.Close(absl::NotFoundError("deleted")));
  EXPECT_TRUE(gate.CheckFirstSeq(TokenDigest("first"), 6).ok()) << "CheckAttach() states why the session is closed";
}

TEST_F(StreamGateTest, LostItemsEndTheSessionForGood) {
  StreamGate gate = MakeGate({.lifecycle = {.token_digest = TokenDigest("first")}, .processed_seq = 4});
  gate.RecordLoss();
  EXPECT_TRUE(gate.TakeChangedLifecycle().has_value());
  EXPECT_EQ(gate.lifecycle().lost_from_seq, 5u);
  EXPECT_TRUE(gate.closed().ok()) << "the record is to be committed first";
  const StreamGate restored = MakeGate({.lifecycle = gate.lifecycle(), .processed_seq = 4});
  EXPECT_EQ(ReasonOf(restored.closed()), "ROLLED_BACK");
  EXPECT_EQ(ReasonOf(restored.CheckAttach(TokenDigest("first"), 0, 0)), "ROLLED_BACK");
}

TEST_F(StreamGateTest, AStreamFencesTheOneBefore) {
  const uint64_t first = Attach(gate_);
  EXPECT_EQ(first, 1u);
  EXPECT_TRUE(gate_.CheckStream(first).ok());
  const uint64_t second = Attach(gate_, "second", "third");
  EXPECT_EQ(second, 2u);
  EXPECT_TRUE(gate_.CheckPush(second).ok());
  const absl::Status fenced = gate_.CheckPush(first);
  EXPECT_EQ(fenced.code(), absl::StatusCode::kAborted);
  EXPECT_EQ(ReasonOf(fenced), "FENCED");
  EXPECT_FALSE(gate_.Detach(first, kCreated)) << "the fenced stream no longer counts";
  EXPECT_TRUE(gate_.is_attached());
}

TEST_F(StreamGateTest, ReceivesUntilTheClientOfTheLatestStreamHalfClosesIt) {
  EXPECT_FALSE(gate_.may_receive()) << "no stream";
  Attach(gate_);
  EXPECT_TRUE(gate_.may_receive());
  gate_.HalfClose(1);
  EXPECT_FALSE(gate_.may_receive());
  EXPECT_TRUE(gate_.is_attached());
  Attach(gate_, "second", "third");
  EXPECT_TRUE(gate_.may_receive()) << "another stream";
  gate_.HalfClose(1);
  EXPECT_TRUE(gate_.may_receive()) << "the stream before";
  gate_.HalfClose(2);
  gate_.HalfClose(1);
  EXPECT_FALSE(gate_.may_receive()) << "the stream before changes nothing";
}

TEST_F(StreamGateTest, ThePreviousTokenIsGoodUntilTheStreamSends) {
  const uint64_t stream = Attach(gate_);
  EXPECT_EQ(gate_.resume_token(), "second");
  EXPECT_TRUE(gate_.CheckAttach(TokenDigest("first"), 0, 0).ok()) << "the client may not have received the new one";
  EXPECT_TRUE(gate_.CheckAttach(TokenDigest("second"), 0, 0).ok());
  EXPECT_TRUE(gate_.TakeChangedLifecycle().has_value());
  EXPECT_TRUE(gate_.CheckPush(stream).ok());
  EXPECT_EQ(ReasonOf(gate_.CheckAttach(TokenDigest("first"), 0, 0)), "WRONG_TOKEN");
  EXPECT_TRUE(gate_.TakeChangedLifecycle().has_value()) << "the invalidation must be persisted";
  EXPECT_TRUE(gate_.CheckPush(stream).ok());
  EXPECT_FALSE(gate_.TakeChangedLifecycle().has_value());
}

TEST_F(StreamGateTest, AttachingAgainWithThePreviousTokenKeepsIt) {
  Attach(gate_);
  Attach(gate_, "first", "third");
  EXPECT_TRUE(gate_.CheckAttach(TokenDigest("first"), 0, 0).ok());
  EXPECT_TRUE(gate_.CheckAttach(TokenDigest("third"), 0, 0).ok());
  EXPECT_EQ(ReasonOf(gate_.CheckAttach(TokenDigest("second"), 0, 0)), "WRONG_TOKEN");
}

TEST_F(StreamGateTest, ReplacedTokensKeepThePreviousOne) {
  gate_.ReplaceToken("other");
  EXPECT_EQ(gate_.resume_token(), "other");
  EXPECT_TRUE(gate_.CheckAttach(TokenDigest("first"), 0, 0).ok());
  EXPECT_TRUE(gate_.CheckAttach(TokenDigest("other"), 0, 0).ok());
  EXPECT_EQ(gate_.lifecycle_number(), 1u);
}

TEST_F(StreamGateTest, IsAttachedOnceTheRecordHasBeenPersisted) {
  gate_.ReplaceToken("other");
  Attach(gate_, "other");
  EXPECT_EQ(gate_.lifecycle_number(), 2u);
  gate_.OnLifecyclePersisted(1);
  EXPECT_EQ(gate_.state().writer, WriterState::kAttaching);
  gate_.OnLifecyclePersisted(2);
  EXPECT_EQ(gate_.state().writer, WriterState::kAttached);
  Attach(gate_, "second");
  EXPECT_EQ(gate_.state().writer, WriterState::kAttaching) << "the record of the new stream has not been persisted";
  gate_.OnLifecyclePersisted(gate_.lifecycle_number());
  EXPECT_EQ(gate_.state().writer, WriterState::kAttached);
}

TEST_F(StreamGateTest, TheRecordFollowsTheStreams) {
  EXPECT_EQ(gate_.lifecycle().detached_at, kCreated);
  EXPECT_FALSE(gate_.RenewOwnership()) << "no stream is attached";
  const uint64_t stream = Attach(gate_);
  EXPECT_EQ(gate_.lifecycle().num_attaches, 1u);
  EXPECT_FALSE(gate_.lifecycle().detached_at.has_value());
  EXPECT_FALSE(gate_.detached_at().has_value());
  EXPECT_EQ(gate_.lifecycle().previous_token_digest, TokenDigest("first"));
  const uint64_t number = gate_.lifecycle_number();
  EXPECT_TRUE(gate_.RenewOwnership());
  EXPECT_EQ(gate_.lifecycle().num_renewals, 1u);
  EXPECT_EQ(gate_.lifecycle_number(), number + 1);
  const absl::Time later = kCreated + absl::Seconds(9);
  EXPECT_TRUE(gate_.Detach(stream, later));
  EXPECT_EQ(gate_.lifecycle().detached_at, later);
  EXPECT_EQ(gate_.lifecycle_number(), number + 2);
  EXPECT_FALSE(gate_.Detach(stream, later + absl::Seconds(1))) << "once";
  EXPECT_EQ(gate_.detached_at(), later);
  EXPECT_TRUE(gate_.CheckPush(stream).ok()) << "items of the last stream may still be on their way";
}

TEST_F(StreamGateTest, ItemsComeInOrder) {
  const uint64_t stream = Attach(gate_);
  EXPECT_EQ(stream, 1u);
  EXPECT_EQ(gate_.IsNext(1).value(), true);
  EXPECT_EQ(gate_.IsNext(1).value(), true) << "a check accepts nothing";
  gate_.Accept();
  EXPECT_EQ(gate_.IsNext(1).value(), false);
  EXPECT_EQ(gate_.AcceptChunk(2, 10).value(), true);
  EXPECT_EQ(gate_.AcceptChunk(2, 10).value(), false);
  EXPECT_EQ(gate_.next_seq(), 3u);
  const absl::Status gap = gate_.AcceptChunk(4, 10).status();
  EXPECT_EQ(gap.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(ReasonOf(gap), "SEQ_GAP");
  EXPECT_THAT(GetErrorDetails(gap).metadata,
              testing::ElementsAre(testing::Pair("expected_seq", "3"), testing::Pair("seq", "4")));
  EXPECT_EQ(gate_.next_seq(), 3u);
}

TEST_F(StreamGateTest, NothingFollowsTheEnd) {
  Attach(gate_);
  ASSERT_TRUE(gate_.AcceptChunk(1, 10).ok());
  EXPECT_TRUE(gate_.AcceptEnd());
  EXPECT_FALSE(gate_.AcceptEnd());
  EXPECT_FALSE(gate_.has_ended()) << "it has not been processed";
  EXPECT_EQ(ReasonOf(gate_.AcceptChunk(2, 10).status()), "SESSION_ENDED");
  EXPECT_EQ(gate_.AcceptChunk(1, 10).value(), false) << "a repeated item is dropped, after the end, too";
  gate_.OnEndProcessed();
  EXPECT_TRUE(gate_.has_ended());
  EXPECT_FALSE(gate_.AcceptEnd());
  EXPECT_TRUE(gate_.is_attached()) << "the stream still reads poses";
}

TEST_F(StreamGateTest, CreditReturnsWithProcessedBytes) {
  const uint64_t stream = Attach(gate_);
  EXPECT_EQ(gate_.SendLimit(), kCredit);
  ASSERT_TRUE(gate_.AcceptChunk(1, 60).value());
  EXPECT_EQ(gate_.SendLimit(), kCredit) << "received bytes wait";
  gate_.OnProcessed(stream, 60);
  EXPECT_EQ(gate_.SendLimit(), kCredit + 60);
  ASSERT_FALSE(gate_.AcceptChunk(1, 60).value());
  EXPECT_EQ(gate_.SendLimit(), kCredit + 120) << "a repeated chunk occupies no memory";
}

TEST_F(StreamGateTest, BytesOfEarlierStreamsOccupyTheCredit) {
  const uint64_t first = Attach(gate_);
  ASSERT_TRUE(gate_.AcceptChunk(1, 60).value());
  Attach(gate_, "second", "third", 60);
  EXPECT_EQ(gate_.SendLimit(), kCredit - 60);
  gate_.OnProcessed(first, 60);
  EXPECT_EQ(gate_.SendLimit(), kCredit);
  Attach(gate_, "third", "fourth", kCredit + 1);
  EXPECT_EQ(gate_.SendLimit(), 0u) << "never below zero";
}

TEST_F(StreamGateTest, WithLatestACameraDoesNotWait) {
  StreamGate gate = MakeGate({.lifecycle = {.token_digest = TokenDigest("first")}}, OverloadPolicy::kLatest);
  const uint64_t stream = Attach(gate, "first", "second", 500);
  EXPECT_EQ(gate.SendLimit(), kCredit);
  ASSERT_TRUE(gate.AcceptChunk(1, 60).value());
  EXPECT_EQ(gate.SendLimit(), kCredit + 60);
  gate.OnProcessed(stream, 60);
  EXPECT_EQ(gate.SendLimit(), kCredit + 60);
}

TEST_F(StreamGateTest, TheFirstCloseCounts) {
  const uint64_t stream = Attach(gate_);
  EXPECT_TRUE(gate_.Close(absl::NotFoundError("deleted")));
  EXPECT_FALSE(gate_.Close(absl::AbortedError("fenced")));
  EXPECT_EQ(gate_.closed().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(gate_.CheckPush(stream).code(), absl::StatusCode::kNotFound);
  EXPECT_FALSE(gate_.is_attached());
  EXPECT_EQ(gate_.detached_at(), kCreated);
  EXPECT_FALSE(gate_.Detach(stream, kCreated + absl::Seconds(1)));
  EXPECT_FALSE(gate_.RenewOwnership());
}

TEST_F(StreamGateTest, ReportsEachChangeOfItsStateOnce) {
  const uint64_t stream = Attach(gate_);
  gate_.OnLifecyclePersisted(1);
  gate_.OnLifecyclePersisted(1);
  gate_.AcceptEnd();
  gate_.AcceptEnd();
  gate_.OnEndProcessed();
  gate_.Detach(stream, kCreated);
  gate_.Close(absl::NotFoundError("deleted"));
  std::vector<GateEvent> events;
  for (const GateTransition& change : changes_) events.push_back(change.event);
  EXPECT_THAT(events, testing::ElementsAre(GateEvent::kAttach, GateEvent::kAttachPersisted, GateEvent::kEndPushed,
                                           GateEvent::kEndProcessed, GateEvent::kDetach, GateEvent::kClose));
  EXPECT_EQ(changes_.front().from, GateState());
  EXPECT_EQ(changes_.front().to.writer, WriterState::kAttaching);
  EXPECT_EQ(changes_.back().to, (GateState{WriterState::kClosed, InputState::kEnded}));
}

TEST_F(StreamGateTest, SentPosesStartWithTheStream) {
  gate_.Attach("second", TokenDigest("first"), 0, 40);
  EXPECT_EQ(gate_.sent_pose_seq(), 40u);
  gate_.ReportSent(41);
  EXPECT_EQ(gate_.sent_pose_seq(), 41u);
}

}  // namespace
}  // namespace evpose::server

// SPDX-License-Identifier: Apache-2.0

// Tests of the client after the server's store has lost its last writes: the server requests chunks again that it had
// reported as durable.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <future>
#include <string>
#include <vector>

#include "client/lib/messages/conversion.h"
#include "client/lib/stream/outgoing_chunk.h"
#include "client/lib/stream/track_resume_testing.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAre;

using TrackRollbackTest = TrackResumeTest;

TEST_F(TrackRollbackTest, ALossOfDurableChunksIsAnError) {
  scripts_ = {[](const v1::TrackRequest::Attach&, ServerStream& stream) {
                stream.Write(AttachedAt(1, 1, ""));
                v1::TrackRequest request;
                while (stream.Read(&request) && request.events().seq() < 3) continue;
                stream.Write(AckUpTo(3, 3));
                return kCut;
              },
              [](const v1::TrackRequest::Attach&, ServerStream& stream) {
                stream.Write(AttachedAt(2, 1, ""));
                v1::TrackRequest request;
                while (stream.Read(&request)) continue;
                return grpc::Status::OK;
              }};
  options_.retain.duration = absl::ZeroDuration();
  const auto result = Run();
  ExpectError(result, absl::StatusCode::kDataLoss,
              "requests chunk 2 again, which it had reported as durable (up to 3)");
  EXPECT_EQ(ReasonOf(result.status()), v1::ROLLED_BACK);
  ASSERT_EQ(attaches_.size(), 2u) << "the server was told";
  EXPECT_EQ(attaches_[0].first_seq(), 1u);
  EXPECT_EQ(attaches_[1].first_seq(), 4u);
}

TEST_F(TrackRollbackTest, AStoreThatLostDurableChunksReceivesThemAgain) {
  scripts_ = {[](const v1::TrackRequest::Attach&, ServerStream& stream) {
                stream.Write(AttachedAt(1, 1, ""));
                v1::TrackRequest request;
                while (stream.Read(&request) && request.events().seq() < 4) continue;
                stream.Write(PoseMessage(1));
                stream.Write(AckUpTo(4, 4));
                return kCut;
              },
              FinishFrom(2, 1, 3)};
  const auto result = Run();
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(attaches_[1].first_seq(), 1u);
  EXPECT_THAT(PoseSeqs(), ElementsAre(1, 2, 3)) << "no pose is delivered twice";
}

// A process that continues does not know yet which chunks it will have. It tells the server when it does.
TEST_F(TrackRollbackTest, AContinuedProcessTellsTheServerThatChunksAreLost) {
  FeedPoint skip;
  for (uint64_t i = 0; i < 4; ++i) skip = MakeOutgoingChunk(skip, std::string(8, static_cast<char>(i)), false).end;
  const TrackPosition position = {
      .session = session_.name, .resume_token = "token", .durable = skip, .max_piece_bytes = 8};
  options_.retain.max_bytes = uint64_t{2} * (8 + 128);
  std::promise<void> attached;  // the source has no chunk before
  const ChunkSource source = [chunks = Source({8, 8, 8, 8, 8}), is_attached = attached.get_future().share()]() mutable {
    is_attached.wait();
    return chunks();
  };
  scripts_ = {[&attached](const v1::TrackRequest::Attach&, ServerStream& stream) {
                attached.set_value();
                stream.Write(AttachedAt(2, 1, ""));
                v1::TrackRequest request;
                while (stream.Read(&request)) continue;
                return grpc::Status::OK;
              },
              Refuse(WithReason(grpc::StatusCode::DATA_LOSS, "ROLLED_BACK"))};
  const auto result = client_->Track(position, source, Callbacks(), options_);
  EXPECT_EQ(ReasonOf(result.status()), v1::ROLLED_BACK);
  ASSERT_EQ(attaches_.size(), 2u);
  EXPECT_EQ(attaches_[0].first_seq(), 0u);
  EXPECT_EQ(attaches_[1].first_seq(), 3u);
}

TEST_F(TrackRollbackTest, AStoreThatLostSeveralAttachesKnowsAnOldToken) {
  const grpc::Status wrong_token = WithReason(grpc::StatusCode::PERMISSION_DENIED, "WRONG_TOKEN");
  for (const char* const token : {"T1", "T2", "T3"}) {
    scripts_.push_back([token](const v1::TrackRequest::Attach&, ServerStream& stream) {
      stream.Write(AttachedAt(1, 1, token));
      return kCut;
    });
  }
  for (int i = 0; i < 3; ++i) scripts_.push_back(Refuse(wrong_token));
  scripts_.push_back(FinishFrom(1, 1, 0));
  const auto result = Run();
  ASSERT_TRUE(result.ok()) << result.status();
  std::vector<std::string> tokens;
  for (const v1::TrackRequest::Attach& attach : attaches_) tokens.push_back(attach.resume_token());
  EXPECT_THAT(tokens, ElementsAre("secret", "T1", "T2", "T3", "T2", "T1", "secret"));
}

}  // namespace
}  // namespace evpose::client

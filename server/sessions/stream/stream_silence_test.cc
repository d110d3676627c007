// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/stream/stream_silence.h"

#include <gtest/gtest.h>

namespace evpose::server {
namespace {

using std::chrono::seconds;

class StreamSilenceTest : public testing::Test {
 protected:
  // The situation after `advance`, and the silence then, in seconds.
  int64_t After(int64_t advance_s, StreamSilence::Situation situation) {
    now_ += seconds(advance_s);
    return absl::ToInt64Seconds(silence_.Update(situation, now_));
  }

  static constexpr StreamSilence::Situation kMaySend = {.is_reading = true, .is_processed = true};
  StreamSilence silence_;
  StreamSilence::Time now_;
};

TEST_F(StreamSilenceTest, CountsWhileTheClientMaySend) {
  EXPECT_EQ(After(1, kMaySend), 0);
  EXPECT_EQ(After(5, kMaySend), 5);
  EXPECT_EQ(After(5, {.is_reading = true, .is_processed = true, .is_writing = true}), 10);
  silence_.OnWritten();
  EXPECT_EQ(After(1, kMaySend), 11) << "a client that only reads is silent";
  silence_.OnMessage();
  EXPECT_EQ(After(0, kMaySend), 0);
  EXPECT_EQ(After(2, kMaySend), 2);
}

TEST_F(StreamSilenceTest, DoesNotCountWhileTheServerDoesNotRead) {
  EXPECT_EQ(After(0, kMaySend), 0);
  EXPECT_EQ(After(9, {.is_processed = true}), 0);
  EXPECT_EQ(After(9, {.is_writing = true}), 0);
  EXPECT_EQ(After(9, kMaySend), 0) << "it begins anew";
  EXPECT_EQ(After(9, kMaySend), 9);
}

TEST_F(StreamSilenceTest, DoesNotCountWhileReceivedChunksWait) {
  EXPECT_EQ(After(0, {.is_reading = true}), 0);
  EXPECT_EQ(After(100, {.is_reading = true}), 0);
  EXPECT_EQ(After(100, kMaySend), 0) << "the client has its credit only now";
  EXPECT_EQ(After(3, kMaySend), 3);
  EXPECT_EQ(After(3, {.is_reading = true}), 0);
}

// A client that does not read its responses stops its session, whose chunks then wait.
TEST_F(StreamSilenceTest, CountsWhileTheClientDoesNotRead) {
  constexpr StreamSilence::Situation kMustRead = {.is_reading = true, .is_writing = true};
  EXPECT_EQ(After(0, kMustRead), 0);
  EXPECT_EQ(After(7, kMustRead), 7);
  silence_.OnWritten();
  EXPECT_EQ(After(0, kMustRead), 0) << "the next response";
  EXPECT_EQ(After(7, kMustRead), 7);
  silence_.OnWritten();
  EXPECT_EQ(After(7, {.is_reading = true}), 0);
}

}  // namespace
}  // namespace evpose::server

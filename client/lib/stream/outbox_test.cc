// SPDX-License-Identifier: Apache-2.0
#include "client/lib/stream/outbox.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <csignal>
#include <filesystem>
#include <future>
#include <string>

#include "client/lib/fake_clock_testing.h"
#include "client/lib/messages/status_details.h"
#include "client/lib/stream/event_feed.h"
#include "core/base/poll_testing.h"
#include "core/base/status_macros.h"
#include "core/base/temporary_directory_testing.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

class OutboxTest : public ::testing::Test {
 protected:
  void Open(const OutboxOptions& options, const FeedPoint& begin = {}) {
    auto outbox = Outbox::Open(options, begin);
    ASSERT_TRUE(outbox.ok()) << outbox.status();
    outbox_ = *std::move(outbox);
  }

  // Durable chunks are not retained.
  static OutboxOptions NothingRetained() {
    OutboxOptions options;
    options.retain.duration = absl::ZeroDuration();
    return options;
  }

  SpoolOptions SpoolThere(bool outlives_process) const {
    SpoolOptions options;
    options.directory = directory_;
    options.max_bytes = 16 << 20;
    options.outlives_process = outlives_process;
    return options;
  }

  absl::Status Append(size_t size) {
    const FeedPoint point = outbox_->state().last;
    const char letter = static_cast<char>('a' + point.seq % 26);
    return outbox_->Append(MakeOutgoingChunk(point, std::string(size, letter), false), stop_.get_token());
  }

  // The letter that fills the chunk.
  char LetterOf(uint64_t seq) {
    const auto chunk = outbox_->Get(seq, stop_.get_token());
    EXPECT_TRUE(chunk.ok()) << chunk.status();
    if (!chunk.ok() || *chunk == nullptr) return '?';
    EXPECT_EQ((*chunk)->end.seq, seq);
    return (*chunk)->payload[0];
  }

  const TemporaryDirectory parent_;
  const std::string directory_ = parent_.File("spool");
  std::unique_ptr<Outbox> outbox_;
  std::stop_source stop_;
};

TEST_F(OutboxTest, KeepsChunksThatAreNotDurable) {
  Open(NothingRetained());
  for (int i = 0; i < 5; ++i) ASSERT_TRUE(Append(8).ok());
  EXPECT_EQ(LetterOf(1), 'a');
  EXPECT_EQ(LetterOf(5), 'e');
  EXPECT_EQ(outbox_->state().kept_bytes, 40u);
  outbox_->Release(3);
  EXPECT_EQ(outbox_->state().kept_bytes, 16u);
  EXPECT_EQ(outbox_->durable().seq, 3u);
  EXPECT_EQ(outbox_->durable().bytes, 24u);
  EXPECT_EQ(LetterOf(4), 'd') << "again, after a break";
  const auto released = outbox_->Get(3, stop_.get_token());
  EXPECT_EQ(released.status().code(), absl::StatusCode::kDataLoss);
  EXPECT_THAT(released.status().message(),
              HasSubstr("requests chunk 3 again, which it had reported as durable (up to 3)"));
  outbox_->Release(1);  // an old ack
  EXPECT_EQ(outbox_->durable().seq, 3u);
}

TEST_F(OutboxTest, EndsAfterItsLastChunk) {
  Open({});
  ASSERT_TRUE(Append(8).ok());
  outbox_->Finish(absl::OkStatus());
  EXPECT_EQ(LetterOf(1), 'a');
  const auto end = outbox_->Get(2, stop_.get_token());
  ASSERT_TRUE(end.ok());
  EXPECT_EQ(*end, nullptr);
  const auto beyond = outbox_->Get(4, stop_.get_token());
  EXPECT_EQ(beyond.status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(beyond.status().message(), HasSubstr("has 3 chunks of this session, but there are 1 only"));
}

TEST_F(OutboxTest, ErrorOfTheSourceComesAfterItsChunks) {
  Open({});
  ASSERT_TRUE(Append(8).ok());
  outbox_->Finish(absl::DataLossError("disk gone"));
  EXPECT_EQ(LetterOf(1), 'a');
  EXPECT_EQ(outbox_->Get(2, stop_.get_token()).status(), absl::DataLossError("disk gone"));
}

TEST_F(OutboxTest, WaitsForTheSourceAndIsStopped) {
  Open({});
  auto got = std::async(std::launch::async, [this] { return LetterOf(1); });
  // A reader waits for a chunk: the source must provide one, however short the read-ahead.
  EXPECT_TRUE(outbox_->WaitForDemand(0, stop_.get_token()));
  ASSERT_TRUE(Append(8).ok());
  EXPECT_EQ(got.get(), 'a');
  auto stopped = std::async(std::launch::async, [this] { return outbox_->Get(2, stop_.get_token()).status(); });
  EXPECT_TRUE(outbox_->WaitForDemand(0, {}));
  stop_.request_stop();
  EXPECT_EQ(stopped.get().code(), absl::StatusCode::kCancelled);
  EXPECT_FALSE(outbox_->WaitForDemand(0, stop_.get_token()));
}

TEST_F(OutboxTest, FullMemoryMakesTheSourceWait) {
  OutboxOptions options;
  options.memory_bytes = 1000;
  Open(options);
  ASSERT_TRUE(Append(800).ok());
  auto second = std::async(std::launch::async, [this] { return Append(800); });
  EXPECT_TRUE(Poll([this] { return outbox_->state().is_waiting; }));
  EXPECT_EQ(outbox_->state().last.seq, 1u);
  outbox_->Release(1);
  EXPECT_TRUE(second.get().ok());
  EXPECT_EQ(outbox_->state().last.seq, 2u);
  EXPECT_FALSE(outbox_->state().is_waiting);
  auto third = std::async(std::launch::async, [this] { return Append(800); });
  EXPECT_TRUE(Poll([this] { return outbox_->state().is_waiting; }));
  stop_.request_stop();
  EXPECT_EQ(third.get().code(), absl::StatusCode::kCancelled);
}

TEST_F(OutboxTest, ChunkLargerThanAllTheMemoryIsTakenAlone) {
  OutboxOptions options;
  options.memory_bytes = 10;
  Open(options);
  ASSERT_TRUE(Append(800).ok());
  EXPECT_EQ(LetterOf(1), 'a');
}

TEST_F(OutboxTest, ChunksBeyondTheMemoryAreSpooledAndReturnedInOrder) {
  OutboxOptions options = NothingRetained();
  options.memory_bytes = 2000;
  options.spool = SpoolThere(false);
  Open(options);
  for (int i = 0; i < 20; ++i) ASSERT_TRUE(Append(500).ok());
  EXPECT_EQ(outbox_->state().kept_bytes, 10'000u);
  for (uint64_t seq = 1; seq <= 20; ++seq) EXPECT_EQ(LetterOf(seq), static_cast<char>('a' + seq - 1));
  outbox_->Release(10);
  EXPECT_EQ(outbox_->durable().bytes, 5000u);
  EXPECT_EQ(outbox_->state().kept_bytes, 5000u);
  EXPECT_EQ(LetterOf(11), 'k');
  outbox_->Release(20);
  EXPECT_EQ(outbox_->state().kept_bytes, 0u);
  for (int i = 0; i < 6; ++i) ASSERT_TRUE(Append(500).ok());
  EXPECT_EQ(LetterOf(21), 'u');
  EXPECT_EQ(LetterOf(26), 'z');
  EXPECT_EQ(outbox_->Get(20, stop_.get_token()).status().code(), absl::StatusCode::kDataLoss);
}

TEST_F(OutboxTest, FullSpoolMakesTheSourceWait) {
  OutboxOptions options;
  options.memory_bytes = 1;
  options.spool = SpoolThere(true);
  Open(options);
  for (int i = 0; i < 15; ++i) ASSERT_TRUE(Append(1 << 20).ok());
  auto next = std::async(std::launch::async, [this] { return Append(1 << 20); });
  EXPECT_TRUE(Poll([this] { return outbox_->state().is_waiting; }));
  outbox_->Release(2);
  EXPECT_TRUE(next.get().ok());
}

TEST_F(OutboxTest, FullDiskIsReportedAfterTheStoredChunks) {
  OutboxOptions options;
  options.spool = SpoolThere(true);
  Open(options);
  ASSERT_TRUE(Append(8).ok());
  // A limit on the size of files has the same effect as a full disk.
  rlimit before;
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  std::signal(SIGXFSZ, SIG_IGN);
  rlimit limit = before;
  limit.rlim_cur = 60'000;
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &limit), 0);
  const absl::Status full = Append(100'000);
  setrlimit(RLIMIT_FSIZE, &before);
  EXPECT_THAT(full.message(), HasSubstr(directory_ + ": the spool cannot be written"));
  outbox_->Finish(full);
  EXPECT_EQ(outbox_->state().last.seq, 1u);
  EXPECT_EQ(LetterOf(1), 'a');
  EXPECT_EQ(outbox_->Get(2, stop_.get_token()).status(), full);
}

TEST_F(OutboxTest, AnotherProcessContinuesAfterTheSpooledChunks) {
  OutboxOptions options;
  options.spool = SpoolThere(true);
  Open(options);
  for (int i = 0; i < 5; ++i) ASSERT_TRUE(Append(500).ok());
  const FeedPoint last = outbox_->state().last;
  outbox_.reset();
  Open(options);
  EXPECT_EQ(outbox_->state().last, last);
  EXPECT_EQ(LetterOf(1), 'a');
  ASSERT_TRUE(Append(500).ok());
  EXPECT_EQ(LetterOf(6), 'f');
}

TEST_F(OutboxTest, DurableChunksAreNotKept) {
  Open(NothingRetained());
  outbox_->Release(2);  // received by the server from an earlier process
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(Append(8).ok());
  EXPECT_EQ(outbox_->state().kept_bytes, 8u);
  EXPECT_EQ(outbox_->durable().seq, 2u);
  EXPECT_EQ(LetterOf(3), 'c');
}

TEST_F(OutboxTest, DurableChunksAreRetainedForATime) {
  FakeClock clock;
  OutboxOptions options;
  options.clock = &clock;
  options.memory_bytes = 1;  // retained chunks do not count
  Open(options);
  for (uint64_t seq = 1; seq <= 3; ++seq) {
    ASSERT_TRUE(Append(8).ok());
    outbox_->Release(seq);
    clock.Advance(absl::Seconds(2));
  }
  EXPECT_EQ(outbox_->durable().seq, 3u);
  EXPECT_EQ(outbox_->state().kept_bytes, 0u);
  EXPECT_EQ(LetterOf(1), 'a') << "the last report was 4 s after the first";
  EXPECT_EQ(outbox_->FirstSeq(), 1u);
  ASSERT_TRUE(Append(8).ok());
  outbox_->Release(4);
  EXPECT_EQ(outbox_->FirstSeq(), 2u);
  const auto lost = outbox_->Get(1, stop_.get_token());
  EXPECT_EQ(lost.status().code(), absl::StatusCode::kDataLoss);
  EXPECT_EQ(GetDetails(lost.status()).reason, "ROLLED_BACK");
  EXPECT_EQ(LetterOf(2), 'b');
}

TEST_F(OutboxTest, TheRetainedBytesAreBounded) {
  OutboxOptions options;
  options.retain = {.duration = absl::Hours(1), .max_bytes = 4 * (24 + 128) + 100};
  Open(options);
  for (uint64_t seq = 1; seq <= 100; ++seq) {
    ASSERT_TRUE(Append(24).ok());
    outbox_->Release(seq);
    EXPECT_EQ(outbox_->FirstSeq(), seq < 4 ? 1 : seq - 3);
  }
  EXPECT_EQ(LetterOf(97), 's');
}

TEST_F(OutboxTest, EmptyChunksCountAmongTheRetainedBytes) {
  OutboxOptions options;
  options.retain = {.duration = absl::Hours(1), .max_bytes = 1000};
  Open(options);
  for (uint64_t seq = 1; seq <= 100; ++seq) {
    ASSERT_TRUE(Append(0).ok());
    outbox_->Release(seq);
  }
  EXPECT_EQ(outbox_->FirstSeq(), 94u) << "7 times 128 bytes";
}

TEST_F(OutboxTest, SpooledChunksAreRetainedAndChunksInMemoryFollowThem) {
  FakeClock clock;
  OutboxOptions options;
  options.clock = &clock;
  options.memory_bytes = 2000;
  options.spool = SpoolThere(false);
  Open(options);
  for (int i = 0; i < 10; ++i) ASSERT_TRUE(Append(500).ok());
  outbox_->Release(10);
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(Append(500).ok());  // in memory
  for (uint64_t seq = 1; seq <= 13; ++seq) EXPECT_EQ(LetterOf(seq), static_cast<char>('a' + seq - 1));
  outbox_->Release(11);
  EXPECT_EQ(outbox_->durable().seq, 11u);
  for (int i = 0; i < 8; ++i) ASSERT_TRUE(Append(500).ok());  // in the spool, which begins again
  for (uint64_t seq = outbox_->FirstSeq().value(); seq <= 21; ++seq) {
    EXPECT_EQ(LetterOf(seq), static_cast<char>('a' + seq - 1));
  }
  outbox_->Release(21);
  clock.Advance(absl::Seconds(5));
  ASSERT_TRUE(Append(500).ok());
  outbox_->Release(22);
  EXPECT_EQ(outbox_->FirstSeq(), 22u);
}

TEST_F(OutboxTest, RetainedChunksGiveWayInAFullSpool) {
  OutboxOptions options;
  options.memory_bytes = 1;
  options.spool = SpoolThere(false);
  Open(options);
  for (int i = 0; i < 15; ++i) ASSERT_TRUE(Append(1 << 20).ok());
  outbox_->Release(1);
  EXPECT_EQ(outbox_->FirstSeq(), 1u);
  auto next = std::async(std::launch::async, [this] { return Append(3 << 20); });
  EXPECT_TRUE(Poll([this] { return outbox_->state().is_waiting; }));
  EXPECT_EQ(outbox_->FirstSeq(), 2u);
  EXPECT_EQ(outbox_->Get(1, stop_.get_token()).status().code(), absl::StatusCode::kDataLoss);
  outbox_->Release(3);
  EXPECT_TRUE(next.get().ok());
}

TEST_F(OutboxTest, OptionsAreChecked) {
  OutboxOptions options;
  options.memory_bytes = 0;
  EXPECT_THAT(Outbox::Open(options).status().message(), HasSubstr("memory_bytes"));
  options = {};
  options.retain.duration = absl::Seconds(-1);
  EXPECT_THAT(Outbox::Open(options).status().message(), HasSubstr("retain.duration"));
  options = {};
  options.spool = SpoolOptions();
  EXPECT_THAT(Outbox::Open(options).status().message(), HasSubstr("directory"));
}

// Chunks of 24 bytes, 1 ms apart; the last one is shorter.
ChunkSource Source(int count, int64_t seed = 0) {
  return [=, next = 0]() mutable -> absl::StatusOr<EventChunk> {
    if (next == count) return EventChunk{};
    EventChunk chunk;
    chunk.bytes.assign(next + 1 == count ? 8 : 24, static_cast<uint8_t>(seed + next));
    chunk.t_last_us = int64_t{1000} * next++;
    return chunk;
  };
}

std::vector<OutgoingChunk> ReadFeed(const FeedOptions& options, int count, uint64_t first_seq, absl::Status& status,
                                    int64_t seed = 0) {
  std::vector<OutgoingChunk> chunks;
  auto feed = EventFeed::Open(Source(count, seed), options);
  EXPECT_TRUE(feed.ok()) << feed.status();
  (*feed)->Start(20);
  for (uint64_t seq = first_seq;; ++seq) {
    const auto chunk = (*feed)->outbox().Get(seq, {});
    status = chunk.status();
    if (!chunk.ok() || *chunk == nullptr) return chunks;
    chunks.push_back(**chunk);
  }
}

TEST(EventFeedTest, ChunksAreWholeWordsAndNumbered) {
  absl::Status status;
  const auto chunks = ReadFeed({}, 3, 1, status);
  ASSERT_TRUE(status.ok()) << status;
  ASSERT_EQ(chunks.size(), 5u);
  uint64_t bytes = 0;
  for (size_t i = 0; i < chunks.size(); ++i) {
    EXPECT_EQ(chunks[i].end.seq, i + 1);
    EXPECT_EQ(chunks[i].payload.size(), i % 2 == 0 && i < 4 ? 16u : 8u);
    EXPECT_EQ(chunks[i].end.bytes, bytes += chunks[i].payload.size());
  }
}

TEST(EventFeedTest, ContinuesFromAnyPositionWithTheSameChunks) {
  absl::Status status;
  const auto all = ReadFeed({}, 10, 1, status);
  for (size_t skipped = 0; skipped <= all.size(); ++skipped) {
    FeedOptions options;
    if (skipped > 0) options.skip = all[skipped - 1].end;
    const auto rest = ReadFeed(options, 10, skipped + 1, status);
    ASSERT_TRUE(status.ok()) << status;
    ASSERT_EQ(rest.size(), all.size() - skipped);
    for (size_t i = 0; i < rest.size(); ++i) {
      EXPECT_EQ(rest[i].end, all[skipped + i].end);
      EXPECT_EQ(rest[i].payload, all[skipped + i].payload);
    }
  }
}

// A process that continues a session reads its chunks again: the last ones before the position are retained.
TEST(EventFeedTest, RetainsTheChunksBeforeThePosition) {
  absl::Status status;
  const auto all = ReadFeed({}, 10, 1, status);
  FeedOptions options;
  options.skip = all[11].end;
  options.outbox.retain.max_bytes = 60 + 5 * 128;
  EXPECT_TRUE(ReadFeed(options, 10, 7, status).empty());
  EXPECT_EQ(GetDetails(status).reason, "ROLLED_BACK");
  const auto rest = ReadFeed(options, 10, 8, status);  // 12 chunks have 144 bytes; the last five of them 56
  ASSERT_TRUE(status.ok()) << status;
  ASSERT_EQ(rest.size(), all.size() - 7);
  for (size_t i = 0; i < rest.size(); ++i) EXPECT_EQ(rest[i].payload, all[7 + i].payload);
}

TEST(EventFeedTest, EventsOfAnotherRecordingAreDetected) {
  absl::Status status;
  FeedOptions options;
  options.skip = ReadFeed({}, 10, 1, status)[7].end;
  EXPECT_TRUE(ReadFeed(options, 10, 9, status, 1).empty());
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(status.message(), HasSubstr("differ from those that the session was fed with"));
  EXPECT_TRUE(ReadFeed(options, 2, 9, status).empty());
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(status.message(), HasSubstr("the events end after 32 bytes"));
}

TEST(EventFeedTest, GapIsMarkedOnce) {
  absl::Status status;
  FeedOptions options;
  options.begins_after_gap = true;
  const auto chunks = ReadFeed(options, 2, 1, status);
  ASSERT_GE(chunks.size(), 2u);
  EXPECT_TRUE(chunks[0].discontinuity);
  EXPECT_FALSE(chunks[1].discontinuity);
}

// Source() with a reset before its third chunk.
ChunkSource SourceWithReset(int count, double z_m) {
  return [source = Source(count), z_m, next = 0]() mutable {
    absl::StatusOr<EventChunk> chunk = source();
    if (next++ != 2) return chunk;
    PoseReset& reset = chunk->resets.emplace_back();
    reset.camera_from_object.translation_m.z() = z_m;
    return chunk;
  };
}

TEST(EventFeedTest, ResetsArePartOfTheNumberingAndOfTheDigest) {
  const auto end_of = [](const FeedOptions& options, double z_m) -> absl::StatusOr<FeedPoint> {
    const auto feed = EventFeed::Open(SourceWithReset(5, z_m), options);
    (*feed)->Start(24);
    EVPOSE_RETURN_IF_ERROR((*feed)->outbox().Get(6, {}).status());
    return (*feed)->outbox().state().last;
  };
  const auto end = end_of({}, 1.0);
  ASSERT_TRUE(end.ok()) << end.status();
  EXPECT_EQ(end->seq, 6u);
  EXPECT_EQ(end->bytes, 4u * 24 + 8);
  FeedOptions options;
  EXPECT_NE(end_of({}, 2.0)->digest, end->digest);
  // A run that continues after the reset has the same numbers, or reports that the reset differs.
  const auto feed = EventFeed::Open(SourceWithReset(5, 1.0), {});
  (*feed)->Start(24);
  options.skip = (*(*feed)->outbox().Get(4, {}))->end;
  const auto continued = end_of(options, 1.0);
  ASSERT_TRUE(continued.ok()) << continued.status();
  EXPECT_EQ(*continued, *end);
  EXPECT_EQ(end_of(options, 2.0).status().code(), absl::StatusCode::kFailedPrecondition);
}

TEST(EventFeedTest, NoResetAfterTheEnd) {
  const auto feed = EventFeed::Open(Source(1), {});
  (*feed)->Start(24);
  ASSERT_TRUE((*feed)->outbox().Get(1, {}).ok());
  ASSERT_EQ(*(*feed)->outbox().Get(2, {}), nullptr);
  const absl::Status status = (*feed)->ResetPose({});
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(status.message(), HasSubstr("the events of the session have ended"));
}

TEST(EventFeedTest, ResetsThatWaitForTheSourceAreLimited) {
  const auto feed = EventFeed::Open(Source(1), {});
  absl::Status status;
  int num_resets = 0;
  for (; status.ok() && num_resets <= 1000; ++num_resets) status = (*feed)->ResetPose({});
  EXPECT_EQ(num_resets, 1001);
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(status.message(), HasSubstr("call ResetPose() less often"));
}

TEST(EventFeedTest, ReadsAheadUpToTheLimit) {
  int num_read = 0;
  const ChunkSource source = [&]() -> absl::StatusOr<EventChunk> {
    ++num_read;
    return EventChunk{std::vector<uint8_t>(16), 0};
  };
  FeedOptions options;
  options.read_ahead_bytes = 64;
  auto feed = EventFeed::Open(source, options);
  ASSERT_TRUE(feed.ok());
  (*feed)->Start(1000);
  for (uint64_t seq = 1; seq <= 10; ++seq) ASSERT_TRUE((*feed)->outbox().Get(seq, {}).ok());
  EXPECT_TRUE(Poll([&] { return (*feed)->outbox().state().last.bytes >= size_t{14} * 16; }));
  (*feed)->Stop();
  EXPECT_EQ(num_read, 14);
}

TEST(EventFeedTest, PacingStartsAfterTheSkippedChunks) {
  absl::Status status;
  FeedOptions options;
  options.skip = ReadFeed({}, 10, 1, status)[11].end;  // six chunks
  FakeClock clock;
  options.clock = &clock;
  options.rate = 1.0;
  const absl::Time begin = clock.Now();
  ReadFeed(options, 10, 13, status);
  EXPECT_EQ(clock.Now() - begin, absl::Milliseconds(3));
}

}  // namespace
}  // namespace evpose::client

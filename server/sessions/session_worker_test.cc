// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/session_worker.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <utility>

#include "server/sessions/session_testing.h"

namespace evpose::server {
namespace {

using std::chrono::microseconds;

class SessionWorkerTest : public testing::Test {
 protected:
  std::unique_ptr<SessionPipeline> MakePipeline() {
    return SessionPipeline::Create(config_, {nullptr, nullptr}, FakeTrackers()).value();
  }
  SessionWorker::Options MakeOptions() {
    return {[this] { return SteadyTime(microseconds(now_us_ += 10)); }, metrics_,
            std::make_shared<SessionLog>("sessions/a", "")};
  }
  SessionWorker MakeWorker(const SessionHealth& health = {}) {
    return SessionWorker(config_, MakeOptions(), MakePipeline(), health);
  }
  static WorkItem Chunk(uint64_t seq, const std::string& payload, bool discontinuity = false) {
    return {7, SteadyTime(), EventChunk{.seq = seq, .discontinuity = discontinuity, .payload = payload}};
  }
  static WorkItem Chunk(uint64_t seq, const std::vector<Event>& events) { return Chunk(seq, Flat64(events)); }

  int64_t now_us_ = 0;
  SessionConfig config_ = SomeConfig({"cube", "box"});
  const std::shared_ptr<ServerMetrics> metrics_ = std::make_shared<ServerMetrics>();
};

TEST_F(SessionWorkerTest, NumbersThePosesOfAChunk) {
  SessionWorker worker = MakeWorker();
  worker.Start(Chunk(3, SomeEvents(1, 4)));
  EXPECT_TRUE(worker.is_events());
  const WorkResult first = worker.Work({});
  ASSERT_EQ(first.poses.size(), 4u) << "two objects, two complete milliseconds";
  EXPECT_EQ(first.poses_before, 0u);
  EXPECT_EQ(first.poses.front().pose_seq, 1u);
  EXPECT_EQ(first.last_pose_seq(), 4u);
  EXPECT_EQ(first.poses.front().latency_us, now_us_) << "since the receipt, at 0";
  EXPECT_GT(first.processing_us, 0);
  EXPECT_LT(first.processing_us, now_us_);
  EXPECT_EQ(first.counts.cd_events, 9u);
  EXPECT_EQ(first.objects.size(), 2u);
  EXPECT_EQ(first.objects[1].explained_ratio, 0.75f);
  ASSERT_TRUE(first.finished.has_value());
  EXPECT_EQ(first.finished->stream, 7u);
  EXPECT_EQ(first.finished->seq, 3u);
  EXPECT_EQ(first.finished->bytes, 72u);
  EXPECT_FALSE(first.finished->is_end);
  EXPECT_FALSE(first.finished->fault.has_value());

  worker.Start(Chunk(4, SomeEvents(4, 6)));
  const WorkResult second = worker.Work({});
  EXPECT_EQ(second.poses_before, 4u);
  EXPECT_EQ(second.poses.front().pose_seq, 5u);
  EXPECT_GT(second.processing_us, first.processing_us) << "the sum";
}

TEST_F(SessionWorkerTest, WorksInSlices) {
  const std::string payload = Flat64(SomeEvents(1, 1001));  // 24,000 bytes
  SessionWorker sliced = MakeWorker();
  sliced.Start(Chunk(1, payload));
  const WorkResult first = sliced.Work({});
  EXPECT_FALSE(first.finished.has_value());
  const WorkResult second = sliced.Work({});
  ASSERT_TRUE(second.finished.has_value());
  EXPECT_EQ(second.finished->bytes, payload.size());
  EXPECT_EQ(second.poses_before, first.last_pose_seq());
  EXPECT_EQ(second.last_pose_seq(), 2u * 999u);
}

TEST_F(SessionWorkerTest, AnEmptyChunkIsFinishedAtOnce) {
  SessionWorker worker = MakeWorker();
  worker.Start(Chunk(1, "", true));
  const WorkResult result = worker.Work({});
  EXPECT_TRUE(result.finished.has_value());
  EXPECT_TRUE(result.poses.empty());
}

TEST_F(SessionWorkerTest, ResetsAndEnds) {
  config_.objects[0].initial_camera_from_object.reset();
  SessionWorker worker = MakeWorker();
  EXPECT_EQ(worker.Objects()[0].state, TrackState::kInitializing);
  worker.Start({7, SteadyTime(), PoseReset{.seq = 1, .object_index = 0}});
  EXPECT_FALSE(worker.is_events());
  EXPECT_EQ(worker.Work({.age_ratio = 9}).objects[0].state, TrackState::kTracking);
  worker.Start(Chunk(2, SomeEvents(1, 2)));
  EXPECT_TRUE(worker.Work({}).poses.empty()) << "the window is open";
  worker.Start({7, SteadyTime(), EndOfInput{}});
  const WorkResult end = worker.Work({});
  EXPECT_EQ(end.poses.size(), 2u);
  ASSERT_TRUE(end.finished.has_value());
  EXPECT_TRUE(end.finished->is_end);
  EXPECT_TRUE(worker.has_pipeline());
  worker.ReleasePipeline();
  EXPECT_FALSE(worker.has_pipeline());
  EXPECT_TRUE(worker.Objects().empty());
}

TEST_F(SessionWorkerTest, ReportsDecodeFaultsOfAnItem) {
  SessionWorker worker = MakeWorker();
  worker.Start(Chunk(1, std::vector<Event>{{1000, 319, 1, 1}, {1001, 320, 1, 1}, {1002, 1, 240, 1}}));
  const WorkResult faulty = worker.Work({});
  ASSERT_TRUE(faulty.finished->fault.has_value());
  EXPECT_EQ(faulty.finished->fault->seq, 1u);
  EXPECT_EQ(faulty.finished->fault->count, 2u);
  EXPECT_EQ(faulty.finished->fault->detail, "skipped 0 unknown words, 0 broken vectors, 2 events outside the sensor");
  worker.Start(Chunk(2, SomeEvents(2, 3)));
  EXPECT_FALSE(worker.Work({}).finished->fault.has_value()) << "earlier faults do not count again";
}

// EVT2 words: a time, then triggers in the lower 6 bits of time.
std::string TriggerWords(int count) {
  std::string words;
  const auto append = [&words](uint32_t word) {
    for (int byte = 0; byte < 4; ++byte) words.push_back(static_cast<char>(word >> (8 * byte)));
  };
  append(0x8u << 28 | 100);  // 6400 us
  for (int i = 0; i < count; ++i) append(0xAu << 28 | 5u << 22 | 3u << 8 | static_cast<uint32_t>(i % 2));
  return words;
}

TEST_F(SessionWorkerTest, PassesOnTheTriggersOfAnItemUpToALimit) {
  config_.encoding = Encoding::kEvt2;
  SessionWorker worker = MakeWorker();
  worker.Start(Chunk(4, TriggerWords(2)));
  const WorkResult result = worker.Work({});
  ASSERT_TRUE(result.finished->triggers.has_value());
  EXPECT_EQ(result.finished->triggers->seq, 4u);
  EXPECT_EQ(result.finished->triggers->triggers, (std::vector<Trigger>{{6405, 3, 0}, {6405, 3, 1}}));
  EXPECT_EQ(result.finished->triggers->num_skipped, 0u);
  EXPECT_TRUE(result.poses.empty());

  worker.Start(Chunk(5, TriggerWords(1000)));
  std::optional<ChunkTriggers> triggers;
  while (!triggers) {
    const WorkResult slice = worker.Work({});
    if (slice.finished) triggers = slice.finished->triggers;
    ASSERT_TRUE(!slice.finished || triggers) << "the triggers come with the last slice";
  }
  EXPECT_EQ(triggers->triggers.size(), kMaxTriggersOfChunk);
  EXPECT_EQ(triggers->num_skipped, 1000 - kMaxTriggersOfChunk);

  worker.Start(Chunk(6, TriggerWords(0)));
  EXPECT_FALSE(worker.Work({}).finished->triggers.has_value());
}

TEST_F(SessionWorkerTest, DropsEventsWhileTheBacklogIsTooLarge) {
  config_.overload_policy = OverloadPolicy::kLatest;
  config_.max_lag = absl::Milliseconds(10);
  SessionWorker worker = MakeWorker();
  worker.Start(Chunk(1, SomeEvents(1, 3)));
  const WorkResult dropped = worker.Work({.bytes_ratio = 1.1});
  EXPECT_EQ(dropped.dropped_now.num_events, 6u);
  EXPECT_TRUE(dropped.poses.empty());
  EXPECT_FALSE(dropped.gap.has_value()) << "it is still open";
  EXPECT_EQ(metrics_->skipped_events[DropReason::kMemory].value(), 6u);
  worker.Start(Chunk(2, SomeEvents(3, 5)));
  const WorkResult tracked = worker.Work({.bytes_ratio = 0.4});
  EXPECT_EQ(tracked.dropped_now.num_events, 0u);
  ASSERT_TRUE(tracked.gap.has_value());
  EXPECT_EQ(tracked.gap->num_events, 6u);
  EXPECT_EQ(tracked.gap->reason, DropReason::kMemory);
  worker.Start(Chunk(3, SomeEvents(5, 6)));
  EXPECT_FALSE(worker.Work({}).gap.has_value()) << "reported once";
}

TEST_F(SessionWorkerTest, AnEndClosesTheGap) {
  config_.overload_policy = OverloadPolicy::kLatest;
  config_.max_lag = absl::Milliseconds(10);
  SessionWorker worker = MakeWorker();
  worker.Start(Chunk(1, SomeEvents(1, 3)));
  worker.Work({.age_ratio = 2.0});
  worker.Start({7, SteadyTime(), EndOfInput{}});
  EXPECT_EQ(worker.Work({.age_ratio = 2.0}).gap->num_events, 6u);
}

TEST_F(SessionWorkerTest, CountsLossesAndReinitializations) {
  SessionWorker worker = MakeWorker();
  worker.Start(Chunk(1, std::vector<Event>{{4000, 0, 0, 1}, {5000, 3, 4, 1}, {6000, 3, 4, 1}}));
  const WorkResult lost = worker.Work({});
  ASSERT_EQ(lost.state_changes.size(), 2u);
  EXPECT_EQ(lost.state_changes[0].state, TrackState::kLost);
  EXPECT_EQ(lost.objects[0].losses, 1u);
  EXPECT_EQ(metrics_->object_transitions[ObjectPhase::kPublished][ObjectPhase::kSearching].value(), 2u);
  EXPECT_EQ(metrics_->reinitializations.value(), 0u);
  worker.Start({7, SteadyTime(), PoseReset{.seq = 2, .object_index = 1}});
  worker.Work({});
  worker.Start(Chunk(3, std::vector<Event>{{7000, 3, 4, 1}, {8000, 3, 4, 1}}));
  worker.Work({});
  EXPECT_EQ(metrics_->reinitializations.value(), 1u);
}

TEST_F(SessionWorkerTest, ContinuesFromACheckpoint) {
  SessionHealth health = {.poses = 40, .processing_us = 500};
  health.objects = {{.losses = 3, .explained_ratio = 0.5f}, {.losses = 4, .explained_ratio = 0.25f}};
  SessionWorker worker = MakeWorker(health);
  EXPECT_EQ(worker.Objects()[0].losses, 3u) << "the new tracker has lost nothing yet";
  EXPECT_EQ(worker.Objects()[1].explained_ratio, 0.25f);
  worker.Start(Chunk(9, SomeEvents(1, 3)));
  const WorkResult result = worker.Work({});
  EXPECT_EQ(result.poses.front().pose_seq, 41u);
  EXPECT_GT(result.processing_us, 500);
}

}  // namespace
}  // namespace evpose::server

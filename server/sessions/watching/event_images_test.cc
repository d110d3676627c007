// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/watching/event_images.h"

#include <gtest/gtest.h>
#include <zlib.h>

#include <atomic>
#include <semaphore>
#include <string>
#include <vector>

#include "core/base/yields_testing.h"
#include "server/runtime/failing_allocations_testing.h"

namespace evpose::server {
namespace {

constexpr int64_t kFrameUs = 40'000;            // of 25 Hz
constexpr size_t kLargeAllocationBytes = 1000;  // smaller than the bitmap of SmallSession() with cells of one pixel

// Its only object has a pose and one edge, from x = -0.1 m to `now_us` micrometres.
class OutlineTracker : public Tracker {
 public:
  void AddEvents(absl::Span<const Event>, std::vector<PoseEstimate>&) override {}
  void AdvanceTime(int64_t, std::vector<PoseEstimate>&) override {}
  EventGap Skip(absl::Span<const Event>, int64_t) override { return {}; }
  void Finish(std::vector<PoseEstimate>&) override {}
  void ResetPose(size_t, const RigidTransform&) override {}
  size_t num_objects() const override { return 1; }
  TrackState state(size_t) const override { return TrackState::kTracking; }
  InitializationReport initialization(size_t) const override { return {}; }
  uint32_t losses(size_t) const override { return 0; }
  void SaveState(StateWriter&) const override {}
  void LoadState(StateReader&) override {}
  bool Outline(size_t, ObjectOutline& outline) const override {
    if (!has_pose) return false;
    outline.state = TrackState::kTracking;
    outline.t_us = now_us;
    outline.camera_from_object.translation_m = {0, 0, 1};
    outline.edges = {{{-0.1, 0, 0}, {1e-6 * static_cast<double>(now_us), 0, 0}, {0, 0, 0}, EdgeKind::kContour}};
    return true;
  }

  bool has_pose = true;
  int64_t now_us = 0;
};

class CountingListener : public SessionListener {
 public:
  void OnSessionChanged() override { calls.release(); }
  std::counting_semaphore<> calls{0};
};

SessionConfig SmallSession() {
  SessionConfig config;
  config.camera = {101, 53, 100.0, 100.0, 50.0, 26.0};
  config.objects.resize(1);
  return config;
}

class EventImagesTest : public testing::Test {
 protected:
  // Adds an event at this pixel, at the sensor time of the clock, after `us`.
  void AddAfter(int64_t us, uint16_t x, uint16_t y = 0, uint8_t polarity = 1) {
    const int64_t from_us = tracker_.now_us;
    Advance(us);
    const Event event = {tracker_.now_us, x, y, polarity};
    images_->Add({&event, 1}, from_us, tracker_.now_us, tracker_);
  }
  // Wall clock and sensor time.
  void Advance(int64_t us) {
    tracker_.now_us += us;
    clock_us_ += us;
  }
  static int CellOf(const EventBitmap& bitmap, int x, int y) {
    const int number = y * bitmap.width() + x;
    return (bitmap.bytes()[number / 4] >> (number % 4 * 2)) & 3;
  }

  OutlineTracker tracker_;
  // Read by the timer, too.
  std::atomic<int64_t> clock_us_ = 1'000'000;
  const std::shared_ptr<CountingListener> listener_ = std::make_shared<CountingListener>();
  const std::shared_ptr<ServerMetrics> metrics_ = std::make_shared<ServerMetrics>();
  WorkerPool pool_{1};
  const std::shared_ptr<EventImages> images_ = std::make_shared<EventImages>(
      SmallSession(), "", [this] { return EventImages::Time(std::chrono::microseconds(clock_us_.load())); }, pool_,
      metrics_);
};

TEST_F(EventImagesTest, IsWatchedWhileItHasReaders) {
  EXPECT_FALSE(images_->is_watched());
  {
    const auto reader = images_->Open(2, 25.0, listener_);
    EXPECT_TRUE(images_->is_watched());
    EXPECT_EQ(images_->num_readers(), 1u);
    EXPECT_FALSE(reader->Take().has_value()) << "there are no events yet";
  }
  EXPECT_FALSE(images_->is_watched());
  AddAfter(1000, 5);  // as a session does that has asked just before the last reader left
  const auto reader = images_->Open(2, 25.0, listener_);
  EXPECT_FALSE(reader->Take().has_value()) << "events before a reader came are not shown";
}

TEST_F(EventImagesTest, AnImageHasTheEventsSinceTheOneBefore) {
  const auto reader = images_->Open(2, 25.0, listener_);
  AddAfter(1000, 7, 3);
  const auto first = reader->Take();
  ASSERT_TRUE(first.has_value());
  EXPECT_EQ(first->image->from_t_us(), 0);
  EXPECT_EQ(first->image->to_t_us(), 1000);
  EXPECT_EQ(first->image->num_events(), 1u);
  EXPECT_EQ(first->image->bitmap().width(), 51);
  EXPECT_EQ(first->image->bitmap().height(), 27);
  EXPECT_EQ(CellOf(first->image->bitmap(), 3, 1), 1);

  AddAfter(10'000, 20, 4, 0);
  AddAfter(10'000, 21, 5, 1);
  EXPECT_FALSE(reader->Take().has_value()) << "the next one is not due";
  AddAfter(kFrameUs - 20'000, 60, 10, 0);
  const auto second = reader->Take();
  ASSERT_TRUE(second.has_value());
  EXPECT_EQ(second->image->from_t_us(), 1000);
  EXPECT_EQ(second->image->to_t_us(), 1000 + kFrameUs);
  EXPECT_EQ(second->image->num_events(), 3u);
  EXPECT_EQ(CellOf(second->image->bitmap(), 3, 1), 0) << "the event of the image before";
  EXPECT_EQ(CellOf(second->image->bitmap(), 10, 2), 3);
  EXPECT_EQ(CellOf(second->image->bitmap(), 30, 5), 2);
  EXPECT_EQ(second->num_skipped, 0u);
  EXPECT_EQ(metrics_->event_images.value(), 2u);
}

// A slice of a session may have 400,000 events.
TEST_F(EventImagesTest, ManyEventsAreAddedInPiecesBetweenYieldPoints) {
  std::vector<Event> events;
  for (int i = 0; i < 100'000; ++i) events.push_back({i, static_cast<uint16_t>(i % 101), 7, 1});
  const auto add = [&] { images_->Add(events, 0, 100'000, tracker_); };
  EXPECT_EQ(CountYields(add), 24u);
  const auto reader = images_->Open(1, 25.0, listener_);
  add();
  const auto taken = reader->Take();
  ASSERT_TRUE(taken.has_value());
  EXPECT_EQ(taken->image->num_events(), events.size());
  EXPECT_EQ(taken->image->from_t_us(), 0);
  EXPECT_EQ(taken->image->to_t_us(), 100'000);
  for (int x = 0; x < 101; ++x) EXPECT_EQ(CellOf(taken->image->bitmap(), x, 7), 1) << x;
}

TEST_F(EventImagesTest, ASlowReaderReceivesTheEventsOfAllImagesThatItMissed) {
  const auto slow = images_->Open(1, 25.0, listener_);
  const auto quick = images_->Open(1, 25.0, listener_);
  for (uint16_t i = 1; i <= 5; ++i) {
    AddAfter(kFrameUs, i);
    EXPECT_EQ(quick->Take()->image->num_events(), 1u);
  }
  const auto taken = slow->Take();
  ASSERT_TRUE(taken.has_value());
  EXPECT_EQ(taken->num_skipped, 4u);
  EXPECT_EQ(taken->image->from_t_us(), 0);
  EXPECT_EQ(taken->image->to_t_us(), 5 * kFrameUs);
  EXPECT_EQ(taken->image->num_events(), 5u);
  for (int i = 1; i <= 5; ++i) EXPECT_EQ(CellOf(taken->image->bitmap(), i, 0), 1);
  ASSERT_EQ(taken->image->outlines().size(), 1u);
  EXPECT_EQ(taken->image->outlines()[0].object.t_us, 5 * kFrameUs) << "the newest pose";
  EXPECT_EQ(metrics_->skipped_event_images.value(), 4u);
  AddAfter(kFrameUs, 9);
  EXPECT_EQ(slow->Take()->image->num_events(), 1u);
  EXPECT_EQ(slow->Take().has_value(), false);
}

TEST_F(EventImagesTest, ReadersOfTheSameCellsShareAnImage) {
  const auto a = images_->Open(2, 25.0, listener_);
  AddAfter(1000, 1);
  ASSERT_TRUE(a->Take().has_value());
  AddAfter(7000, 2);
  const auto b = images_->Open(2, 25.0, listener_);
  const auto other_cells = images_->Open(4, 25.0, listener_);
  for (uint16_t i = 0; i < 5; ++i) {
    AddAfter(kFrameUs, i);
    const auto of_a = a->Take(), of_b = b->Take(), of_other = other_cells->Take();
    ASSERT_TRUE(of_a && of_b && of_other);
    EXPECT_EQ(of_a->image, of_b->image);
    EXPECT_EQ(of_other->image->bitmap().cell_px(), 4);
    EXPECT_EQ(&of_a->image->outlines(), &of_other->image->outlines());
  }
}

TEST_F(EventImagesTest, NoReaderReceivesMoreThanItsRate) {
  const auto quick = images_->Open(2, 60.0, listener_);
  const auto usual = images_->Open(2, 30.0, listener_);
  const auto seldom = images_->Open(2, 7.0, listener_);
  std::vector<uint64_t> counts(3), events(3);
  const auto take = [&](size_t i, EventImages::Reader& reader) {
    const auto taken = reader.Take();
    if (!taken) return;
    ++counts[i];
    events[i] += taken->image->num_events();
    EXPECT_EQ(taken->num_skipped, 0u);
  };
  for (int i = 0; i < 10'000; ++i) {  // 10 s
    AddAfter(1000, 1);
    take(0, *quick);
    take(1, *usual);
    take(2, *seldom);
  }
  EXPECT_NEAR(static_cast<double>(counts[0]), 600.0, 6.0);
  EXPECT_NEAR(static_cast<double>(counts[1]), 300.0, 3.0);
  EXPECT_NEAR(static_cast<double>(counts[2]), 70.0, 1.0);
  for (const uint64_t count : events) EXPECT_GT(count, 9800u) << "all but those that still wait";
}

TEST_F(EventImagesTest, AQuickReaderDoesNotWaitForASlowOne) {
  const auto slow = images_->Open(2, 0.001, listener_);
  AddAfter(1000, 1);
  ASSERT_TRUE(slow->Take().has_value());
  const auto quick = images_->Open(2, 25.0, listener_);
  AddAfter(kFrameUs, 2);
  ASSERT_TRUE(quick->Take().has_value());
  EXPECT_FALSE(slow->Take().has_value());
}

// What waits for the slow reader's image, when the events have stopped.
TEST_F(EventImagesTest, AQuickReaderDoesNotWaitForTheTimerOfASlowOne) {
  const auto slow = images_->Open(2, 0.001, listener_);
  AddAfter(1000, 1);
  ASSERT_TRUE(slow->Take().has_value());
  AddAfter(1000, 2);  // sets the timer
  const auto quick = images_->Open(2, 25.0, listener_);
  clock_us_ += 2 * kFrameUs;
  std::optional<EventImages::Reader::Taken> taken;
  while (!taken) {
    listener_->calls.acquire();
    taken = quick->Take();
  }
  EXPECT_EQ(taken->image->num_events(), 1u);
}

TEST_F(EventImagesTest, ARateMayBeArbitrarilySmall) {
  const auto reader = images_->Open(2, 1e-300, listener_);
  AddAfter(1000, 1);
  ASSERT_TRUE(reader->Take().has_value());
  AddAfter(3'600'000'000, 2);
  EXPECT_FALSE(reader->Take().has_value());
  images_->Finish();
  EXPECT_EQ(reader->Take()->image->num_events(), 1u);
}

TEST_F(EventImagesTest, ManyReadersShareTheRateOfTheSession) {
  std::vector<std::unique_ptr<EventImages::Reader>> readers;
  for (int i = 0; i < 96; ++i) readers.push_back(images_->Open(4, 60.0, listener_));
  uint64_t count = 0;
  for (int i = 0; i < 1000; ++i) {  // 1 s
    AddAfter(1000, 1);
    for (const auto& reader : readers) count += reader->Take().has_value();
  }
  EXPECT_GE(count, 960u);
  EXPECT_LE(count, 960u + 2 * 96u);
}

TEST_F(EventImagesTest, TheEndMakesEverythingDue) {
  const auto usual = images_->Open(2, 25.0, listener_);
  const auto seldom = images_->Open(2, 1.0, listener_);
  AddAfter(1000, 1);
  ASSERT_TRUE(usual->Take().has_value());
  ASSERT_TRUE(seldom->Take().has_value());
  AddAfter(kFrameUs, 2);
  ASSERT_TRUE(usual->Take().has_value());
  EXPECT_FALSE(seldom->Take().has_value());
  AddAfter(1000, 3);
  images_->Finish();
  EXPECT_EQ(usual->Take()->image->num_events(), 1u);
  EXPECT_EQ(seldom->Take()->image->num_events(), 2u);
  EXPECT_FALSE(usual->Take().has_value());
}

// What waits when the events stop becomes an image by the clock.
TEST_F(EventImagesTest, EventsBeforeAPauseAreShown) {
  const auto reader = images_->Open(2, 25.0, listener_);
  AddAfter(1000, 1);
  ASSERT_TRUE(reader->Take().has_value());
  AddAfter(1000, 2);
  clock_us_ += 2 * kFrameUs;
  std::optional<EventImages::Reader::Taken> taken;
  while (!taken) {
    listener_->calls.acquire();
    taken = reader->Take();
  }
  EXPECT_EQ(taken->image->num_events(), 1u);
}

TEST_F(EventImagesTest, OutlinesAreProjectedAtTheNewestPose) {
  const auto reader = images_->Open(2, 25.0, listener_);
  Advance(100'000);
  AddAfter(0, 1);
  const auto taken = reader->Take();
  ASSERT_TRUE(taken.has_value());
  ASSERT_EQ(taken->image->outlines().size(), 1u);
  const SessionOutlines::Outline& outline = taken->image->outlines()[0];
  EXPECT_EQ(outline.object_index, 0u);
  EXPECT_EQ(outline.object.t_us, 100'000);
  ASSERT_EQ(outline.segments.size(), 1u);
  EXPECT_EQ(outline.segments[0].kind, EdgeKind::kContour);
  EXPECT_NEAR(outline.segments[0].p1_px.x(), 40.0, 1e-4);
  EXPECT_NEAR(outline.segments[0].p2_px.x(), 60.0, 1e-4);
  EXPECT_EQ(outline.object.edges.capacity(), 0u) << "they are released";
  tracker_.has_pose = false;
  AddAfter(kFrameUs, 1);
  EXPECT_TRUE(reader->Take()->image->outlines().empty());
}

// Turns and the timer wait for no image, however many readers there are.
TEST_F(EventImagesTest, TurnsMakeAndJoinNoImages) {
  std::vector<std::unique_ptr<EventImages::Reader>> readers;
  for (int i = 0; i < 10; ++i) readers.push_back(images_->Open(1, 25.0, listener_));
  AddAfter(1000, 1);
  ASSERT_TRUE(readers[0]->Take().has_value());
  ThisThreadsFailingAllocation() = {0, kLargeAllocationBytes};
  for (int i = 0; i < 3; ++i) AddAfter(kFrameUs, 2);
  images_->Finish();
  EXPECT_EQ(ThisThreadsFailingAllocation().successes_before, 0) << "no large allocation was made";
  ThisThreadsFailingAllocation() = {};
  EXPECT_EQ(readers[0]->Take()->image->num_events(), 3u);
  EXPECT_EQ(readers[1]->Take()->image->num_events(), 4u);
}

TEST_F(EventImagesTest, ImagesThatManyReadersHaveNotTakenAreJoinedOnce) {
  constexpr int kMany = 1000;
  std::vector<std::unique_ptr<EventImages::Reader>> stalled;
  for (int i = 0; i < 50; ++i) stalled.push_back(images_->Open(1, 25.0, listener_));
  const auto quick = images_->Open(1, 25.0, listener_);
  for (uint16_t i = 1; i <= 10; ++i) {
    AddAfter(3 * kFrameUs, i);  // 51 readers share 960 images per second
    ThisThreadsFailingAllocation() = {kMany, kLargeAllocationBytes};
    ASSERT_TRUE(quick->Take().has_value());
    EXPECT_LE(kMany - ThisThreadsFailingAllocation().successes_before, 2) << "the image, and the joined image";
    ThisThreadsFailingAllocation() = {};
  }
  const auto first = stalled[0]->Take(), second = stalled[1]->Take();
  ASSERT_TRUE(first && second);
  EXPECT_EQ(first->image, second->image);
  EXPECT_EQ(first->image->num_events(), 10u);
  EXPECT_EQ(first->num_skipped, 9u);
  for (int i = 1; i <= 10; ++i) EXPECT_EQ(CellOf(first->image->bitmap(), i, 0), 1);
}

TEST_F(EventImagesTest, ReadersGoOnWhereTheyWere) {
  std::vector<std::unique_ptr<EventImages::Reader>> readers;
  std::vector<uint64_t> counts(5, 0);
  for (int i = 0; i < 5; ++i) readers.push_back(images_->Open(1, 25.0, listener_));
  for (int i = 1; i <= 60; ++i) {
    AddAfter(kFrameUs, 1);
    for (size_t j = 0; j < readers.size(); ++j) {
      if (i % static_cast<int>(j + 1) != 0) continue;
      const auto taken = readers[j]->Take();
      ASSERT_TRUE(taken.has_value());
      EXPECT_EQ(taken->image->num_events(), j + 1);
      EXPECT_EQ(taken->image->to_t_us(), i * kFrameUs);
      counts[j] += taken->image->num_events();
    }
    if (i == 30) readers.push_back(images_->Open(1, 25.0, listener_));
    if (i == 31) readers.pop_back();  // without having taken anything
  }
  EXPECT_EQ(counts, std::vector<uint64_t>(5, 60));
}

TEST_F(EventImagesTest, WithoutMemoryForAnImageTheNextOneHasItsEvents) {
  const auto reader = images_->Open(1, 25.0, listener_);
  AddAfter(1000, 1);
  ASSERT_TRUE(reader->Take().has_value());
  AddAfter(kFrameUs, 2);
  ThisThreadsFailingAllocation() = {0, kLargeAllocationBytes};
  EXPECT_FALSE(reader->Take().has_value());
  EXPECT_EQ(ThisThreadsFailingAllocation().successes_before, -1) << "an allocation failed";
  AddAfter(kFrameUs, 3);
  const auto taken = reader->Take();
  ASSERT_TRUE(taken.has_value());
  EXPECT_TRUE(reader->status().ok());
  EXPECT_EQ(taken->image->from_t_us(), 1000);
  EXPECT_EQ(taken->image->num_events(), 2u);
  for (const int x : {2, 3}) EXPECT_EQ(CellOf(taken->image->bitmap(), x, 0), 1);
}

TEST_F(EventImagesTest, WithoutMemoryForAJoinedImageNoEventIsMissing) {
  const auto slow = images_->Open(1, 25.0, listener_);
  const auto quick = images_->Open(1, 25.0, listener_);
  AddAfter(1000, 1);
  ASSERT_TRUE(quick->Take().has_value());
  AddAfter(kFrameUs, 2);
  ThisThreadsFailingAllocation() = {1, kLargeAllocationBytes};  // the first one is the image
  EXPECT_EQ(quick->Take()->image->num_events(), 1u);
  EXPECT_EQ(ThisThreadsFailingAllocation().successes_before, -1);
  ThisThreadsFailingAllocation() = {0, kLargeAllocationBytes};
  EXPECT_FALSE(slow->Take().has_value());
  EXPECT_EQ(ThisThreadsFailingAllocation().successes_before, -1);
  EXPECT_TRUE(slow->status().ok() && quick->status().ok());
  AddAfter(kFrameUs, 3);
  EXPECT_EQ(quick->Take()->image->num_events(), 1u);
  EXPECT_EQ(slow->Take()->image->num_events(), 3u);
}

TEST_F(EventImagesTest, WithoutMemoryForTheLastImageItsReadersFail) {
  const auto reader = images_->Open(1, 25.0, listener_);
  const auto of_other_cells = images_->Open(2, 25.0, listener_);
  AddAfter(1000, 1);
  ASSERT_TRUE(reader->Take() && of_other_cells->Take());
  AddAfter(1000, 2);
  images_->Finish();
  ThisThreadsFailingAllocation() = {0, kLargeAllocationBytes};
  EXPECT_FALSE(reader->Take().has_value());
  EXPECT_EQ(ThisThreadsFailingAllocation().successes_before, -1);
  EXPECT_FALSE(reader->status().ok());
  EXPECT_TRUE(of_other_cells->status().ok());
  EXPECT_EQ(of_other_cells->Take()->image->num_events(), 1u);
}

TEST_F(EventImagesTest, CellsAreCompressedWhereThatMakesThemSmaller) {
  const auto reader = images_->Open(1, 25.0, listener_);
  AddAfter(1000, 17, 30);
  const auto sparse = reader->Take();
  const EncodedCells& cells = sparse->image->cells();
  ASSERT_TRUE(cells.is_zlib);
  EXPECT_LT(cells.zlib.size(), 100u);
  const absl::Span<const uint8_t> bytes = sparse->image->bitmap().bytes();
  std::string unpacked(bytes.size() + 1, '\0');
  uLongf size = unpacked.size();
  ASSERT_EQ(uncompress(reinterpret_cast<Bytef*>(unpacked.data()), &size,
                       reinterpret_cast<const Bytef*>(cells.zlib.data()), cells.zlib.size()),
            Z_OK);
  EXPECT_EQ(size, bytes.size());
  EXPECT_TRUE(std::equal(bytes.begin(), bytes.end(), reinterpret_cast<const uint8_t*>(unpacked.data())));

  std::vector<Event> noise;
  uint32_t random = 1;
  for (int i = 0; i < 20'000; ++i) {
    random = random * 1664525u + 1013904223u;
    noise.push_back({tracker_.now_us, static_cast<uint16_t>((random >> 8) % 101),
                     static_cast<uint16_t>((random >> 16) % 53), static_cast<uint8_t>(random >> 31)});
  }
  Advance(kFrameUs);
  images_->Add(noise, tracker_.now_us - kFrameUs, tracker_.now_us, tracker_);
  EXPECT_FALSE(reader->Take()->image->cells().is_zlib);
}

}  // namespace
}  // namespace evpose::server

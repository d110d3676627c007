// SPDX-License-Identifier: Apache-2.0
#include "client/view/recorded_events.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <condition_variable>
#include <deque>
#include <string>
#include <vector>

#include "client/containers/open_recording.h"
#include "client/view/recordings_testing.h"
#include "core/base/temporary_directory_testing.h"
#include "core/recordings/event_reader.h"

namespace evpose::client {
namespace {

// Waits until the recording has been read.
void WaitUntilComplete(RecordedEvents& events) {
  std::mutex mutex;
  std::condition_variable changed;
  const std::shared_ptr<void> subscription = events.Subscribe([&] {
    const std::lock_guard lock(mutex);
    changed.notify_all();
  });
  std::unique_lock lock(mutex);
  changed.wait(lock, [&] { return events.progress().is_complete; });
}

std::vector<Event> EventsOf(const RecordedEvents& events, int64_t from_us, int64_t to_us) {
  std::vector<Event> all;
  const absl::Status status = events.Visit(
      from_us, to_us, [&](absl::Span<const Event> some) { all.insert(all.end(), some.begin(), some.end()); });
  EXPECT_TRUE(status.ok()) << status;
  return all;
}

std::vector<Event> Within(const std::vector<Event>& events, int64_t from_us, int64_t to_us) {
  std::vector<Event> some;
  for (const Event& event : events) {
    if (event.t_us >= from_us && event.t_us < to_us) some.push_back(event);
  }
  return some;
}

// Bytes in pieces, some of which follow a loss.
class PiecesReader : public RecordingReader {
 public:
  struct Piece {
    std::vector<uint8_t> bytes;
    bool follows_loss = false;
  };
  PiecesReader(std::deque<Piece> pieces, absl::Status end = absl::OkStatus())
      : pieces_(std::move(pieces)), end_(std::move(end)) {
    header_.encoding = Encoding::kEvt3;
    header_.geometry = kTestSensor;
    header_.container = "pieces";
  }
  const RecordingHeader& header() const override { return header_; }
  int64_t data_size_bytes() const override { return -1; }
  bool follows_loss() const override { return follows_loss_; }
  absl::StatusOr<size_t> Read(absl::Span<uint8_t> buffer) override {
    if (pieces_.empty()) return end_.ok() ? absl::StatusOr<size_t>(0) : end_;
    const Piece piece = std::move(pieces_.front());
    pieces_.pop_front();
    follows_loss_ = piece.follows_loss;
    std::copy(piece.bytes.begin(), piece.bytes.end(), buffer.begin());
    return piece.bytes.size();
  }

 private:
  RecordingHeader header_;
  std::deque<Piece> pieces_;
  const absl::Status end_;
  bool follows_loss_ = false;
};

class RecordedEventsTest : public ::testing::TestWithParam<const char*> {
 protected:
  const TemporaryDirectory directory_;
};

TEST_P(RecordedEventsTest, EachWindowHasExactlyItsEvents) {
  const std::vector<Event> written = RandomEvents(300'000, 16'000'000, 16'400'000, 1);
  const std::string path = directory_.File(GetParam());
  WriteRecording(path, written);
  auto reader = OpenRecording(path, {.geometry = kTestSensor});
  ASSERT_TRUE(reader.ok()) << reader.status();
  // The file is read in pieces of 64 KiB. A position is stored at each piece, and half of the positions are removed
  // several times.
  auto events = RecordedEvents::Open(path, std::move(*reader), {.spacing_bytes = 1, .max_positions = 4});
  ASSERT_TRUE(events.ok()) << events.status();
  WaitUntilComplete(**events);
  EXPECT_EQ((*events)->progress().range, (TimeSpan{written.front().t_us, written.back().t_us}));
  EXPECT_TRUE((*events)->progress().status.ok());
  for (const int64_t from_us : {15'999'000, 16'000'000, 16'000'001, 16'100'000, 16'273'123, 16'399'990, 16'500'000}) {
    for (const int64_t duration_us : {1, 50, 5'000, 150'000}) {
      const std::vector<Event> found = EventsOf(**events, from_us, from_us + duration_us);
      EXPECT_EQ(found, Within(written, from_us, from_us + duration_us)) << from_us << " " << duration_us;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Formats, RecordedEventsTest, ::testing::Values("events.raw", "events.dat", "events.csv"));

TEST(RecordedEventsLossTest, EventsBehindALossAreThoseOfTheReader) {
  const std::vector<Event> first = RandomEvents(20'000, 1'000'000, 1'050'000, 2);
  const std::vector<Event> second = RandomEvents(20'000, 1'050'000, 1'100'000, 3);
  const auto pieces = [&] {
    std::deque<PiecesReader::Piece> cut;
    for (const auto& [part, follows_loss] : {std::pair(&first, false), {&second, true}}) {
      std::vector<uint8_t> bytes = Encoded(*part);
      bytes.resize(bytes.size() - 3);  // within a word and a time
      for (size_t at = 0; at < bytes.size(); at += 4999) {
        const size_t end = std::min(bytes.size(), at + 4999);
        cut.push_back(
            {{bytes.begin() + static_cast<long>(at), bytes.begin() + static_cast<long>(end)}, follows_loss && at == 0});
      }
    }
    return cut;
  };
  std::vector<Event> expected;
  PiecesReader reader(pieces());
  auto decoder = MakeEventDecoder(Encoding::kEvt3, kTestSensor);
  DecodedEvents decoded;
  for (const PiecesReader::Piece& piece : pieces()) {
    if (piece.follows_loss) (*decoder)->ResetAfterLoss();
    (*decoder)->Decode(piece.bytes, decoded);
  }
  expected.assign(decoded.events.begin(), decoded.events.end());
  auto events = RecordedEvents::Open("pieces", std::make_unique<PiecesReader>(pieces()), {.spacing_bytes = 20'000});
  ASSERT_TRUE(events.ok()) << events.status();
  WaitUntilComplete(**events);
  EXPECT_EQ(EventsOf(**events, 0, 2'000'000), expected);
  EXPECT_EQ(EventsOf(**events, 1'049'000, 1'052'000), Within(expected, 1'049'000, 1'052'000));
  EXPECT_EQ(EventsOf(**events, 1'080'000, 1'081'000), Within(expected, 1'080'000, 1'081'000));
}

TEST(RecordedEventsErrorTest, WhatWasReadBeforeAnErrorStays) {
  const std::vector<Event> written = RandomEvents(1'000, 5'000, 6'000, 4);
  auto events = RecordedEvents::Open(
      "pieces", std::make_unique<PiecesReader>(std::deque<PiecesReader::Piece>{{Encoded(written)}},
                                               absl::UnavailableError("pieces: the disk is gone")));
  ASSERT_TRUE(events.ok()) << events.status();
  WaitUntilComplete(**events);
  EXPECT_EQ((*events)->progress().status.message(), "pieces: the disk is gone");
  EXPECT_EQ(EventsOf(**events, 0, 10'000), written);
}

TEST(RecordedEventsErrorTest, AFileThatBecomesShorterIsAnError) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("events.raw");
  WriteRecording(path, RandomEvents(100'000, 1'000, 100'000, 5));
  auto reader = OpenRecording(path);
  ASSERT_TRUE(reader.ok()) << reader.status();
  auto events = RecordedEvents::Open(path, std::move(*reader));
  ASSERT_TRUE(events.ok()) << events.status();
  WaitUntilComplete(**events);
  std::filesystem::resize_file(path, 1'000);
  const absl::Status status = (*events)->Visit(90'000, 91'000, [](absl::Span<const Event>) {});
  EXPECT_EQ(status.code(), absl::StatusCode::kDataLoss) << status;
}

}  // namespace
}  // namespace evpose::client

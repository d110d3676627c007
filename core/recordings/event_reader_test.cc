// SPDX-License-Identifier: Apache-2.0
#include "core/recordings/event_reader.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/events/encoder.h"

namespace evpose {
namespace {

// A recording in memory.
class FakeRecording : public RecordingReader {
 public:
  explicit FakeRecording(std::string data) : data_(std::move(data)) {
    header_.encoding = Encoding::kFlat64;
    header_.geometry = {640, 480};
  }

  const RecordingHeader& header() const override { return header_; }
  absl::StatusOr<size_t> Read(absl::Span<uint8_t> buffer) override {
    if (fails_at_end && offset_ == data_.size()) return absl::DataLossError("broken disk");
    const size_t size = std::min(buffer.size(), data_.size() - offset_);
    std::memcpy(buffer.data(), data_.data() + offset_, size);
    offset_ += size;
    return size;
  }
  int64_t data_size_bytes() const override { return static_cast<int64_t>(data_.size()); }

  bool fails_at_end = false;

 private:
  RecordingHeader header_;
  std::string data_;
  size_t offset_ = 0;
};

// `count` FLAT64 words, one microsecond apart, in columns 0, 1, 2, ...
std::string Words(int count) {
  std::string data;
  for (int i = 0; i < count; ++i) {
    const uint64_t word = static_cast<uint64_t>(100 + i) << 32 | static_cast<uint64_t>(i) << 18 | 7u << 4 | 1u;
    for (int shift = 0; shift < 64; shift += 8) data.push_back(static_cast<char>(word >> shift));
  }
  return data;
}

TEST(EventReaderTest, HandsOutTheSameEventsForEveryPieceSize) {
  constexpr int kCount = 100;
  for (const size_t piece_bytes : {1u, 7u, 64u, 4096u}) {
    FakeRecording recording(Words(kCount) + "abc");
    auto reader = EventReader::Make(recording, {.max_piece_bytes = piece_bytes});
    ASSERT_TRUE(reader.ok()) << reader.status();
    int count = 0;
    absl::StatusOr<bool> has_piece = reader->Next();
    for (; has_piece.ok() && *has_piece; has_piece = reader->Next()) {
      for (const Event& event : reader->decoded().events) {
        EXPECT_EQ(event.t_us, 100 + count);
        EXPECT_EQ(event.x, count++);
      }
    }
    EXPECT_TRUE(has_piece.ok()) << has_piece.status();
    EXPECT_EQ(count, kCount);
    EXPECT_TRUE(reader->decoded().events.empty());
    EXPECT_EQ(reader->counts().cd_events, uint64_t{kCount});
    EXPECT_EQ(reader->data_bytes(), 8u * kCount + 3);
    EXPECT_EQ(reader->pending_bytes(), 3);
  }
}

TEST(EventReaderTest, KeepsEventsOutsideTheSensorOnRequest) {
  for (const OutsideSensor outside : {OutsideSensor::kDrop, OutsideSensor::kKeep}) {
    FakeRecording recording(Words(650));
    auto reader = EventReader::Make(recording, {.outside_sensor = outside});
    ASSERT_TRUE(reader.ok()) << reader.status();
    ASSERT_TRUE(reader->Next().value());
    EXPECT_EQ(reader->decoded().events.size(), outside == OutsideSensor::kKeep ? 650u : 640u);
  }
}

TEST(EventReaderTest, ReportsAFailedRead) {
  FakeRecording recording(Words(3));
  recording.fails_at_end = true;
  auto reader = EventReader::Make(recording);
  ASSERT_TRUE(reader.ok()) << reader.status();
  EXPECT_TRUE(reader->Next().value());
  EXPECT_EQ(reader->Next().status().message(), "broken disk");
}

// EVT3 whose bytes are lost before some reads.
class LossyRecording : public RecordingReader {
 public:
  explicit LossyRecording(std::vector<std::string> parts) : parts_(std::move(parts)) { header_.geometry = {640, 480}; }

  const RecordingHeader& header() const override { return header_; }
  absl::StatusOr<size_t> Read(absl::Span<uint8_t> buffer) override {
    if (part_ == parts_.size()) return 0;
    follows_loss_ = part_ > 0;
    return parts_[part_++].copy(reinterpret_cast<char*>(buffer.data()), buffer.size());
  }
  int64_t data_size_bytes() const override { return -1; }
  bool follows_loss() const override { return follows_loss_; }

 private:
  RecordingHeader header_;
  const std::vector<std::string> parts_;
  size_t part_ = 0;
  bool follows_loss_ = false;
};

TEST(EventReaderTest, WaitsForATimeAfterALossAndKnowsTheFirstTimeWord) {
  // TIME_HIGH 5, TIME_LOW 1, row 2, an event; then an event without a time, and a whole one.
  const std::string whole("\x05\x80\x01\x60\x02\x00\x03\x20", 8);
  LossyRecording recording({whole + "\x02", std::string("\x09\x20", 2) + whole});
  auto reader = EventReader::Make(recording).value();
  EXPECT_EQ(reader.metavision_zero_us(), 0);
  ASSERT_TRUE(reader.Next().value());
  EXPECT_EQ(reader.metavision_zero_us(), 5 * 4096);
  EXPECT_EQ(reader.pending_bytes(), 1);
  ASSERT_TRUE(reader.Next().value());
  ASSERT_EQ(reader.decoded().events.size(), 1u);
  EXPECT_EQ(reader.decoded().events[0], (Event{5 * 4096 + 1, 3, 2, 0}));
  EXPECT_EQ(reader.counts().dropped_before_time, 1u);
  EXPECT_FALSE(reader.Next().value());
}

TEST(FirstTimeWordTest, IsThatOfEachEncodingForAnyCuts) {
  const std::vector<Event> events = {{70000, 1, 2, 1}, {90000, 3, 4, 0}};
  for (const auto& [encoding, expected_us] : {std::pair{Encoding::kEvt3, 69632},
                                              {Encoding::kEvt2, 69952},
                                              {Encoding::kEvt21, 69952},
                                              {Encoding::kDat, 0},
                                              {Encoding::kFlat64, 0}}) {
    std::vector<uint8_t> bytes = {};
    ASSERT_TRUE(MakeEventEncoder(encoding, {640, 480}).value()->Encode(events, bytes).ok());
    FirstTimeWord first(encoding);
    for (const uint8_t byte : bytes) first.Add({&byte, 1});
    EXPECT_EQ(first.t_us(), expected_us) << EncodingName(encoding);
  }
  EXPECT_EQ(FirstTimeWord(Encoding::kEvt3).t_us(), std::nullopt);
  for (const Encoding encoding : {Encoding::kEvt3, Encoding::kFlat64}) {
    FirstTimeWord stated(encoding, -77);
    stated.Add(std::vector<uint8_t>{0x05, 0x80, 0x01, 0x60, 0, 0, 0, 0});
    EXPECT_EQ(stated.t_us(), -77);
  }
}

}  // namespace
}  // namespace evpose

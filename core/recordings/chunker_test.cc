// SPDX-License-Identifier: Apache-2.0
#include "core/recordings/chunker.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "core/events/encoder.h"
#include "core/events/events_testing.h"
#include "core/recordings/recording_reader.h"

namespace evpose {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;

// A recording in memory that returns at most `piece` bytes per read; `num_reads` counts the reads of a chunker.
class MemoryReader final : public RecordingReader {
 public:
  MemoryReader(Encoding encoding, std::vector<uint8_t> bytes, size_t piece) : bytes_(std::move(bytes)), piece_(piece) {
    header_.encoding = encoding;
    header_.geometry = {640, 480};
  }
  const RecordingHeader& header() const override { return header_; }
  int64_t data_size_bytes() const override { return static_cast<int64_t>(bytes_.size()); }
  absl::StatusOr<size_t> Read(absl::Span<uint8_t> buffer) override {
    if (fail_at_end_ && used_ == bytes_.size()) return absl::UnavailableError("a.raw: reading failed at byte 7");
    const size_t size = std::min({piece_, buffer.size(), bytes_.size() - used_});
    std::copy_n(bytes_.begin() + static_cast<ptrdiff_t>(used_), size, buffer.begin());
    used_ += size;
    return size;
  }
  size_t used() const { return used_; }
  void FailAtEnd() { fail_at_end_ = true; }

 private:
  RecordingHeader header_;
  const std::vector<uint8_t> bytes_;
  const size_t piece_;
  size_t used_ = 0;
  bool fail_at_end_ = false;
};

std::vector<EventChunkBytes> ChunksOf(RecordingReader& reader, const ChunkerOptions& options,
                                      size_t* truncated_bytes = nullptr) {
  Chunker chunker(reader, options);
  std::vector<EventChunkBytes> chunks;
  while (true) {
    const auto chunk = chunker.Next();
    EXPECT_TRUE(chunk.ok()) << chunk.status();
    if (!chunk.ok() || chunk->bytes.empty()) break;
    chunks.push_back(*chunk);
  }
  EXPECT_THAT(chunker.Next()->bytes, IsEmpty()) << "the end is reported again";
  if (truncated_bytes != nullptr) *truncated_bytes = chunker.truncated_bytes();
  return chunks;
}

// The events of the recordings below: 30 us apart, up to eight events at one time.
constexpr int64_t kMaxPauseUs = int64_t{8} * 30;

std::vector<uint8_t> Recording(Encoding encoding, int64_t first_us, int64_t step_us, size_t count) {
  Random random(11);
  std::vector<Event> events;
  int64_t t_us = first_us;
  for (size_t i = 0; i < count; ++i) {
    t_us += static_cast<int64_t>(random.UniformInt(static_cast<uint64_t>(step_us)));
    events.push_back({t_us, static_cast<uint16_t>(i % 640), static_cast<uint16_t>(random.UniformInt(4)), 1});
  }
  // Bursts for vectors.
  for (size_t i = 0; i + 8 < count; i += 40) {
    for (size_t k = 0; k < 8; ++k) events[i + k] = {events[i].t_us, static_cast<uint16_t>(k), 3, 0};
  }
  if (encoding == Encoding::kDat) {
    std::vector<uint64_t> words;
    for (const Event& event : events) {
      const uint64_t address =
          static_cast<uint64_t>(event.polarity) << 28 | static_cast<uint64_t>(event.y) << 14 | event.x;
      words.push_back(address << 32 | static_cast<uint32_t>(event.t_us));
    }
    return BytesOf(words);
  }
  std::vector<uint8_t> bytes;
  EXPECT_TRUE(MakeEventEncoder(encoding, {640, 480}).value()->Encode(events, bytes).ok());
  return bytes;
}

class ChunkerTest : public testing::TestWithParam<Encoding> {};

TEST_P(ChunkerTest, ChunksDoNotDependOnTheReads) {
  const std::vector<uint8_t> bytes = Recording(GetParam(), 16770000, 30, 3000);
  MemoryReader whole_reader(GetParam(), bytes, bytes.size());
  const std::vector<EventChunkBytes> expected = ChunksOf(whole_reader, {});
  EXPECT_GT(expected.size(), 10);
  std::vector<uint8_t> joined;
  for (const EventChunkBytes& chunk : expected) joined.insert(joined.end(), chunk.bytes.begin(), chunk.bytes.end());
  EXPECT_EQ(joined, bytes);
  for (const size_t piece : {1u, 7u, 1000u}) {
    MemoryReader reader(GetParam(), bytes, piece);
    const std::vector<EventChunkBytes> chunks = ChunksOf(reader, {});
    ASSERT_EQ(chunks.size(), expected.size());
    for (size_t i = 0; i < chunks.size(); ++i) {
      ASSERT_EQ(chunks[i].bytes, expected[i].bytes);
      ASSERT_EQ(chunks[i].t_last_us, expected[i].t_last_us);
    }
  }
}

TEST_P(ChunkerTest, TimesEqualTheDecodersAndDurationsAreKept) {
  const Encoding encoding = GetParam();
  // Across a wrap of the 24-bit clock and, where the encoding allows such a first time, of the clocks of 32 and 34
  // bits.
  for (const int64_t first_us : {int64_t{16770000}, (int64_t{1} << 32) - 15000, (int64_t{1} << 34) - 15000}) {
    const bool full_time = encoding == Encoding::kDat || encoding == Encoding::kFlat64;
    if (full_time && first_us >= int64_t{1} << 32) continue;
    MemoryReader reader(encoding, Recording(encoding, first_us, 30, 3000), 1000);
    const auto decoder = MakeEventDecoder(encoding, {640, 480}).value();
    DecodedEvents out;
    int64_t t_begin_us = first_us;
    for (const EventChunkBytes& chunk : ChunksOf(reader, {})) {
      decoder->Decode(chunk.bytes, out);
      if (out.events.empty()) continue;  // time words before the first event
      ASSERT_GE(chunk.t_last_us, out.events.back().t_us);
      ASSERT_LT(chunk.t_last_us, out.events.back().t_us + kMaxPauseUs);
      // The duration, and the time until the next time word.
      ASSERT_LE(chunk.t_last_us, t_begin_us + 1000 + 64 + kMaxPauseUs);
      t_begin_us = chunk.t_last_us;
    }
    EXPECT_GE(out.events.back().t_us, first_us + 30000);
  }
}

TEST_P(ChunkerTest, SizeClosesChunksToo) {
  const std::vector<uint8_t> bytes = Recording(GetParam(), 1000, 2, 3000);
  for (const size_t max_bytes : {8u, 64u, 1024u}) {
    MemoryReader reader(GetParam(), bytes, 333);
    std::vector<uint8_t> joined;
    const std::vector<EventChunkBytes> chunks =
        ChunksOf(reader, {.max_duration_us = 1000000000, .max_bytes = max_bytes});
    for (size_t i = 0; i < chunks.size(); ++i) {
      ASSERT_TRUE(chunks[i].bytes.size() == max_bytes || i + 1 == chunks.size());
      joined.insert(joined.end(), chunks[i].bytes.begin(), chunks[i].bytes.end());
    }
    EXPECT_EQ(joined, bytes);
  }
}

TEST_P(ChunkerTest, PartOfAWordIsCountedNotReturned) {
  std::vector<uint8_t> bytes = Recording(GetParam(), 1000, 10, 100);
  const size_t whole = bytes.size();
  const auto word_bytes = static_cast<size_t>(WordBytes(GetParam()));
  for (size_t extra = 0; extra < word_bytes; ++extra) {
    MemoryReader reader(GetParam(), bytes, 50);
    size_t truncated_bytes = 99;
    size_t total = 0;
    for (const EventChunkBytes& chunk : ChunksOf(reader, {}, &truncated_bytes)) total += chunk.bytes.size();
    EXPECT_EQ(total, whole);
    EXPECT_EQ(truncated_bytes, extra);
    bytes.push_back(0);
  }
}

TEST_P(ChunkerTest, ALiveStreamDoesNotWaitForMore) {
  // A chunk is returned with the word that completes it: no byte after it is needed.
  const std::vector<uint8_t> bytes = Recording(GetParam(), 1000, 30, 3000);
  MemoryReader reader(GetParam(), bytes, 1);
  Chunker chunker(reader, {});
  size_t total = 0;
  while (reader.used() < bytes.size()) {
    total += chunker.Next().value().bytes.size();
    ASSERT_EQ(reader.used(), total);
  }
}

INSTANTIATE_TEST_SUITE_P(Encodings, ChunkerTest,
                         testing::Values(Encoding::kEvt3, Encoding::kEvt21, Encoding::kEvt2, Encoding::kDat,
                                         Encoding::kFlat64),
                         [](const auto& test) {
                           std::string name(EncodingName(test.param));
                           std::erase(name, '.');
                           return name;
                         });

TEST(ChunkerCaseTest, TimeWordsOfAnIdleCameraEndChunks) {
  std::vector<uint16_t> words;
  for (uint32_t high = 0; high < 10; ++high) words.insert(words.end(), {Evt3(8, high), Evt3(8, high)});
  MemoryReader reader(Encoding::kEvt3, BytesOf(words), 3);
  const std::vector<EventChunkBytes> chunks = ChunksOf(reader, {});
  ASSERT_EQ(chunks.size(), 10);
  for (size_t i = 0; i + 1 < chunks.size(); ++i) EXPECT_EQ(chunks[i].t_last_us, static_cast<int64_t>(i + 1) * 4096);
}

TEST(ChunkerCaseTest, NoTimeIsKnownBeforeTheFirstTimeWord) {
  MemoryReader reader(Encoding::kEvt3, BytesOf<uint16_t>({Evt3(6, 9), Evt3(0, 1), Evt3(2, 1), Evt3(2, 2), Evt3(8, 1)}),
                      8);
  const std::vector<EventChunkBytes> chunks = ChunksOf(reader, {.max_bytes = 8});
  ASSERT_EQ(chunks.size(), 2);
  EXPECT_EQ(chunks[0].t_last_us, -1);
  EXPECT_EQ(chunks[1].t_last_us, 4096);
}

TEST(ChunkerCaseTest, HoursOfClock) {
  std::vector<uint16_t> words;
  for (uint32_t quarter = 0; quarter < 4 * 1000; ++quarter) words.push_back(Evt3(8, quarter * 1024 % 4096));
  MemoryReader reader(Encoding::kEvt3, BytesOf(words), 4096);
  EXPECT_EQ(ChunksOf(reader, {}).back().t_last_us, int64_t{3999} << 22);
}

TEST(ChunkerCaseTest, TripleCutBetweenChunksDecodes) {
  const std::vector<uint8_t> bytes = BytesOf<uint16_t>(
      {Evt3(8, 0), Evt3(0, 1), Evt3(3, 0), Evt3(4, 1), Evt3(4, 1), Evt3(5, 1), Evt3(6, 3), Evt3(2, 9)});
  MemoryReader reader(Encoding::kEvt3, bytes, 100);
  const auto decoder = MakeEventDecoder(Encoding::kEvt3, {640, 480}).value();
  DecodedEvents out;
  const std::vector<EventChunkBytes> chunks = ChunksOf(reader, {.max_bytes = 8});
  EXPECT_EQ(chunks.size(), 2);
  for (const EventChunkBytes& chunk : chunks) decoder->Decode(chunk.bytes, out);
  EXPECT_EQ(out.events, DecodeAll(Encoding::kEvt3, {640, 480}, bytes).out.events);
  EXPECT_EQ(out.events.size(), 4);
}

TEST(ChunkerCaseTest, WrongOptionsAreNamed) {
  MemoryReader reader(Encoding::kEvt3, {}, 1);
  EXPECT_THAT(std::string(Chunker(reader, {.max_duration_us = 0}).Next().status().message()),
              HasSubstr("max_duration_us is 0"));
  for (const size_t max_bytes : {0u, 4u, 12u}) {
    EXPECT_THAT(std::string(Chunker(reader, {.max_bytes = max_bytes}).Next().status().message()),
                HasSubstr("max_bytes is " + std::to_string(max_bytes)));
  }
}

TEST(ChunkerCaseTest, ReadErrorsComeThrough) {
  MemoryReader reader(Encoding::kEvt3, BytesOf<uint16_t>({Evt3(8, 0)}), 1);
  reader.FailAtEnd();
  Chunker chunker(reader, {});
  EXPECT_EQ(chunker.Next().status().code(), absl::StatusCode::kUnavailable);
}

}  // namespace
}  // namespace evpose

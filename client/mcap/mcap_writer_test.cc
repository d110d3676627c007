// SPDX-License-Identifier: Apache-2.0
#include "client/mcap/mcap_writer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/containers/mcap_records.h"
#include "client/mcap/mcap_testing.h"
#include "core/base/output_file.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

constexpr size_t kMaxTestBytes = 10'000'000;
const McapTopic kTestTopic = {"/a", "std_msgs/msg/String", "string data\n", false};

std::string PathOf(const std::string& name) {
  std::string path = absl::StrCat(::testing::TempDir(), "/mcap_writer_test_", name);
  std::filesystem::remove(path);
  std::filesystem::remove(path + ".partial");
  return path;
}

std::string BytesOf(const std::string& path) { return *ReadFile(path, kMaxTestBytes); }

// Little-endian numbers and length-prefixed text, written apart from the writer.
template <typename Number>
std::string N(Number value) {
  std::string bytes;
  for (size_t i = 0; i < sizeof(Number); ++i) bytes.push_back(static_cast<char>(value >> (8 * i)));
  return bytes;
}
std::string S(const std::string& text) { return N(static_cast<uint32_t>(text.size())) + text; }
std::string Rec(uint8_t op, const std::string& content) { return N(op) + N(uint64_t{content.size()}) + content; }

constexpr char kVolatileQos[] =
    "- history: 1\n  depth: 10\n  reliability: 1\n  durability: 2\n  deadline:\n    sec: 0\n    nsec: 0\n"
    "  lifespan:\n    sec: 0\n    nsec: 0\n  liveliness: 1\n  liveliness_lease_duration:\n    sec: 0\n    nsec: 0\n"
    "  avoid_ros_namespace_conventions: false\n";

TEST(McapWriter, ASmallFileToTheByte) {
  const std::string path = PathOf("small.mcap");
  auto writer = McapWriter::Create(path, {.compresses = false, .library = "lib"});
  ASSERT_TRUE(writer.ok());
  writer->AddMetadata("notes", {{"key", "value"}});
  writer->Write(writer->AddTopic(kTestTopic), 1'000'000'007, "payload");
  ASSERT_TRUE(writer->Commit().ok());

  const std::string magic("\x89MCAP0\r\n", 8);
  const std::string header = Rec(1, S("ros2") + S("lib"));
  const std::string metadata = Rec(12, S("notes") + S(S("key") + S("value")));
  const std::string schema = Rec(3, N(uint16_t{1}) + S("std_msgs/msg/String") + S("ros2msg") + S("string data\n"));
  const std::string channel =
      Rec(4, N(uint16_t{1}) + N(uint16_t{1}) + S("/a") + S("cdr") + S(S("offered_qos_profiles") + S(kVolatileQos)));
  const std::string message =
      Rec(5, N(uint16_t{1}) + N(uint32_t{0}) + N(uint64_t{1'000'000'007}) + N(uint64_t{1'000'000'007}) + "payload");
  const std::string times = N(uint64_t{1'000'000'007}) + N(uint64_t{1'000'000'007});
  const std::string sizes = N(uint64_t{message.size()});
  const std::string chunk = Rec(6, times + sizes + N(McapCrc32(message)) + S("") + sizes + message);
  const std::string message_index =
      Rec(7, N(uint16_t{1}) + N(uint32_t{16}) + N(uint64_t{1'000'000'007}) + N(uint64_t{0}));
  const uint64_t metadata_begin = (magic + header).size();
  const uint64_t chunk_begin = metadata_begin + (metadata + schema + channel).size();
  const std::string data = magic + header + metadata + schema + channel + chunk + message_index + Rec(15, N(0));

  const std::string counts = N(uint32_t{10}) + N(uint16_t{1}) + N(uint64_t{1});
  const std::string statistics = Rec(11, N(uint64_t{1}) + N(uint16_t{1}) + N(uint32_t{1}) + N(uint32_t{0}) +
                                             N(uint32_t{1}) + N(uint32_t{1}) + times + counts);
  const std::string chunk_index =
      Rec(8, times + N(chunk_begin) + N(uint64_t{chunk.size()}) + N(uint32_t{10}) + N(uint16_t{1}) +
                 N(uint64_t{chunk_begin + chunk.size()}) + N(uint64_t{message_index.size()}) + S("") + sizes + sizes);
  const std::string metadata_index = Rec(13, N(metadata_begin) + N(uint64_t{metadata.size()}) + S("notes"));
  std::string summary, offsets;
  for (const std::string& group : {schema, channel, statistics, chunk_index, metadata_index}) {
    offsets += Rec(14, group.substr(0, 1) + N(uint64_t{data.size() + summary.size()}) + N(uint64_t{group.size()}));
    summary += group;
  }
  const std::string covered = summary + offsets + N(uint8_t{2}) + N(uint64_t{20}) + N(uint64_t{data.size()}) +
                              N(uint64_t{data.size() + summary.size()});
  EXPECT_EQ(BytesOf(path), data + covered + N(McapCrc32(covered)) + magic);
  EXPECT_EQ(McapCrc32("123456789"), 0xCBF43926);  // the check value of CRC-32
}

// Messages on two topics in several chunks.
void WriteMany(McapWriter& writer, int first, int end) {
  const uint16_t a = writer.AddTopic(kTestTopic);
  const uint16_t b = writer.AddTopic({"/b", "std_msgs/msg/String", "string data\n", true});
  for (int i = first; i < end; ++i) {
    writer.Write(i % 3 == 0 ? b : a, 1'000'000 * static_cast<uint64_t>(i), absl::StrCat("message ", i));
  }
}

McapWriterOptions SmallChunks() { return {.chunk_bytes = 500}; }

TEST(McapWriter, ChunksEndBySizeAndByTime) {
  const std::string path = PathOf("chunks.mcap");
  auto writer = McapWriter::Create(path, {.chunk_bytes = 1000, .chunk_ns = 1000});
  const uint16_t channel = writer->AddTopic(kTestTopic);
  const auto write = [&](uint64_t time_ns, size_t size) { writer->Write(channel, time_ns, std::string(size, 'x')); };
  write(5000, 100);
  write(5999, 100);
  EXPECT_EQ(writer->index().chunks.size(), 0u);
  write(6000, 100);  // 1000 ns after the first
  EXPECT_EQ(writer->index().chunks.size(), 1u);
  write(5001, 100);  // 999 ns before
  EXPECT_EQ(writer->index().chunks.size(), 1u);
  write(5900, 5000);  // longer than a chunk
  EXPECT_EQ(writer->index().chunks.size(), 2u);
  write(5900, 1);
  EXPECT_EQ(writer->index().chunks.size(), 3u);
  ASSERT_TRUE(writer->Commit().ok());
  EXPECT_EQ(writer->index().chunks[1].start_ns, 5001u);
  EXPECT_EQ(writer->index().chunks[1].end_ns, 6000u);
  EXPECT_EQ(ReadMessages(path).size(), 6u);
}

TEST(McapWriter, TheIndexFindsEveryMessage) {
  const std::string path = PathOf("index.mcap");
  McapWriterOptions options = SmallChunks();
  options.compresses = false;
  auto writer = McapWriter::Create(path, options);
  WriteMany(*writer, 0, 100);
  const uint16_t channel = writer->AddTopic(kTestTopic);
  writer->Write(channel, 70'000'000, "late");  // its time steps back
  ASSERT_TRUE(writer->Commit().ok());
  const std::string bytes = BytesOf(path);
  EXPECT_GT(writer->index().chunks.size(), 5u);
  size_t num_found = 0;
  for (const McapChunk& chunk : writer->index().chunks) {
    const uint64_t records_begin = chunk.begin + chunk.length - chunk.stored_bytes;
    uint64_t indexes_begin = chunk.begin + chunk.length;
    for (const auto& [id, position] : chunk.message_indexes) {
      EXPECT_EQ(position, indexes_begin);
      ByteView view(std::string_view(bytes).substr(position));
      EXPECT_EQ(view.Take<uint8_t>(), McapRecord::kMessageIndex);
      ByteView content(view.TakeBytes(view.Take<uint64_t>()));
      indexes_begin = bytes.size() - view.rest().size();
      EXPECT_EQ(content.Take<uint16_t>(), id);
      content.Take<uint32_t>();
      uint64_t last_ns = 0;
      while (!content.rest().empty()) {
        const auto time_ns = content.Take<uint64_t>();
        EXPECT_GE(time_ns, last_ns);
        last_ns = time_ns;
        ByteView message(std::string_view(bytes).substr(records_begin + content.Take<uint64_t>()));
        EXPECT_EQ(message.Take<uint8_t>(), McapRecord::kMessage);
        message.Take<uint64_t>();
        EXPECT_EQ(message.Take<uint16_t>(), id);
        message.Take<uint32_t>();
        EXPECT_EQ(message.Take<uint64_t>(), time_ns);
        ++num_found;
      }
    }
    EXPECT_EQ(indexes_begin, chunk.begin + chunk.length + chunk.message_index_length);
  }
  EXPECT_EQ(num_found, 101u);
  EXPECT_EQ(ReadMessages(path).size(), 101u);
}

TEST(McapWriter, AFileCutAtAnyByteHasItsCompleteChunks) {
  const std::string path = PathOf("cut.mcap");
  auto writer = McapWriter::Create(path, SmallChunks());
  WriteMany(*writer, 0, 40);
  ASSERT_TRUE(writer->Commit().ok());
  const std::string bytes = BytesOf(path);
  const std::vector<TestMessage> all = ReadMessages(path);
  ASSERT_EQ(all.size(), 40u);
  const std::vector<McapChunk>& chunks = writer->index().chunks;
  for (size_t size = kMcapMagic.size(); size < bytes.size(); ++size) {
    ASSERT_TRUE(WriteFile(path, std::string_view(bytes).substr(0, size)).ok());
    std::vector<SkippedParts> skipped;
    const std::vector<TestMessage> messages = ReadMessages(path, &skipped);
    // Number of messages in the complete chunks. The time of message i is i milliseconds.
    uint64_t num_complete = 0;
    for (size_t i = 0; i < chunks.size() && chunks[i].begin + chunks[i].length <= size; ++i) {
      num_complete = i + 1 < chunks.size() ? chunks[i + 1].start_ns / 1'000'000 : all.size();
    }
    ASSERT_EQ(messages.size(), num_complete) << size;
    ASSERT_TRUE(std::equal(messages.begin(), messages.end(), all.begin())) << size;
  }
}

TEST(McapWriter, ContinuesAFileOfAnEarlierProcess) {
  const std::string whole_path = PathOf("whole.mcap"), path = PathOf("continued.mcap");
  auto whole = McapWriter::Create(whole_path, SmallChunks());
  WriteMany(*whole, 0, 100);
  ASSERT_TRUE(whole->Commit().ok());

  uint64_t kept = 0;
  {
    auto first = McapWriter::Continue(path, 0, SmallChunks());
    ASSERT_TRUE(first.ok());
    first->AddMetadata("notes", {{"key", "value"}, {"other", ""}});
    WriteMany(*first, 0, 40);
    kept = *first->Sync();
    WriteMany(*first, 40, 70);  // lost: the process is killed before the next position is kept
  }
  EXPECT_FALSE(std::filesystem::exists(path));
  auto second = McapWriter::Continue(path, kept, SmallChunks());
  ASSERT_TRUE(second.ok()) << second.status();
  EXPECT_EQ(second->index().metadata.at(0).values.at("key"), "value");
  EXPECT_EQ(second->index().num_messages.at(1), 26u);
  WriteMany(*second, 40, 100);
  ASSERT_TRUE(second->Commit().ok());
  EXPECT_EQ(ReadMessages(path), ReadMessages(whole_path));
  // The index that was read is the one that a process without interruption writes.
  const std::string bytes = BytesOf(path);
  const uint64_t data_end = second->index().chunks.back().begin + second->index().chunks.back().length +
                            second->index().chunks.back().message_index_length;
  EXPECT_EQ(ReadMcapIndex(path, data_end)->MakeEnd(data_end), bytes.substr(data_end));
}

TEST(McapWriter, ADamagedFileIsNotContinued) {
  const std::string path = PathOf("damaged.mcap");
  uint64_t kept = 0;
  {
    auto first = McapWriter::Continue(path, 0, SmallChunks());
    WriteMany(*first, 0, 40);
    kept = *first->Sync();
  }
  const std::string bytes = BytesOf(path + ".partial");
  const auto status_of = [&](const std::string& damaged, uint64_t size) {
    EXPECT_TRUE(WriteFile(path + ".partial", damaged).ok());
    const auto writer = McapWriter::Continue(path, size);
    EXPECT_FALSE(writer.ok());
    return writer.status();
  };
  EXPECT_EQ(status_of(bytes, kept - 1).code(), absl::StatusCode::kDataLoss);
  EXPECT_THAT(status_of(bytes, kept - 1).message(), HasSubstr("damaged.mcap.partial: has an incomplete record"));
  EXPECT_THAT(status_of("x" + bytes, kept).message(), HasSubstr("is not an MCAP file, at byte 8"));
  EXPECT_THAT(status_of(bytes.substr(0, kept - 1), kept).message(), HasSubstr("had been written"));
  std::string wrong_type = bytes;
  wrong_type[8] = '\x02';
  EXPECT_THAT(status_of(wrong_type, kept).message(), HasSubstr("has a record of type 2"));
  // Whatever is damaged: an error or an index, no crash.
  for (size_t i = 0; i < kept; ++i) {
    std::string damaged = bytes;
    damaged[i] = static_cast<char>(damaged[i] ^ 0xff);
    ASSERT_TRUE(WriteFile(path + ".partial", damaged).ok());
    const auto index = ReadMcapIndex(path + ".partial", kept);
    if (!index.ok()) {
      EXPECT_EQ(index.status().code(), absl::StatusCode::kDataLoss);
    }
  }
}

TEST(McapWriter, AFileWithoutCommitDoesNotAppear) {
  const std::string path = PathOf("never.mcap");
  {
    auto writer = McapWriter::Create(path);
    WriteMany(*writer, 0, 10);
  }
  EXPECT_FALSE(std::filesystem::exists(path));
}

TEST(McapWriter, CompleteChunksAreInTheFileBeforeTheEnd) {
  const std::string path = PathOf("flushed.mcap");
  auto writer = McapWriter::Continue(path, 0, SmallChunks());
  WriteMany(*writer, 0, 100);
  const McapChunk& last = writer->index().chunks.back();
  // Neither Sync() nor Commit() was called, so that the file is the one after a kill of the process.
  EXPECT_EQ(std::filesystem::file_size(path + ".partial"), last.begin + last.length + last.message_index_length);
  EXPECT_GT(ReadMessages(path + ".partial").size(), 80u);
}

TEST(McapWriter, ReportsAFullDisk) {
  auto writer = McapWriter::Create("/dev/full", SmallChunks());
  ASSERT_TRUE(writer.ok()) << writer.status();
  WriteMany(*writer, 0, 100);
  EXPECT_THAT(writer->Commit().message(), HasSubstr("/dev/full: writing failed"));
}

}  // namespace
}  // namespace evpose::client

// SPDX-License-Identifier: Apache-2.0
#include "client/containers/bag.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <lz4frame.h>
#include <sqlite3.h>
#include <zlib.h>
#include <zstd.h>

#include <fstream>
#include <functional>

#include "client/containers/containers_testing.h"
#include "client/containers/mcap_records.h"
#include "client/containers/ros_messages.h"
#include "core/base/temporary_directory_testing.h"
#include "core/recordings/chunker.h"
#include "tests/data/test_data.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr char kPackets[] = "event_camera_msgs/msg/EventPacket";

template <typename Number>
void AppendNumber(Number value, std::string& out) {
  out.append(reinterpret_cast<const char*>(&value), sizeof(value));
}

void AppendText(std::string_view text, std::string& out) {
  AppendNumber(static_cast<uint32_t>(text.size()), out);
  out += text;
}

// A CDR message; `is_little`: the byte order of its numbers.
class CdrMessage {
 public:
  explicit CdrMessage(bool is_little) : is_little_(is_little) {}

  template <typename Number>
  void Add(Number value) {
    bytes_.append((sizeof(Number) - bytes_.size() % sizeof(Number)) % sizeof(Number), '\0');
    std::string number;
    AppendNumber(value, number);
    if (!is_little_) std::reverse(number.begin(), number.end());
    bytes_ += number;
  }
  void AddText(const std::string& text) {
    Add(static_cast<uint32_t>(text.size() + 1));
    bytes_ += text + '\0';
  }
  void AddBytes(const std::string& bytes) { bytes_ += bytes; }
  std::string Take() const { return std::string("\0", 1) + (is_little_ ? '\1' : '\0') + std::string(2, '\0') + bytes_; }

 private:
  const bool is_little_;
  std::string bytes_;
};

struct PacketFields {
  uint64_t seq = 0;
  std::string events;
  std::string encoding = "evt3";
  uint32_t width = 640;
  bool is_little = true;
};

std::string MakePacket(const PacketFields& fields) {
  CdrMessage message(fields.is_little);
  message.Add(int32_t{1700000000});
  message.Add(uint32_t{5});
  message.AddText("camera_frame");
  message.Add(uint32_t{480});
  message.Add(fields.width);
  message.Add(fields.seq);
  message.Add(uint64_t{0});
  message.AddText(fields.encoding);
  message.Add(uint8_t{0});
  message.Add(static_cast<uint32_t>(fields.events.size()));
  message.AddBytes(fields.events);
  return message.Take();
}

std::string Words(std::initializer_list<uint16_t> words) {
  std::string bytes;
  for (const uint16_t word : words) AppendNumber(word, bytes);
  return bytes;
}

// EVT3 of an event at time `t_us`, row 2, column `x`.
std::string EventAt(uint16_t t_us, uint16_t x) {
  return Words({0x8000, static_cast<uint16_t>(0x6000 | t_us), 0x0002, static_cast<uint16_t>(0x2800 | x)});
}

struct TestTopic {
  std::string name;
  std::string type;
  std::vector<std::string> messages;
};

std::string Record(uint8_t op, const std::string& content) {
  std::string bytes(1, static_cast<char>(op));
  AppendNumber(uint64_t{content.size()}, bytes);
  return bytes + content;
}

std::string Compress(const std::string& bytes, const std::string& compression) {
  std::string out;
  if (compression == "zstd") {
    out.resize(ZSTD_compressBound(bytes.size()));
    out.resize(ZSTD_compress(out.data(), out.size(), bytes.data(), bytes.size(), 1));
  } else if (compression == "lz4") {
    out.resize(LZ4F_compressFrameBound(bytes.size(), nullptr));
    out.resize(LZ4F_compressFrame(out.data(), out.size(), bytes.data(), bytes.size(), nullptr));
  } else {
    out = bytes;
  }
  return out;
}

std::string Chunk(const std::string& records, const std::string& compression) {
  std::string content(16, '\0');
  AppendNumber(uint64_t{records.size()}, content);
  AppendNumber(static_cast<uint32_t>(
                   crc32(0, reinterpret_cast<const Bytef*>(records.data()), static_cast<uInt>(records.size()))),
               content);
  AppendText(compression, content);
  const std::string compressed = Compress(records, compression);
  AppendNumber(uint64_t{compressed.size()}, content);
  return Record(McapRecord::kChunk, content + compressed);
}

// An MCAP file without an index, each message in a chunk.
std::string MakeMcap(const std::vector<TestTopic>& topics, const std::string& compression = "") {
  std::string file(kMcapMagic);
  file += Record(McapRecord::kHeader, std::string(8, '\0'));
  uint16_t id = 1;
  for (const TestTopic& topic : topics) {
    std::string schema, channel;
    AppendNumber(id, schema);
    AppendText(topic.type, schema);
    AppendText("ros2msg", schema);
    AppendText("", schema);
    AppendNumber(id, channel);
    AppendNumber(id, channel);
    AppendText(topic.name, channel);
    AppendText("cdr", channel);
    AppendText("", channel);
    const std::string head = Record(McapRecord::kSchema, schema) + Record(McapRecord::kChannel, channel);
    for (const std::string& message : topic.messages) {
      std::string content;
      AppendNumber(id, content);
      content += std::string(20, '\0') + message;
      file += Chunk(head + Record(McapRecord::kMessage, content), compression);
    }
    ++id;
  }
  return file + Record(McapRecord::kDataEnd, std::string(4, '\0')) +
         Record(McapRecord::kFooter, std::string(20, '\0')) + std::string(kMcapMagic);
}

std::string WriteSqliteBag(const std::string& path, const std::vector<TestTopic>& topics) {
  sqlite3* database = nullptr;
  EXPECT_EQ(sqlite3_open(path.c_str(), &database), SQLITE_OK);
  const auto run = [database](const std::string& sql) {
    EXPECT_EQ(sqlite3_exec(database, sql.c_str(), nullptr, nullptr, nullptr), SQLITE_OK) << sql;
  };
  run("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)");
  run("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)");
  for (size_t i = 0; i < topics.size(); ++i) {
    run(absl::StrCat("INSERT INTO topics VALUES(", i, ",'", topics[i].name, "','", topics[i].type, "','cdr')"));
    for (const std::string& message : topics[i].messages) {
      sqlite3_stmt* insert = nullptr;
      sqlite3_prepare_v2(database, "INSERT INTO messages(topic_id, timestamp, data) VALUES(?1, 0, ?2)", -1, &insert,
                         nullptr);
      sqlite3_bind_int64(insert, 1, static_cast<int64_t>(i));
      sqlite3_bind_blob(insert, 2, message.data(), static_cast<int>(message.size()), SQLITE_TRANSIENT);
      EXPECT_EQ(sqlite3_step(insert), SQLITE_DONE);
      sqlite3_finalize(insert);
    }
  }
  sqlite3_close(database);
  return path;
}

class McapCompressionTest : public testing::TestWithParam<const char*> {};

TEST_P(McapCompressionTest, ChunksAreRead) {
  const TemporaryDirectory directory;
  const TestTopic topic = {"/events", kPackets, {MakePacket({1, EventAt(5, 7)}), MakePacket({2, EventAt(9, 8)})}};
  const auto recording = ReadAll(WriteBytes(directory.File("a"), MakeMcap({topic}, GetParam())));
  ASSERT_TRUE(recording.ok()) << recording.status();
  EXPECT_THAT(recording->events, ElementsAre(Event{5, 7, 2, 1}, Event{9, 8, 2, 1}));
  EXPECT_THAT(recording->skipped, IsEmpty());
}

INSTANTIATE_TEST_SUITE_P(All, McapCompressionTest, testing::Values("", "zstd", "lz4"));

TEST(BagTest, BigEndianMessagesAreRead) {
  const TemporaryDirectory directory;
  PacketFields fields = {1, EventAt(5, 7)};
  fields.is_little = false;
  const TestTopic topic = {"/events", kPackets, {MakePacket(fields)}};
  EXPECT_THAT(ReadAll(WriteSqliteBag(directory.File("a.db3"), {topic}))->events, ElementsAre(Event{5, 7, 2, 1}));
}

TEST(BagTest, AGapInTheSequenceIsALossAndIsCounted) {
  const TemporaryDirectory directory;
  // The packet after the gap begins with an event; the words of its time and row were in a lost packet.
  const TestTopic topic = {"/events",
                           kPackets,
                           {MakePacket({1, EventAt(5, 7)}), MakePacket({2, EventAt(9, 8) + "\x01"}),
                            MakePacket({6, Words({0x2005}) + EventAt(12, 9)}), MakePacket({7, Words({0x2806})})}};
  const std::string path = WriteSqliteBag(directory.File("a.db3"), {topic});
  const auto recording = ReadAll(path);
  ASSERT_TRUE(recording.ok()) << recording.status();
  EXPECT_THAT(recording->events,
              ElementsAre(Event{5, 7, 2, 1}, Event{9, 8, 2, 1}, Event{12, 9, 2, 1}, Event{12, 6, 2, 1}));
  EXPECT_THAT(recording->losses, ElementsAre(2));
  EXPECT_EQ(recording->counts.dropped_before_time, 1);
  EXPECT_EQ(recording->num_skipped("gaps in the sequence numbers of the packets"), 1);
  EXPECT_EQ(recording->num_skipped("packets missing in these gaps"), 3);

  auto reader = OpenRecording(path).value();
  Chunker chunker(*reader, {.max_duration_us = 1 << 20});
  const EventChunkBytes first = chunker.Next().value(), second = chunker.Next().value();
  EXPECT_EQ(first.bytes.size(), 16u) << "without the unfinished word before the loss";
  EXPECT_FALSE(first.follows_loss);
  EXPECT_TRUE(second.follows_loss);
  EXPECT_EQ(second.bytes.size(), 12u);
  EXPECT_TRUE(chunker.Next()->bytes.empty());
  EXPECT_EQ(chunker.truncated_bytes(), 0);
}

TEST(BagTest, DamagedAndOtherPacketsAreLossesToo) {
  const TemporaryDirectory directory;
  PacketFields other_size = {2, EventAt(9, 8)};
  other_size.width = 1280;
  const std::string whole = MakePacket({3, EventAt(11, 8)});
  const TestTopic topic = {"/events",
                           kPackets,
                           {MakePacket({1, EventAt(5, 7)}), MakePacket(other_size), whole.substr(0, whole.size() - 1),
                            "", MakePacket({4, EventAt(12, 9)})}};
  const auto recording = ReadAll(WriteBytes(directory.File("a"), MakeMcap({topic}, "zstd")));
  ASSERT_TRUE(recording.ok()) << recording.status();
  EXPECT_THAT(recording->events, ElementsAre(Event{5, 7, 2, 1}, Event{12, 9, 2, 1}));
  EXPECT_EQ(recording->num_skipped("damaged packets"), 2);
  EXPECT_EQ(recording->num_skipped("packets of another encoding, byte order or sensor size"), 1);
  EXPECT_THAT(recording->losses, ElementsAre(1));
}

TEST(BagTest, ASqliteFileThatChangesWhileItIsReadIsAnError) {
  const TemporaryDirectory directory;
  const TestTopic topic = {"/events", kPackets, {MakePacket({1, EventAt(5, 7)}), MakePacket({2, EventAt(9, 8)})}};
  const std::string path = WriteSqliteBag(directory.File("a.db3"), {topic});
  auto reader = OpenRecording(path).value();
  std::ofstream(path, std::ios::app) << "more";
  Chunker chunker(*reader, {.max_duration_us = 1 << 20});
  absl::StatusOr<EventChunkBytes> chunk = chunker.Next();
  while (chunk.ok() && !chunk->bytes.empty()) chunk = chunker.Next();
  EXPECT_EQ(chunk.status().code(), absl::StatusCode::kDataLoss);
  EXPECT_THAT(chunk.status().message(), HasSubstr("a.db3: changed while it was read: its size was"));
}

TEST(BagTest, PublishersThatDoNotCountHaveNoGaps) {
  const TemporaryDirectory directory;
  const TestTopic topic = {"/events", kPackets, {MakePacket({0, EventAt(5, 7)}), MakePacket({0, EventAt(9, 8)})}};
  EXPECT_THAT(ReadAll(WriteSqliteBag(directory.File("a.db3"), {topic}))->skipped, IsEmpty());
}

TEST(BagTest, DamagedChunksAndATruncatedEndAreCounted) {
  const TemporaryDirectory directory;
  const TestTopic topic = {
      "/events",
      kPackets,
      {MakePacket({1, EventAt(5, 7)}), MakePacket({2, EventAt(9, 8)}), MakePacket({3, EventAt(12, 9)})}};
  std::string file = MakeMcap({topic});
  const size_t second = file.find(EventAt(9, 8));
  file[second + 2] ^= 1;  // its checksum no longer fits
  const auto damaged = ReadAll(WriteBytes(directory.File("a"), file));
  EXPECT_THAT(damaged->events, ElementsAre(Event{5, 7, 2, 1}, Event{12, 9, 2, 1}));
  EXPECT_EQ(damaged->num_skipped("damaged chunks"), 1);
  EXPECT_EQ(damaged->num_skipped("packets missing in these gaps"), 1);
  const auto truncated = ReadAll(WriteBytes(directory.File("a"), file.substr(0, file.find(EventAt(12, 9)))));
  EXPECT_THAT(truncated->events, ElementsAre(Event{5, 7, 2, 1}));
  EXPECT_EQ(truncated->num_skipped("truncated end: messages may be missing"), 1);
}

TEST(BagTest, ARecordWithAnImpossibleLengthEndsTheFile) {
  const TemporaryDirectory directory;
  const std::string file = MakeMcap({{"/events", kPackets, {MakePacket({1, EventAt(5, 7)})}}});
  constexpr size_t kTailBytes = 13 + 29 + 8;  // DataEnd, Footer, magic
  const std::string message_record(9, '\x05');
  const auto recording =
      ReadAll(WriteBytes(directory.File("a"), file.substr(0, file.size() - kTailBytes) + message_record));
  ASSERT_TRUE(recording.ok()) << recording.status();
  EXPECT_THAT(recording->events, ElementsAre(Event{5, 7, 2, 1}));
  EXPECT_EQ(recording->num_skipped("records above 64 MiB"), 1);
  EXPECT_EQ(recording->num_skipped("truncated end: messages may be missing"), 1);
}

std::string BagErrorOf(const std::string& path) {
  const auto reader = OpenRecording(path);
  return reader.ok() ? "" : std::string(reader.status().message());
}

TEST(BagTest, OneOfSeveralTopicsIsChosen) {
  const TemporaryDirectory directory;
  const TestTopic left = {"/left", kPackets, {MakePacket({1, EventAt(5, 7)})}};
  const TestTopic right = {"/right/events", kPackets, {MakePacket({1, EventAt(6, 8)})}};
  const TestTopic text = {"/chatter", "std_msgs/msg/String", {"hello"}};
  const std::string mcap = WriteBytes(directory.File("a.mcap"), MakeMcap({left, text, right}));
  const std::string sqlite = WriteSqliteBag(directory.File("a.db3"), {text, left, right});
  for (const std::string& path : {mcap, sqlite}) {
    EXPECT_THAT(BagErrorOf(path),
                HasSubstr("has several topics with events; choose one as " + path + "#TOPIC: /left, /right/events"));
    EXPECT_THAT(ReadAll(path + "#/right/events")->events, ElementsAre(Event{6, 8, 2, 1}));
    EXPECT_THAT(BagErrorOf(path + "#/chatter"), HasSubstr("has no topic /chatter with events"));
  }
  EXPECT_THAT(BagErrorOf(WriteBytes(directory.File("b"), MakeMcap({text}))),
              HasSubstr("has no topic with events (event_camera_msgs/EventPacket or dvs_msgs/EventArray); its topics: "
                        "/chatter"));
}

TEST(BagTest, TheTopicsOfADamagedFileAreBounded) {
  const TemporaryDirectory directory;
  std::vector<TestTopic> topics = {{std::string(5000, 'x'), "std_msgs/msg/String", {"hello"}}};
  for (int i = 0; i < 30; ++i) topics.push_back({absl::StrCat("/t", i), "std_msgs/msg/String", {"hello"}});
  const std::string expected =
      "its topics: /t0, /t1, /t2, /t3, /t4, /t5, /t6, /t7, /t8, /t9, /t10, /t11, /t12, /t13, "
      "/t14, /t15, /t16, /t17, /t18, /t19 and ";
  EXPECT_THAT(BagErrorOf(WriteBytes(directory.File("a.mcap"), MakeMcap(topics))), HasSubstr(expected + "10 others"));
  const std::string path = WriteSqliteBag(directory.File("a.db3"), topics);
  EXPECT_THAT(BagErrorOf(path), HasSubstr(expected + "10 others"));
  const auto run = [&path](const char* sql) {
    sqlite3* database = nullptr;
    EXPECT_EQ(sqlite3_open(path.c_str(), &database), SQLITE_OK);
    EXPECT_EQ(sqlite3_exec(database, sql, nullptr, nullptr, nullptr), SQLITE_OK) << sqlite3_errmsg(database);
    sqlite3_close(database);
  };
  run("WITH RECURSIVE n(i) AS (SELECT 100 UNION ALL SELECT i + 1 FROM n WHERE i < 5000) "
      "INSERT INTO topics SELECT i, '/t' || i, 'a', 'cdr' FROM n");
  EXPECT_THAT(BagErrorOf(path), HasSubstr(expected + "979 others")) << "1000 rows, one of them with a long name";
  run("DROP TABLE topics; CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT AS "
      "(hex(zeroblob(1000000))), "
      "serialization_format TEXT); INSERT INTO topics VALUES(1, '/t', 'cdr')");
  EXPECT_THAT(BagErrorOf(path), HasSubstr("cannot be read as a rosbag2 file: string or blob too big"));
}

TEST(BagTest, OtherEncodingsAreRefused) {
  const TemporaryDirectory directory;
  PacketFields fields = {1, "abc", "libcaer_cmp"};
  const TestTopic topic = {"/events", kPackets, {MakePacket(fields)}};
  EXPECT_THAT(BagErrorOf(WriteBytes(directory.File("a"), MakeMcap({topic}))),
              HasSubstr("has packets in the encoding 'libcaer_cmp'; only evt3 is read"));
  const TestTopic empty = {"/events", kPackets, {""}};
  EXPECT_THAT(BagErrorOf(WriteBytes(directory.File("a"), MakeMcap({empty}))), HasSubstr("has no packet with events"));
}

// The sums are those that event_camera_codecs, the decoder of the program that recorded the file, expects in its tests
// (tests/data/evt3_packets_first_3/SOURCE.txt).
TEST(BagTest, APublicRecordingHasTheSumsOfItsOwnDecoder) {
  const auto recording = ReadAll(FindTestData("evt3_packets_first_3/packets.db3"));
  ASSERT_TRUE(recording.ok()) << recording.status();
  uint64_t t_us = 0, x = 0, y = 0, on = 0;
  for (const Event& event : recording->events) {
    t_us += event.t_us;
    x += event.x;
    y += event.y;
    on += event.polarity;
  }
  EXPECT_EQ(recording->events.size(), 2037u);
  EXPECT_EQ(t_us, 29'004'181'874u);
  EXPECT_EQ(x, 897'009u);
  EXPECT_EQ(y, 773'502u);
  EXPECT_EQ(on, 1028u);
  EXPECT_EQ(recording->header.geometry, (SensorGeometry{1280, 720}));
  EXPECT_THAT(recording->skipped, IsEmpty());
}

TEST(BagTest, EventsMissingAtTheEndOfAnArrayAreCounted) {
  CdrMessage message(true);
  message.Add(int32_t{0});
  message.Add(uint32_t{0});
  message.AddText("");
  message.Add(uint32_t{480});
  message.Add(uint32_t{640});
  message.Add(uint32_t{1000});
  for (const uint16_t x : {3, 4}) {
    message.Add(x);
    message.Add(uint16_t{2});
    message.Add(int32_t{1});
    message.Add(uint32_t{1500});
    message.Add(uint8_t{1});
  }
  std::vector<SourceEvent> events;
  const auto array = ParseEventArray(message.Take(), events);
  ASSERT_TRUE(array.has_value());
  EXPECT_EQ(array->num_missing, 998);
  ASSERT_EQ(events.size(), 2u);
  EXPECT_EQ(events[1].x, 4);
  EXPECT_EQ(events[1].t_us, 1000002);
}

}  // namespace
}  // namespace evpose::client

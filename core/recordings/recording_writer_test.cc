// SPDX-License-Identifier: Apache-2.0
#include "core/recordings/recording_writer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>
#include <fstream>

#include "core/events/events_testing.h"
#include "core/recordings/recording_reader.h"

namespace evpose {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

size_t NumFiles(const TemporaryDirectory& directory) {
  const std::filesystem::directory_iterator files(directory.path());
  return static_cast<size_t>(std::distance(begin(files), end(files)));
}

std::vector<Event> SomeEvents(size_t count) {
  std::vector<Event> events;
  for (size_t i = 0; i < count; ++i) {
    events.push_back({static_cast<int64_t>(3 * i), static_cast<uint16_t>(i % 640), static_cast<uint16_t>(i % 480),
                      static_cast<uint8_t>(i % 2)});
  }
  return events;
}

TEST(RecordingWriterTest, ARecordingReadsBack) {
  const TemporaryDirectory directory;
  const std::vector<Event> events = SomeEvents(10000);
  for (const Encoding encoding :
       {Encoding::kEvt3, Encoding::kEvt21, Encoding::kEvt2, Encoding::kDat, Encoding::kFlat64}) {
    const std::string path = directory.File(std::string(EncodingName(encoding)) + ".raw");
    const auto writer = RecordingWriter::Create(path, encoding, kVga, 1700000000000000);
    ASSERT_TRUE(writer.ok()) << writer.status();
    for (size_t i = 0; i < events.size(); i += 1000) {
      ASSERT_TRUE((*writer)->Write(absl::MakeConstSpan(events).subspan(i, 1000)).ok());
    }
    EXPECT_FALSE(std::filesystem::exists(path)) << "the file does not exist before Close()";
    ASSERT_TRUE((*writer)->Close().ok());
    const auto reader = RecordingReader::Open(path);
    ASSERT_TRUE(reader.ok()) << reader.status();
    EXPECT_EQ((*reader)->header().encoding, encoding);
    EXPECT_EQ((*reader)->header().geometry, kVga);
    EXPECT_EQ((*reader)->header().time_offset_us, 1700000000000000);
    std::vector<uint8_t> bytes(static_cast<size_t>((*reader)->data_size_bytes()));
    size_t size = 0;
    while (size < bytes.size()) size += (*reader)->Read(absl::MakeSpan(bytes).subspan(size)).value();
    EXPECT_THAT(DecodeAll(encoding, kVga, bytes).out.events, ::testing::ElementsAreArray(events));
  }
  EXPECT_EQ(NumFiles(directory), 5);
}

TEST(RecordingWriterTest, NothingIsLeftWithoutClose) {
  const TemporaryDirectory directory;
  {
    const auto writer = RecordingWriter::Create(directory.File("a.raw"), Encoding::kEvt3, kVga);
    ASSERT_TRUE(writer.ok());
    ASSERT_TRUE((*writer)->Write(SomeEvents(10)).ok());
  }
  EXPECT_EQ(NumFiles(directory), 0);
}

TEST(RecordingWriterTest, ErrorsNameThePath) {
  const TemporaryDirectory directory;
  const auto error = [](const std::string& path, Encoding encoding, SensorGeometry geometry, absl::StatusCode code) {
    const auto writer = RecordingWriter::Create(path, encoding, geometry);
    EXPECT_EQ(writer.status().code(), code) << writer.status();
    EXPECT_THAT(std::string(writer.status().message()), StartsWith(path));
  };
  error(directory.File("missing/a.raw"), Encoding::kEvt3, kVga, absl::StatusCode::kNotFound);
  error(directory.path(), Encoding::kEvt3, kVga, absl::StatusCode::kInvalidArgument);
  error(directory.File("a.raw"), Encoding::kEvt3, {0, 0}, absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(NumFiles(directory), 0);
}

TEST(RecordingWriterTest, WrongEventsNameThePathAndAreNotWritten) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("a.raw");
  const auto writer = RecordingWriter::Create(path, Encoding::kEvt3, kVga);
  ASSERT_TRUE(writer.ok());
  const Event outside{5, 640, 0, 0};
  const absl::Status status = (*writer)->Write({&outside, 1});
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(status.message(), path + ": event 0 at x 640, y 0 lies outside the sensor of 640x480 pixels");
  ASSERT_TRUE((*writer)->Close().ok());
  EXPECT_EQ(std::filesystem::file_size(path), MakeRawHeader(Encoding::kEvt3, kVga).size());
  EXPECT_EQ((*writer)->Write({}).code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ((*writer)->Close().code(), absl::StatusCode::kFailedPrecondition);
}

// A limit on the size of files has the same effect as a full disk.
TEST(RecordingWriterTest, AFullDiskIsReportedAndLeavesNothing) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("a.raw");
  std::ofstream(path) << "what stood there";
  const auto previous_handler = std::signal(SIGXFSZ, SIG_IGN);
  rlimit previous_limit;
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &previous_limit), 0);
  const rlimit limit = {20000, previous_limit.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &limit), 0);
  absl::Status status;
  {
    const auto writer = RecordingWriter::Create(path, Encoding::kEvt3, kVga);
    ASSERT_TRUE(writer.ok());
    status = (*writer)->Write(SomeEvents(100000));
    if (status.ok()) status = (*writer)->Close();
  }
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &previous_limit), 0);
  std::signal(SIGXFSZ, previous_handler);
  EXPECT_FALSE(status.ok());
  EXPECT_THAT(std::string(status.message()), HasSubstr("a.raw: writing failed"));
  EXPECT_EQ(NumFiles(directory), 1);
  EXPECT_EQ(std::filesystem::file_size(path), 16);
}

}  // namespace
}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0
#include "core/recordings/recording_reader.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/eventfd.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <functional>
#include <thread>
#include <utility>

#include "core/base/status_macros.h"
#include "core/events/encoder.h"
#include "core/events/events_testing.h"
#include "core/recordings/byte_source.h"

namespace evpose {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

const std::string kHeader = MakeRawHeader(Encoding::kEvt3, kVga);

void Append(const std::string& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary | std::ios::app) << bytes;
}

// Reads to the end in pieces of `piece` bytes.
std::string ReadAll(RecordingReader& reader, size_t piece) {
  std::string text;
  std::vector<uint8_t> buffer(piece);
  while (true) {
    const auto size = reader.Read(absl::MakeSpan(buffer));
    EXPECT_TRUE(size.ok()) << size.status();
    if (!size.ok() || *size == 0) return text;
    text.append(reinterpret_cast<const char*>(buffer.data()), *size);
  }
}

// The descriptors of a pipe; Close() or the destructor closes the writing end.
class Pipe {
 public:
  Pipe() { EXPECT_EQ(pipe2(descriptors_, O_CLOEXEC), 0); }
  ~Pipe() { Close(); }
  int reading_end() const { return descriptors_[0]; }
  void Write(const std::string& bytes) {
    EXPECT_EQ(write(descriptors_[1], bytes.data(), bytes.size()), static_cast<ssize_t>(bytes.size()));
  }
  void Close() {
    if (descriptors_[1] >= 0) close(descriptors_[1]);
    descriptors_[1] = -1;
  }

 private:
  int descriptors_[2] = {-1, -1};
};

TEST(RecordingReaderTest, ReadsAFile) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("a.raw");
  std::string data;
  for (int i = 0; i < 20000; ++i) data.push_back(static_cast<char>(i * 7));
  Append(path, kHeader + data);
  for (const size_t piece : {1u, 100u, 100000u}) {
    const auto reader = RecordingReader::Open(path);
    ASSERT_TRUE(reader.ok()) << reader.status();
    EXPECT_EQ((*reader)->header().geometry, kVga);
    EXPECT_EQ((*reader)->data_size_bytes(), 20000);
    EXPECT_EQ(ReadAll(**reader, piece), data);
    EXPECT_EQ(ReadAll(**reader, piece), "") << "the end is reported again";
  }
}

TEST(RecordingReaderTest, ErrorsNameThePath) {
  const TemporaryDirectory directory;
  const auto error = [&](const std::string& name, absl::StatusCode code, const std::string& message) {
    const auto reader = RecordingReader::Open(directory.File(name));
    EXPECT_EQ(reader.status().code(), code) << reader.status();
    EXPECT_THAT(std::string(reader.status().message()), StartsWith(directory.File(name) + ": "));
    EXPECT_THAT(std::string(reader.status().message()), HasSubstr(message));
  };
  error("missing.raw", absl::StatusCode::kNotFound, "cannot be read: No such file");
  error("", absl::StatusCode::kInvalidArgument, "is a directory, not a recording");
  Append(directory.File("empty.raw"), "");
  error("empty.raw", absl::StatusCode::kInvalidArgument, "is empty");
  Append(directory.File("header.raw"), kHeader);
  error("header.raw", absl::StatusCode::kInvalidArgument, "has a header but no events");
  Append(directory.File("cut.raw"), kHeader.substr(0, kHeader.size() - 3));
  error("cut.raw", absl::StatusCode::kInvalidArgument, "has a header but no events");
  Append(directory.File("wrong.raw"), "% evt 3.0\n% evt 2.0\nabcd");
  error("wrong.raw", absl::StatusCode::kInvalidArgument, "header line 2: says EVT2, but line 1 says EVT3");
  Append(directory.File("noise.raw"), "abcd");
  error("noise.raw", absl::StatusCode::kInvalidArgument, "there is no header");
}

TEST(RecordingReaderTest, UnreadableFile) {
  if (geteuid() == 0) GTEST_SKIP() << "root may read everything";
  const TemporaryDirectory directory;
  const std::string path = directory.File("a.raw");
  Append(path, kHeader + "abcd");
  std::filesystem::permissions(path, std::filesystem::perms::none);
  const auto reader = RecordingReader::Open(path);
  EXPECT_EQ(reader.status().code(), absl::StatusCode::kPermissionDenied);
  EXPECT_THAT(std::string(reader.status().message()), StartsWith(path));
}

absl::StatusOr<std::unique_ptr<RecordingReader>> ReadDescriptor(int descriptor, const std::string& name,
                                                                const RecordingReaderOptions& options = {}) {
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<ByteSource> source, ByteSource::OpenDescriptor(descriptor, name, options));
  return RecordingReader::FromBytes(std::move(source));
}

TEST(RecordingReaderTest, FailedReadsNameTheOffset) {
  const TemporaryDirectory directory;
  // A write-only descriptor of a readable file.
  const int descriptor = open(directory.File("a.raw").c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0600);
  const auto reader = ReadDescriptor(descriptor, "a.raw");
  EXPECT_EQ(reader.status().code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(std::string(reader.status().message()), StartsWith("a.raw: reading failed at byte 0: "));
}

TEST(RecordingReaderTest, ReadsAPipeAsItComes) {
  Pipe pipe;
  pipe.Write(kHeader + "ab");
  auto reader = ReadDescriptor(pipe.reading_end(), "a pipe");
  ASSERT_TRUE(reader.ok()) << reader.status();
  EXPECT_EQ((*reader)->data_size_bytes(), -1);
  std::vector<uint8_t> buffer(100);
  // A read from a live source returns the available bytes without waiting for a full buffer.
  EXPECT_EQ((*reader)->Read(absl::MakeSpan(buffer)).value(), 2);
  pipe.Write("cde");
  EXPECT_EQ((*reader)->Read(absl::MakeSpan(buffer)).value(), 3);
  pipe.Close();
  EXPECT_EQ((*reader)->Read(absl::MakeSpan(buffer)).value(), 0);
}

TEST(RecordingReaderTest, PipesThatEndEarly) {
  for (const auto& [bytes, message] : std::vector<std::pair<std::string, std::string>>{
           {"", "a pipe: is empty"}, {kHeader, "a pipe: has a header but no events"}}) {
    Pipe pipe;
    pipe.Write(bytes);
    pipe.Close();
    EXPECT_EQ(ReadDescriptor(pipe.reading_end(), "a pipe").status().message(), message);
  }
}

TEST(RecordingReaderTest, StopEndsAWaitForAPipe) {
  Pipe pipe;
  pipe.Write(kHeader + "ab");
  int num_questions = 0;
  RecordingReaderOptions options;
  options.stop = [&] { return ++num_questions >= 3; };
  auto reader = ReadDescriptor(pipe.reading_end(), "a pipe", options);
  ASSERT_TRUE(reader.ok());
  EXPECT_EQ(ReadAll(**reader, 100), "ab");
  EXPECT_EQ(num_questions, 3);
}

// `stop` also opens the writing end: the reader calls it before each wait.
TEST(RecordingReaderTest, AWriterOfAPipeWithANameIsWaitedFor) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("pipe.raw");
  ASSERT_EQ(mkfifo(path.c_str(), 0600), 0);
  int num_questions = 0;
  RecordingReaderOptions options;
  options.stop = [&] {
    if (++num_questions == 3) Append(path, kHeader + "ab");
    return false;
  };
  auto reader = RecordingReader::Open(path, options);
  ASSERT_TRUE(reader.ok()) << reader.status();
  EXPECT_EQ(ReadAll(**reader, 100), "ab");
  EXPECT_EQ(num_questions, 3);
  // An interrupt ends the wait.
  options.stop = [&] { return ++num_questions >= 6; };
  EXPECT_EQ(RecordingReader::Open(path, options).status().code(), absl::StatusCode::kCancelled);
  EXPECT_EQ(num_questions, 6);
}

// `stop` also writes to the growing file: the reader calls it before each wait, so that the test needs no clock.
TEST(RecordingReaderTest, FollowsAFileFromItsFirstByteOn) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("growing.raw");
  const std::string data = "a lot of events";
  const std::string contents = kHeader + data;
  Append(path, "");
  size_t written = 0;
  RecordingReaderOptions options;
  options.is_following = true;
  options.stop = [&] {
    if (written == contents.size()) return true;
    Append(path, contents.substr(written, 5));
    written = std::min(written + 5, contents.size());
    return false;
  };
  const auto reader = RecordingReader::Open(path, options);
  ASSERT_TRUE(reader.ok()) << reader.status();
  EXPECT_LT(written, kHeader.size() + 5) << "Open() waits for the header only";
  EXPECT_EQ((*reader)->data_size_bytes(), -1);
  EXPECT_EQ(ReadAll(**reader, 100), data);
  EXPECT_EQ(ReadAll(**reader, 100), "") << "the end is reported again after a stop";
}

TEST(RecordingReaderTest, FollowingCanBeStoppedInTheHeader) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("growing.raw");
  Append(path, "% evt 3.0\n");
  RecordingReaderOptions options;
  options.is_following = true;
  options.stop = [] { return true; };
  const auto reader = RecordingReader::Open(path, options);
  EXPECT_EQ(reader.status().code(), absl::StatusCode::kCancelled);
  EXPECT_EQ(reader.status().message(), path + ": stopped before the end of its header");
}

TEST(RecordingReaderTest, FollowedFileThatShrinksIsAnError) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("growing.raw");
  Append(path, kHeader + "abcd");
  RecordingReaderOptions options;
  options.is_following = true;
  options.stop = [&] {
    std::filesystem::resize_file(path, 5);
    return false;
  };
  const auto reader = RecordingReader::Open(path, options);
  ASSERT_TRUE(reader.ok());
  std::vector<uint8_t> buffer(100);
  EXPECT_EQ((*reader)->Read(absl::MakeSpan(buffer)).value(), 4);
  const auto size = (*reader)->Read(absl::MakeSpan(buffer));
  EXPECT_EQ(size.status().code(), absl::StatusCode::kDataLoss);
  EXPECT_THAT(std::string(size.status().message()), HasSubstr("growing.raw: shrank from"));
}

TEST(RecordingReaderTest, AFileThatChangesWhileItIsReadIsAnError) {
  namespace fs = std::filesystem;
  const TemporaryDirectory directory;
  const std::string path = directory.File("a.raw");
  const std::string contents = kHeader + std::string(20'000, 'a');
  const auto error_after = [&](const std::function<void()>& change) {
    fs::remove(path);
    Append(path, contents);
    const auto reader = RecordingReader::Open(path);
    EXPECT_TRUE(reader.ok()) << reader.status();
    std::vector<uint8_t> buffer(4096);
    EXPECT_TRUE((*reader)->Read(absl::MakeSpan(buffer)).ok());
    change();
    absl::StatusOr<size_t> size = size_t{1};
    while (size.ok() && *size > 0) size = (*reader)->Read(absl::MakeSpan(buffer));
    return size.status();
  };
  EXPECT_TRUE(error_after([] {}).ok());
  EXPECT_TRUE(error_after([&] { fs::remove(path); }).ok()) << "it was read to its end";
  const auto expect = [&](const std::function<void()>& change, const std::string& message) {
    const absl::Status status = error_after(change);
    EXPECT_EQ(status.code(), absl::StatusCode::kDataLoss);
    EXPECT_THAT(std::string(status.message()), StartsWith(path + ": changed while it was read: " + message));
  };
  const std::string size = "its size was " + std::to_string(contents.size()) + " bytes and is ";
  expect([&] { fs::resize_file(path, 9'000); }, size + "9000");
  expect([&] { Append(path, "b"); }, size + std::to_string(contents.size() + 1));
  expect([&] { fs::last_write_time(path, fs::last_write_time(path) + std::chrono::seconds(1)); }, "it was written to");
  expect(
      [&] {
        Append(directory.File("other.raw"), contents);
        fs::rename(directory.File("other.raw"), path);
      },
      "another file has replaced it");
}

TEST(RecordingReaderTest, AClosedStandardInputIsAnError) {
  const int before = dup(STDIN_FILENO);
  const int no_file = eventfd(0, 0);
  ASSERT_EQ(dup2(no_file, STDIN_FILENO), STDIN_FILENO);
  close(no_file);
  const absl::Status status = RecordingReader::Open("-").status();
  if (before < 0) {
    close(STDIN_FILENO);
  } else {
    dup2(before, STDIN_FILENO);
    close(before);
  }
  EXPECT_EQ(status, absl::InvalidArgumentError("standard input: is closed"));
}

TEST(RecordingReaderTest, FollowsAWriterInAnotherThread) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("growing.raw");
  Append(path, kHeader);
  std::atomic<bool> is_written = false;
  RecordingReaderOptions options;
  options.is_following = true;
  // The bytes of the call before count: the reader has read once more in between.
  bool stop_next = false;
  options.stop = [&] { return std::exchange(stop_next, is_written.load()); };
  const auto reader = RecordingReader::Open(path, options);
  ASSERT_TRUE(reader.ok());
  std::string expected;
  for (int i = 0; i < 1000; ++i) expected += std::to_string(i);
  std::thread writer([&] {
    for (size_t i = 0; i < expected.size(); i += 100) Append(path, expected.substr(i, 100));
    is_written = true;
  });
  EXPECT_EQ(ReadAll(**reader, 64), expected);
  writer.join();
}

}  // namespace
}  // namespace evpose

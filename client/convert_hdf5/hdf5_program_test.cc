// SPDX-License-Identifier: Apache-2.0

// evpose-hdf5 behind evpose's reader and writer of recordings.
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <utility>
#include <vector>

#include "client/containers/containers_testing.h"
#include "client/containers/hdf5/event_pipe.h"
#include "client/containers/hdf5_source.h"
#include "client/containers/open_recording.h"
#include "client/convert_hdf5/hdf5_testing.h"
#include "core/base/environment_testing.h"
#include "core/base/temporary_directory_testing.h"
#include "core/recordings/chunker.h"
#include "tests/data/test_data.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAre;
using ::testing::ElementsAreArray;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

class Hdf5ProgramTest : public testing::Test {
 protected:
  std::string path() const { return directory_.File("a.hdf5"); }

  // The program is found in the PATH, as an installed one.
  const ScopedEnvironmentVariable programs_{
      "PATH", std::filesystem::path(EVPOSE_HDF5_PROGRAM).parent_path().string() + ":" + std::getenv("PATH")};
  const TemporaryDirectory directory_;
};

TEST_F(Hdf5ProgramTest, WritingAndReadingIsExactTriggersIncluded) {
  const std::vector<Event> events = TestEvents(100'000);
  const std::vector<Trigger> triggers = {{100, 0, 1}, {300'001, 3, 0}, {9'000'000, 200, 1}};
  const auto output = Hdf5Output::Create(path(), {{1280, 720}, 77, 6384}).value();
  ASSERT_TRUE(output->Write(absl::MakeConstSpan(triggers)).ok());
  ASSERT_TRUE(output->Write(absl::MakeConstSpan(events)).ok());
  ASSERT_EQ(output->Close(), absl::OkStatus());
  const ReadRecording read = ReadAll(path()).value();
  EXPECT_EQ(read.header.container, "Metavision HDF5 (ECF)");
  EXPECT_EQ(read.header.geometry, (SensorGeometry{1280, 720}));
  EXPECT_TRUE(read.header.geometry_is_stated);
  EXPECT_EQ(read.header.time_offset_us, 77);
  EXPECT_EQ(read.header.metavision_zero_us, 6384);
  EXPECT_THAT(read.events, ElementsAreArray(events));
  EXPECT_THAT(read.triggers, ElementsAreArray(triggers));
  EXPECT_THAT(read.skipped, IsEmpty());
}

// A limit on the size of files has the same effect as a full disk. The program's standard error is a file, too.
TEST_F(Hdf5ProgramTest, AFullDiskIsAnErrorAtEveryPointOfTheFile) {
  const std::vector<Event> events = TestEvents(100'000);
  std::signal(SIGXFSZ, SIG_IGN);
  rlimit before;
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  for (const rlim_t bytes : {500, 1'000, 3'000, 10'000, 30'000, 60'000, 100'000, 200'000}) {
    const rlimit limit = {.rlim_cur = bytes, .rlim_max = before.rlim_max};
    ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &limit), 0);
    absl::Status status;
    if (auto output = Hdf5Output::Create(path(), {{1280, 720}, 0}); output.ok()) {
      status = (*output)->Write(absl::MakeConstSpan(events));
      if (status.ok()) status = (*output)->Close();
    } else {
      status = output.status();
    }
    setrlimit(RLIMIT_FSIZE, &before);
    EXPECT_EQ(status.message(), path() + ": cannot be written: File too large") << bytes << " bytes";
    EXPECT_TRUE(std::filesystem::is_empty(directory_.path())) << bytes << " bytes";
  }
}

// Written by h5py with Prophesee's filter.
TEST_F(Hdf5ProgramTest, AFileOfPropheseesFilterHasItsEvents) {
  const ReadRecording read = ReadAll(FindTestData("containers/metavision_ecf.hdf5")).value();
  EXPECT_EQ(read.header.container, "Metavision HDF5 (ECF)");
  EXPECT_EQ(read.header.geometry, (SensorGeometry{346, 260}));
  EXPECT_THAT(read.events, ElementsAreArray(FileEvents()));
  EXPECT_THAT(read.triggers, ElementsAre(Trigger{5100, 0, 1}, Trigger{5200, 0, 0}, Trigger{9000, 3, 1}));
  EXPECT_THAT(read.skipped, IsEmpty());
}

// Written by h5py, with the time shift of OpenEB: Metavision shows the first event at 0.
TEST_F(Hdf5ProgramTest, AFileWithATimeShiftKeepsItsTimesAndHasTheZeroOfMetavision) {
  const ReadRecording read = ReadAll(FindTestData("containers/metavision_time_shift.hdf5")).value();
  EXPECT_THAT(read.events, ElementsAreArray(FileEvents()));
  EXPECT_EQ(read.header.metavision_zero_us, read.events.front().t_us);
  EXPECT_EQ(ReadAll(FindTestData("containers/metavision_ecf.hdf5"))->header.metavision_zero_us, 0);
  EXPECT_EQ(ReadAll(FindTestData("containers/dsec.hdf5"))->header.metavision_zero_us, std::nullopt);
}

// Times beyond the clock of FLAT64 are shifted to the first event, and the zero of Metavision with them.
TEST_F(Hdf5ProgramTest, TheZeroOfMetavisionIsOnTheClockOfTheEvents) {
  constexpr int64_t kFirstUs = 1'700'000'000'000'000;
  ASSERT_TRUE(WriteHdf5(path(), {.header = {"", {640, 480}, 0, kFirstUs - 300}, .events = {{kFirstUs, 1, 2, 1}}}).ok());
  const ReadRecording read = ReadAll(path()).value();
  EXPECT_THAT(read.events, ElementsAre(Event{0, 1, 2, 1}));
  EXPECT_EQ(read.header.time_offset_us, kFirstUs);
  EXPECT_EQ(read.header.metavision_zero_us, -300);
}

// The size of the sensor is not in such files; that of the caller's camera is taken.
TEST_F(Hdf5ProgramTest, AFileOfTheShapeOfDsecHasItsEvents) {
  const std::string file = FindTestData("containers/dsec.hdf5");
  const ReadRecording read = ReadAll(file, {.geometry = SensorGeometry{640, 480}}).value();
  EXPECT_EQ(read.header.container, "HDF5 (DSEC)");
  EXPECT_EQ(read.header.geometry, (SensorGeometry{640, 480}));
  EXPECT_EQ(read.header.time_offset_us, 49'599'300'523);
  EXPECT_THAT(read.events, ElementsAreArray(FileEvents()));
  EXPECT_EQ(ReadAll(file)->header.geometry, (SensorGeometry{346, 260}));
}

TEST_F(Hdf5ProgramTest, ErrorsOfTheProgramHaveThePath) {
  ASSERT_TRUE(WriteHdf5(path(), {.header = {"", {640, 480}, 0}}).ok());
  EXPECT_THAT(OpenRecording(path()).status().message(), HasSubstr("a.hdf5: has no event"));
  std::filesystem::resize_file(path(), 600);
  EXPECT_THAT(OpenRecording(path()).status().message(), HasSubstr("a.hdf5: is no HDF5 file, or is damaged"));
  const auto output = Hdf5Output::Create(directory_.File("b.hdf5"), {{640, 480}, 0}).value();
  ASSERT_TRUE(output->Write(absl::MakeConstSpan(std::vector<Event>{{1, 4000, 0, 0}})).ok());
  EXPECT_THAT(output->Close().message(), HasSubstr("b.hdf5: event 0 of a chunk (x 4000"));
  EXPECT_FALSE(std::filesystem::exists(directory_.File("b.hdf5")));
}

// The file is much larger than the pipe to the program, so that its end is read after the change.
TEST_F(Hdf5ProgramTest, AFileThatChangesWhileItIsReadIsAnError) {
  ASSERT_TRUE(WriteHdf5(path(), {.header = {"", {1280, 720}, 0}, .events = TestEvents(1'000'000)}).ok());
  const auto reader = OpenRecording(path()).value();
  std::filesystem::last_write_time(path(), std::filesystem::last_write_time(path()) + std::chrono::seconds(1));
  Chunker chunker(*reader, {});
  absl::StatusOr<EventChunkBytes> chunk = chunker.Next();
  while (chunk.ok() && !chunk->bytes.empty()) chunk = chunker.Next();
  EXPECT_THAT(chunk.status().message(), HasSubstr("a.hdf5: changed while it was read: it was written to"));
}

TEST_F(Hdf5ProgramTest, AnOutputThatIsNotClosedLeavesNoFile) {
  {
    const auto output = Hdf5Output::Create(path(), {{640, 480}, 0}).value();
    ASSERT_TRUE(output->Write(absl::MakeConstSpan(TestEvents(100'000))).ok());
  }
  EXPECT_FALSE(std::filesystem::exists(path()));
}

// An evpose-hdf5 that writes a file and has created its temporary file.
class WritingProgram {
 public:
  explicit WritingProgram(const std::string& path) {
    int ends[2];
    EXPECT_EQ(pipe2(ends, O_CLOEXEC), 0);
    pipe_ = ends[1];
    pid_ = fork();
    if (pid_ == 0) {
      dup2(ends[0], STDIN_FILENO);
      for (const int each : {SIGINT, SIGTERM, SIGHUP}) std::signal(each, SIG_DFL);
      execl(EVPOSE_HDF5_PROGRAM, EVPOSE_HDF5_PROGRAM, "write", path.c_str(), nullptr);
      _exit(127);
    }
    close(ends[0]);
    std::vector<uint8_t> bytes;
    AppendPipeHeader({.format = "", .geometry = {640, 480}, .time_offset_us = 0}, bytes);
    AppendPipeEvents(TestEvents(100), bytes);
    EXPECT_EQ(write(pipe_, bytes.data(), bytes.size()), static_cast<ssize_t>(bytes.size()));
    // The program has set its signals before it writes.
    while (!std::filesystem::exists(path + ".partial") && !HasEnded()) usleep(1'000);
  }
  ~WritingProgram() {
    ClosePipe();
    if (!HasEnded()) kill(pid_, SIGKILL);
    (void)Wait();
  }

  void Signal(int number) const { kill(pid_, number); }
  void ClosePipe() {
    if (pipe_ >= 0) close(std::exchange(pipe_, -1));
  }
  bool HasEnded() {
    has_ended_ = has_ended_ || waitpid(pid_, &status_, WNOHANG) == pid_;
    return has_ended_;
  }
  int Wait() {
    if (!has_ended_) waitpid(pid_, &status_, 0);
    has_ended_ = true;
    return status_;
  }

 private:
  int pipe_ = -1;
  pid_t pid_ = -1;
  int status_ = 0;
  bool has_ended_ = false;
};

TEST_F(Hdf5ProgramTest, ARequestToEndLeavesNoFile) {
  WritingProgram program(path());
  program.Signal(SIGTERM);
  const int status = program.Wait();
  EXPECT_TRUE(WIFSIGNALED(status) && WTERMSIG(status) == SIGTERM) << status;
  EXPECT_TRUE(std::filesystem::is_empty(directory_.path()));
}

// A signal that ended the program would have ended it before it read the end of the pipe.
TEST_F(Hdf5ProgramTest, SignalsOfTheTerminalAreIgnoredAndTheEndOfThePipeLeavesNoFile) {
  for (const int number : {SIGINT, SIGHUP}) {
    WritingProgram program(path());
    program.Signal(number);
    program.ClosePipe();
    const int status = program.Wait();
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 1) << status;
    EXPECT_TRUE(std::filesystem::is_empty(directory_.path())) << number;
  }
}

// Whatever a damaged file does to the HDF5 library, this process gets an error or events.
TEST_F(Hdf5ProgramTest, ChangedFilesGiveAnErrorOrACount) {
  ASSERT_TRUE(WriteHdf5(path(), {.header = {"", {1280, 720}, 0}, .events = TestEvents(20'000)}).ok());
  std::ifstream file(path(), std::ios::binary);
  const std::string whole{std::istreambuf_iterator<char>(file), {}};
  int num_errors = 0;
  for (size_t i = 0; i < 60; ++i) {
    std::string changed = whole;
    // Most of the structure is at the beginning.
    for (size_t at = i % 2 == 0 ? i * 37 : whole.size() * i / 60; at < std::min(whole.size(), (i + 1) * 41); at += 97) {
      changed[at] = static_cast<char>(changed[at] ^ 0x5a);
    }
    changed[whole.size() * i / 60] ^= 0x55;
    std::ofstream(path(), std::ios::binary) << changed;
    const auto read = ReadAll(path());
    if (read.ok()) {
      EXPECT_LE(read->events.size(), 20'000u);
    } else {
      ++num_errors;
      EXPECT_THAT(read.status().message(), HasSubstr(path()));
    }
  }
  EXPECT_GT(num_errors, 0);
}

TEST_F(Hdf5ProgramTest, ANameThatBeginsWithAMinusIsNoOption) {
  ASSERT_TRUE(WriteHdf5(path(), {.header = {"", {640, 480}, 0}, .events = TestEvents(10)}).ok());
  const std::filesystem::path before = std::filesystem::current_path();
  std::filesystem::current_path(std::filesystem::path(path()).parent_path());
  std::filesystem::rename("a.hdf5", "-a.hdf5");
  const auto read = ReadAll("-a.hdf5");
  std::filesystem::current_path(before);
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(read->events.size(), 10u);
}

TEST_F(Hdf5ProgramTest, WithoutTheProgramTheErrorNamesThePackage) {
  const ScopedEnvironmentVariable no_programs("PATH", "/nowhere");
  ASSERT_TRUE(WriteHdf5(path(), {.header = {"", {640, 480}, 0}, .events = TestEvents(10)}).ok());
  const auto recording = OpenRecording(path());
  if (recording.ok()) GTEST_SKIP() << "the program is beside this one";
  EXPECT_THAT(recording.status().message(), HasSubstr("install the Debian package evpose-hdf5"));
}

}  // namespace
}  // namespace evpose::client

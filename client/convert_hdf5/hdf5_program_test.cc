// SPDX-License-Identifier: Apache-2.0

// evpose-hdf5 behind evpose's reader and writer of recordings.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "client/containers/hdf5_source.h"
#include "client/containers/open_recording.h"
#include "client/convert_hdf5/hdf5_testing.h"
#include "core/base/temporary_directory.h"
#include "core/events/event_reader.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAreArray;
using ::testing::HasSubstr;

class Hdf5ProgramTest : public testing::Test {
 protected:
  // The program is found in the PATH, as an installed one.
  static void SetUpTestSuite() {
    const std::string folder = std::filesystem::path(EVPOSE_HDF5_PROGRAM).parent_path().string();
    setenv("PATH", (folder + ":" + std::getenv("PATH")).c_str(), 1);
  }
  std::string path() const { return directory_.File("a.hdf5"); }

  const TemporaryDirectory directory_;
};

struct ReadEvents {
  std::vector<Event> events;
  std::vector<Trigger> triggers;
};

absl::StatusOr<ReadEvents> ReadAllOf(RecordingReader& recording) {
  absl::StatusOr<EventReader> reader = EventReader::Make(recording);
  ReadEvents all;
  while (true) {
    const absl::StatusOr<bool> has_more = reader->Next();
    if (!has_more.ok()) return has_more.status();
    if (!*has_more) return all;
    const DecodedEvents& decoded = reader->decoded();
    all.events.insert(all.events.end(), decoded.events.begin(), decoded.events.end());
    all.triggers.insert(all.triggers.end(), decoded.triggers.begin(), decoded.triggers.end());
  }
}

TEST_F(Hdf5ProgramTest, WritingAndReadingIsExactTriggersIncluded) {
  const std::vector<Event> events = TestEvents(100'000);
  const std::vector<Trigger> triggers = {{100, 0, 1}, {300'001, 3, 0}, {9'000'000, 200, 1}};
  const auto output = Hdf5Output::Create(path(), {1280, 720}, 77).value();
  ASSERT_TRUE(output->Write(absl::MakeConstSpan(triggers)).ok());
  ASSERT_TRUE(output->Write(absl::MakeConstSpan(events)).ok());
  ASSERT_EQ(output->Close(), absl::OkStatus());
  const auto recording = OpenRecording(path()).value();
  EXPECT_EQ(recording->header().container, "Metavision HDF5 (ECF)");
  EXPECT_EQ(recording->header().geometry, (SensorGeometry{1280, 720}));
  EXPECT_TRUE(recording->header().geometry_is_stated);
  EXPECT_EQ(recording->header().time_offset_us, 77);
  const ReadEvents read = ReadAllOf(*recording).value();
  EXPECT_THAT(read.events, ElementsAreArray(events));
  EXPECT_THAT(read.triggers, ElementsAreArray(triggers));
  EXPECT_TRUE(recording->skipped().empty());
}

TEST_F(Hdf5ProgramTest, ErrorsOfTheProgramHaveThePath) {
  ASSERT_TRUE(WriteHdf5(path(), {.header = {"", {640, 480}, 0}}).ok());
  EXPECT_THAT(OpenRecording(path()).status().message(), HasSubstr("a.hdf5: has no event"));
  std::filesystem::resize_file(path(), 600);
  EXPECT_THAT(OpenRecording(path()).status().message(), HasSubstr("a.hdf5: is no HDF5 file, or is damaged"));
  const auto output = Hdf5Output::Create(directory_.File("b.hdf5"), {640, 480}, 0).value();
  ASSERT_TRUE(output->Write(absl::MakeConstSpan(std::vector<Event>{{1, 4000, 0, 0}})).ok());
  EXPECT_THAT(output->Close().message(), HasSubstr("b.hdf5: event 0 of a chunk (x 4000"));
  EXPECT_FALSE(std::filesystem::exists(directory_.File("b.hdf5")));
}

TEST_F(Hdf5ProgramTest, AnOutputThatIsNotClosedLeavesNoFile) {
  {
    const auto output = Hdf5Output::Create(path(), {640, 480}, 0).value();
    ASSERT_TRUE(output->Write(absl::MakeConstSpan(TestEvents(100'000))).ok());
  }
  EXPECT_FALSE(std::filesystem::exists(path()));
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
    const auto recording = OpenRecording(path());
    if (!recording.ok()) {
      ++num_errors;
      EXPECT_FALSE(recording.status().message().empty());
      continue;
    }
    const auto read = ReadAllOf(**recording);
    if (read.ok()) EXPECT_LE(read->events.size(), 20'000u);
  }
  EXPECT_GT(num_errors, 0);
}

TEST_F(Hdf5ProgramTest, WithoutTheProgramTheErrorNamesThePackage) {
  const std::string former = std::getenv("PATH");
  setenv("PATH", "/nowhere", 1);
  ASSERT_TRUE(WriteHdf5(path(), {.header = {"", {640, 480}, 0}, .events = TestEvents(10)}).ok());
  const auto recording = OpenRecording(path());
  setenv("PATH", former.c_str(), 1);
  if (recording.ok()) GTEST_SKIP() << "the program is beside this one";
  EXPECT_THAT(recording.status().message(), HasSubstr("install the Debian package evpose-hdf5"));
}

}  // namespace
}  // namespace evpose::client

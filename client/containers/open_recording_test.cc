// SPDX-License-Identifier: Apache-2.0
#include "client/containers/open_recording.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <minizip/zip.h>
#include <unistd.h>

#include <cmath>

#include "client/containers/containers_testing.h"
#include "core/base/output_file.h"
#include "core/base/temporary_directory_testing.h"
#include "core/recordings/recording_writer.h"
#include "tests/data/test_data.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAreArray;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// A file of another program, and what is to be read of it.
struct ForeignFile {
  const char* name;
  const char* container;
  Encoding encoding;
  int64_t offset_us = 0;
  bool states_size = true;
};

class ForeignFileTest : public testing::TestWithParam<ForeignFile> {};

TEST_P(ForeignFileTest, HasItsEvents) {
  const auto recording = ReadAll(FindTestData(std::string("containers/") + GetParam().name));
  ASSERT_TRUE(recording.ok()) << recording.status();
  EXPECT_EQ(recording->header.container, GetParam().container);
  EXPECT_EQ(recording->header.encoding, GetParam().encoding);
  EXPECT_EQ(recording->header.geometry, (SensorGeometry{346, 260}));
  EXPECT_EQ(recording->header.geometry_is_stated, GetParam().states_size);
  EXPECT_EQ(recording->header.time_offset_us, GetParam().offset_us);
  EXPECT_THAT(recording->events, ElementsAreArray(FileEvents(GetParam().offset_us == 0 ? 0 : 5000)));
  EXPECT_THAT(recording->skipped, IsEmpty());
  EXPECT_THAT(recording->losses, IsEmpty());
}

INSTANTIATE_TEST_SUITE_P(
    All, ForeignFileTest,
    testing::Values(ForeignFile{"packets.db3", "rosbag2 SQLite", Encoding::kEvt3},
                    ForeignFile{"packets.mcap", "rosbag2 MCAP", Encoding::kEvt3},
                    ForeignFile{"packets_lz4.mcap", "rosbag2 MCAP", Encoding::kEvt3},
                    ForeignFile{"packets_plain.mcap", "rosbag2 MCAP", Encoding::kEvt3},
                    ForeignFile{"event_arrays.db3", "rosbag2 SQLite", Encoding::kFlat64, 1700000000005000},
                    ForeignFile{"records.npy", "NumPy (x y p t)", Encoding::kFlat64, 0, false},
                    ForeignFile{"rows.npy", "NumPy (t x y p, t in s)", Encoding::kFlat64, 0, false},
                    ForeignFile{"records.npz", "NumPy (x y p t)", Encoding::kFlat64, 0, false},
                    ForeignFile{"lists.npz", "NumPy (x y t p, t in s)", Encoding::kFlat64, 0, false},
                    ForeignFile{"events.aedat4", "AEDAT 4.0 (DAVIS346_00000001)", Encoding::kFlat64, 1700000000005000}),
    [](const auto& test) {
      std::string name = test.param.name;
      std::replace(name.begin(), name.end(), '.', '_');
      return name;
    });

TEST_P(ForeignFileTest, TruncatedOrDamagedItGivesCountsOrAnError) {
  const TemporaryDirectory directory;
  const std::string bytes = ReadFile(FindTestData(std::string("containers/") + GetParam().name), SIZE_MAX).value();
  for (size_t step = 1; step < 24; ++step) {
    const size_t position = bytes.size() * step / 24;
    const auto truncated = ReadAll(WriteBytes(directory.File("truncated"), bytes.substr(0, position)));
    EXPECT_TRUE(!truncated.ok() || truncated->events.size() <= 300u);
    std::string damaged = bytes;
    for (size_t i = 0; i < 8; ++i) damaged[(position + i) % damaged.size()] ^= static_cast<char>(0x55 + i);
    const auto read = ReadAll(WriteBytes(directory.File("damaged"), damaged));
    EXPECT_TRUE(read.ok() || read.status().message().find(directory.path()) == 0) << read.status();
  }
}

std::string ErrorOf(const std::string& path, const OpenRecordingOptions& options = {}) {
  const auto reader = OpenRecording(path, options);
  return reader.ok() ? "" : std::string(reader.status().message());
}

TEST(OpenRecordingTest, RawAndDatAreReadByCore) {
  const TemporaryDirectory directory;
  for (const Encoding encoding : {Encoding::kEvt3, Encoding::kDat}) {
    const std::string path = directory.File("a");
    const auto writer = RecordingWriter::Create(path, encoding, {346, 260});
    ASSERT_TRUE((*writer)->Write(FileEvents()).ok());
    ASSERT_TRUE((*writer)->Close().ok());
    const auto recording = ReadAll(path);
    ASSERT_TRUE(recording.ok()) << recording.status();
    EXPECT_EQ(recording->header.container, "");
    EXPECT_THAT(recording->events, ElementsAreArray(FileEvents()));
  }
}

// A NumPy array of events with the fields `time`, x, y and p, in the order of these numbers.
template <typename Number>
std::string MakeNpy(const std::string& time, const char* type, const std::vector<Number>& numbers) {
  std::string header = "{'descr': [";
  for (const std::string& name : {time, std::string("x"), std::string("y"), std::string("p")}) {
    header += "('" + name + "', '" + type + "'), ";
  }
  header += "], 'fortran_order': False, 'shape': (" + std::to_string(numbers.size() / 4) + ",)}\n";
  std::string bytes = std::string("\x93NUMPY\x01\x00", 8) + static_cast<char>(header.size()) + '\0' + header;
  return bytes.append(reinterpret_cast<const char*>(numbers.data()), numbers.size() * sizeof(Number));
}

TEST(OpenRecordingTest, AnArraysEventWithoutAnAddressOrPolarityDoesNotChangeTheUnit) {
  const TemporaryDirectory directory;
  for (const std::vector<double>& first :
       {std::vector<double>{0.5, std::nan(""), 20.0, 1.0}, std::vector<double>{0.5, 10.0, 20.0, 7.0}}) {
    std::vector<double> numbers = first;
    for (const double number : {15e5, 10.0, 20.0, 1.0, 1500001.0, 11.0, 21.0, 0.0}) numbers.push_back(number);
    const auto recording = ReadAll(WriteBytes(directory.File("a.npy"), MakeNpy("t", "<f8", numbers)));
    ASSERT_TRUE(recording.ok()) << recording.status();
    EXPECT_THAT(recording->events, testing::ElementsAre(Event{1500000, 10, 20, 1}, Event{1500001, 11, 21, 0}));
  }
}

TEST(OpenRecordingTest, AnEventWithoutATimeIsNotTheZeroOfTheOthers) {
  const TemporaryDirectory directory;
  for (const double time : {std::nan(""), HUGE_VAL, -1e19, 2e18}) {
    const std::vector<double> numbers = {time, 9, 9, 1, 15e5, 10, 20, 1, 1500001, 11, 21, -1, 1500002, 11, 21, 3};
    const auto recording = ReadAll(WriteBytes(directory.File("a.npy"), MakeNpy("t", "<f8", numbers)));
    ASSERT_TRUE(recording.ok()) << recording.status();
    EXPECT_THAT(recording->events, testing::ElementsAre(Event{1500000, 10, 20, 1}, Event{1500001, 11, 21, 0})) << time;
    EXPECT_EQ(recording->header.time_offset_us, 0);
    EXPECT_EQ(recording->num_skipped("events without a valid time"), 1u);
    EXPECT_EQ(recording->num_skipped("rows whose polarity is not -1, 0 or 1"), 1u);
  }
}

TEST(OpenRecordingTest, AnArraysNanosecondsAreRounded) {
  const TemporaryDirectory directory;
  const std::vector<int64_t> numbers = {5499, 10, 20, 1, 5500, 11, 21, 0, 6499, 12, 22, 1};
  const auto recording = ReadAll(WriteBytes(directory.File("a.npy"), MakeNpy("t_ns", "<i8", numbers)));
  ASSERT_TRUE(recording.ok()) << recording.status();
  EXPECT_EQ(recording->header.container, "NumPy (t x y p, t in ns)");
  EXPECT_THAT(recording->events, testing::ElementsAre(Event{5, 10, 20, 1}, Event{6, 11, 21, 0}, Event{6, 12, 22, 1}));
  EXPECT_EQ(ReadAll(WriteBytes(directory.File("b"), MakeNpy("t_ms", "<i8", numbers)))->header.container,
            "NumPy (t x y p, t in ms)");
}

TEST(OpenRecordingTest, ADamagedEntryOfAnArchiveIsAnError) {
  const TemporaryDirectory directory;
  const std::vector<int64_t> numbers = {1500000, 10, 20, 1, 1500001, 11, 21, 0};
  const std::string array = MakeNpy("t", "<i8", numbers);
  const std::string path = directory.File("a.npz");
  for (const int level : {0, 9}) {
    void* const archive = zipOpen(path.c_str(), APPEND_STATUS_CREATE);
    zipOpenNewFileInZip(archive, "events.npy", nullptr, nullptr, 0, nullptr, 0, nullptr, level == 0 ? 0 : Z_DEFLATED,
                        level);
    zipWriteInFileInZip(archive, array.data(), static_cast<unsigned>(array.size()));
    zipCloseFileInZip(archive);
    ASSERT_EQ(zipClose(archive, nullptr), ZIP_OK);
    EXPECT_EQ(ReadAll(path)->events.size(), 2u);
    std::string bytes = ReadFile(path, SIZE_MAX).value();
    // Damages the row of the last event if there is no compression, else the end of the compressed data, before the
    // directory.
    bytes[bytes.find("PK\x01\x02") - (level == 0 ? 16 : 4)] ^= 1;
    const auto damaged = ReadAll(WriteBytes(path, bytes));
    EXPECT_EQ(damaged.status().code(), absl::StatusCode::kDataLoss) << damaged.status();
    EXPECT_THAT(damaged.status().message(), HasSubstr("a.npz: events.npy is damaged: "));
  }
}

TEST(OpenRecordingTest, ARecordingOfTriggersHasNoEvent) {
  const TemporaryDirectory directory;
  const std::string header = "#!AER-DAT2.0\r\n# AEChip: DAVIS240C\r\n";
  const std::string trigger("\x00\x00\x04\x00\x00\x00\x10\x00", 8), event("\x00\x00\x00\x00\x00\x00\x20\x00", 8);
  const auto none = ReadAll(WriteBytes(directory.File("a"), header + trigger));
  EXPECT_EQ(none.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(none.status().message(), HasSubstr("has no event"));
  // Triggers before the first event are kept, also those of an earlier read.
  std::string triggers;
  for (int i = 0; i < 40'000; ++i) triggers += trigger;
  const auto recording = ReadAll(WriteBytes(directory.File("a"), header + triggers + event));
  ASSERT_TRUE(recording.ok()) << recording.status();
  EXPECT_EQ(recording->triggers.size(), 40'000u);
  EXPECT_EQ(recording->events.size(), 1u);
}

TEST(OpenRecordingTest, AFileWithTheCharacterOfTopicsInItsNameIsFound) {
  const TemporaryDirectory directory;
  const std::string path = WriteBytes(directory.File("a#b.csv"), "1,2,0,5\n1,2,0,6\n");
  EXPECT_EQ(ReadAll(path)->events.size(), 2u);
  EXPECT_THAT(ErrorOf(path + "#topic"), HasSubstr("has no topics: leave out #topic"));
}

TEST(OpenRecordingTest, AFolderOfRosbag2IsReadThroughItsFile) {
  const TemporaryDirectory directory;
  const std::string bytes = ReadFile(FindTestData("containers/packets.mcap"), SIZE_MAX).value();
  WriteBytes(directory.File("metadata.yaml"), "rosbag2_bagfile_information:\n");
  EXPECT_THAT(ErrorOf(directory.path()), HasSubstr("is a directory, not a recording"));
  const std::string first = WriteBytes(directory.File("bag_0.mcap"), bytes);
  EXPECT_EQ(ReadAll(directory.path())->events.size(), 300u);
  EXPECT_EQ(ReadAll(directory.path() + "#/camera/events")->events.size(), 300u);
  const std::string second = WriteBytes(directory.File("bag_1.mcap"), bytes);
  EXPECT_THAT(ErrorOf(directory.path()),
              HasSubstr("is a bag of several files; give one of them: " + first + ", " + second));
}

TEST(OpenRecordingTest, OtherFormatsAreRefusedWithAdvice) {
  const TemporaryDirectory directory;
  const auto error = [&](const std::string& bytes) { return ErrorOf(WriteBytes(directory.File("a"), bytes)); };
  EXPECT_THAT(error("#ROSBAG V2.0\n"), HasSubstr("rosbags-convert"));
  EXPECT_THAT(error("RIFF1234AVI LIST"), HasSubstr("is a film of frames"));
  EXPECT_THAT(error(std::string("\0\0\0\x20"
                                "ftypisom",
                                12)),
              HasSubstr("is a film of frames"));
  EXPECT_THAT(error("\x28\xb5\x2f\xfdxxxx"), HasSubstr("unzstd"));
  EXPECT_THAT(error("MATLAB 5.0 MAT-file"), HasSubstr("save its events as CSV"));
  EXPECT_THAT(error("nothing of this kind"), HasSubstr("is not a recording of a known format: RAW, DAT"));
  EXPECT_THAT(error("PK\x03\x04rest"), HasSubstr("is a damaged or truncated ZIP archive"));
  EXPECT_THAT(error(std::string("SQLite format 3\0", 16)), HasSubstr("cannot be read as a rosbag2 file"));
  EXPECT_THAT(error(""), HasSubstr("is empty"));
}

TEST(OpenRecordingTest, OnlyRawAndDatCanBeFollowed) {
  const TemporaryDirectory directory;
  const std::string path = WriteBytes(directory.File("a.csv"), "1,2,0,5\n1,2,0,6\n");
  EXPECT_THAT(ErrorOf(path, {.is_following = true}), HasSubstr("cannot be followed as it grows"));
}

// Standard input with the given bytes, as long as the object lives.
class StandardInput {
 public:
  explicit StandardInput(const std::string& bytes) : saved_(dup(STDIN_FILENO)) {
    int ends[2];
    EXPECT_EQ(pipe(ends), 0);
    EXPECT_EQ(write(ends[1], bytes.data(), bytes.size()), static_cast<ssize_t>(bytes.size()));
    close(ends[1]);
    dup2(ends[0], STDIN_FILENO);
    close(ends[0]);
  }
  ~StandardInput() {
    dup2(saved_, STDIN_FILENO);
    close(saved_);
  }

 private:
  const int saved_;
};

TEST(OpenRecordingTest, StandardInputMayHoldRawOrText) {
  {
    const StandardInput input("1,2,0,5\n1,2,0,6\n");
    const auto recording = ReadAll("-");
    ASSERT_TRUE(recording.ok()) << recording.status();
    EXPECT_EQ(recording->events.size(), 2u);
    EXPECT_EQ(recording->header.geometry, (SensorGeometry{2048, 2048}));
    EXPECT_FALSE(recording->header.geometry_is_known);
  }
  {
    const StandardInput input(MakeRawHeader(Encoding::kEvt3, {640, 480}) +
                              std::string("\x00\x80\x01\x60\x02\x00\x03\x20", 8));
    EXPECT_THAT(ReadAll("-")->events, ::testing::ElementsAre(Event{1, 3, 2, 0}));
  }
  const StandardInput input(std::string("SQLite format 3\0", 16));
  EXPECT_THAT(ErrorOf("-"), HasSubstr("standard input: rosbag2 (.db3) cannot be read from a stream"));
}

}  // namespace
}  // namespace evpose::client

// SPDX-License-Identifier: Apache-2.0
#include "client/convert_hdf5/hdf5_reader.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>

#include "client/containers/hdf5/ecf_codec.h"
#include "client/convert_hdf5/hdf5_testing.h"
#include "client/convert_hdf5/metavision_attributes.h"
#include "core/base/temporary_directory_testing.h"

namespace evpose::client {
namespace {

using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::ElementsAreArray;
using ::testing::HasSubstr;
using ::testing::SizeIs;

// A file that other programs write. Datasets may have a filter and chunks.
class ForeignFile {
 public:
  explicit ForeignFile(const std::string& path)
      : file_(H5Fcreate(path.c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT), H5Fclose) {}

  void Group(const char* name) {
    Hdf5Handle(H5Gcreate2(file_.id(), name, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT), H5Gclose);
  }

  Hdf5Handle Dataset(const char* path, hid_t type, hsize_t size, hsize_t chunk = 0, H5Z_filter_t filter = 0) {
    const hsize_t max_size = chunk > 0 ? H5S_UNLIMITED : size;  // a chunk may be longer than the dataset
    const Hdf5Handle space(H5Screate_simple(1, &size, &max_size), H5Sclose);
    const Hdf5Handle properties(H5Pcreate(H5P_DATASET_CREATE), H5Pclose);
    const unsigned level = 6;
    if (chunk > 0) H5Pset_chunk(properties.id(), 1, &chunk);
    if (filter > 0) H5Pset_filter(properties.id(), filter, H5Z_FLAG_OPTIONAL, 1, &level);
    return {H5Dcreate2(file_.id(), path, type, space.id(), H5P_DEFAULT, properties.id(), H5P_DEFAULT), H5Dclose};
  }
  template <typename T>
  void Write(const char* path, hid_t type, const std::vector<T>& rows, hsize_t chunk = 0, H5Z_filter_t filter = 0) {
    const Hdf5Handle dataset = Dataset(path, type, rows.size(), chunk, filter);
    ASSERT_GE(H5Dwrite(dataset.id(), type, H5S_ALL, H5S_ALL, H5P_DEFAULT, rows.data()), 0);
  }
  void WriteScalar(const char* path, int64_t value) {
    const Hdf5Handle space(H5Screate(H5S_SCALAR), H5Sclose);
    const Hdf5Handle dataset(
        H5Dcreate2(file_.id(), path, H5T_NATIVE_INT64, space.id(), H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT), H5Dclose);
    H5Dwrite(dataset.id(), H5T_NATIVE_INT64, H5S_ALL, H5S_ALL, H5P_DEFAULT, &value);
  }

  const Hdf5Handle& file() const { return file_; }

 private:
  Hdf5Handle file_;
};

class Hdf5ReaderTest : public testing::Test {
 protected:
  std::string path() const { return directory_.File("a.hdf5"); }
  std::string ErrorOfFile() const { return std::string(ReadHdf5(path()).status().message()); }

  const TemporaryDirectory directory_;
};

TEST_F(Hdf5ReaderTest, DsecColumnsOfAnyIntegersAndFilters) {
  {
    ForeignFile file(path());
    file.Group("/events");
    file.Write<uint16_t>("/events/x", H5T_NATIVE_UINT16, {5, 639, 7}, 2, H5Z_FILTER_DEFLATE);
    file.Write<uint16_t>("/events/y", H5T_NATIVE_UINT16, {1, 479, 2});
    file.Write<int8_t>("/events/p", H5T_NATIVE_INT8, {1, -1, 0});
    file.Write<uint32_t>("/events/t", H5T_NATIVE_UINT32, {3, 4, 4'000'000'000}, 3, H5Z_FILTER_SHUFFLE);
    file.WriteScalar("/t_offset", 49'599'300'523);
  }
  const Hdf5Contents read = ReadHdf5(path()).value();
  EXPECT_EQ(read.header, (PipeHeader{"HDF5 (DSEC)", {}, 49'599'300'523}));
  EXPECT_THAT(read.events, ElementsAre(Event{3, 5, 1, 1}, Event{4, 639, 479, 0}, Event{4'000'000'000, 7, 2, 0}));
  EXPECT_EQ(read.losses, PipeLosses{});
}

TEST_F(Hdf5ReaderTest, ATimeOffsetBeyondTheRangeIsAnError) {
  {
    ForeignFile file(path());
    file.Group("/events");
    for (const char* column : {"/events/x", "/events/y", "/events/p", "/events/t"}) {
      file.Write<uint16_t>(column, H5T_NATIVE_UINT16, {1});
    }
    file.WriteScalar("/t_offset", kMaxStateTimeUs + 1);
  }
  EXPECT_THAT(ReadHdf5(path()).status().message(), HasSubstr("states a time offset of 1152921504606846977 us"));
  {
    ForeignFile file(path());
    file.Group("/CD");
    file.Write<CdRow>("/CD/events", CdRowType().id(), {{5, 6, 1, 10}});
    WriteTextAttribute(file.file(), kTimeOffsetAttribute, "-9223372036854775808");
  }
  EXPECT_THAT(ReadHdf5(path()).status().message(), HasSubstr("states a time offset of -9223372036854775808 us"));
}

// The text is read as OpenEB reads it, which subtracts only a time above 0.
TEST_F(Hdf5ReaderTest, TheTimeShiftIsTheZeroOfMetavision) {
  const auto read = [this](const std::string& time_shift) {
    ForeignFile file(path());
    file.Group("/CD");
    file.Write<CdRow>("/CD/events", CdRowType().id(), {{5, 6, 1, 10}});
    WriteTextAttribute(file.file(), kTimeShiftAttribute, time_shift);
    return ReadHdf5(path());
  };
  EXPECT_EQ(read("6384")->header.metavision_zero_us, 6384);
  EXPECT_EQ(read("6384")->events.front().t_us, 10);
  EXPECT_EQ(read("-7")->header.metavision_zero_us, 0);
  EXPECT_EQ(read("true")->header.metavision_zero_us, 0);
  EXPECT_THAT(read("1152921504606846977").status().message(),
              HasSubstr("states a time_shift of 1152921504606846977 us, which is beyond the range"));
}

TEST_F(Hdf5ReaderTest, ALongAttributeIsIgnored) {
  for (const size_t blanks : {0, 4000, 5000}) {
    {
      ForeignFile file(path());
      file.Group("/CD");
      file.Write<CdRow>("/CD/events", CdRowType().id(), {{5, 6, 1, 10}});
      WriteTextAttribute(file.file(), kGeometryAttribute, std::string(blanks, ' ') + "640x480");
    }
    EXPECT_EQ(ReadHdf5(path())->header.geometry, blanks < 4096 ? (SensorGeometry{640, 480}) : SensorGeometry{});
  }
}

TEST_F(Hdf5ReaderTest, ColumnsOfDifferentLengthsAndInvalidNumbersAreCounted) {
  {
    ForeignFile file(path());
    file.Group("/events");
    file.Write<int32_t>("/events/x", H5T_NATIVE_INT32, {5, -1, 7, 8});
    file.Write<uint16_t>("/events/y", H5T_NATIVE_UINT16, {1, 2, 3, 4, 5, 6});
    file.Write<uint8_t>("/events/p", H5T_NATIVE_UINT8, {1, 1, 0, 1, 0});
    file.Write<int64_t>("/events/t", H5T_NATIVE_INT64, {3, 4, -5, 6});
  }
  const Hdf5Contents read = ReadHdf5(path()).value();
  EXPECT_THAT(read.events, ElementsAre(Event{3, 5, 1, 1}, Event{6, 8, 4, 1}));
  EXPECT_EQ(read.losses, (PipeLosses{.events = 2, .invalid = 2}));
}

TEST_F(Hdf5ReaderTest, MetavisionTablesWithoutEcfAreRead) {
  {
    ForeignFile file(path());
    file.Group("/CD");
    file.Write<CdRow>("/CD/events", CdRowType().id(), {{5, 6, 1, 10}, {7, 8, 0, 11}}, 4, H5Z_FILTER_DEFLATE);
  }
  const Hdf5Contents read = ReadHdf5(path()).value();
  EXPECT_EQ(read.header, (PipeHeader{"Metavision HDF5", {}, 0, 0}));
  EXPECT_THAT(read.events, ElementsAre(Event{10, 5, 6, 1}, Event{11, 7, 8, 0}));
}

// Chunks: one of ECF, one stored plain, one damaged, one that is missing, one that is short.
TEST_F(Hdf5ReaderTest, ChunksThatCannotBeReadAreCounted) {
  const std::vector<Event> events = {{1, 2, 3, 0}, {4, 5, 6, 1}, {7, 8, 9, 0}};
  {
    ForeignFile file(path());
    file.Group("/CD");
    const Hdf5Handle dataset =
        file.Dataset("/CD/events", CdRowType().id(), 14, 3, static_cast<H5Z_filter_t>(kEcfFilter));
    const auto write = [&dataset](hsize_t begin, uint32_t filters_left_out, const void* bytes, size_t size) {
      ASSERT_GE(H5Dwrite_chunk(dataset.id(), H5P_DEFAULT, filters_left_out, &begin, size, bytes), 0);
    };
    std::vector<uint8_t> chunk;
    ASSERT_TRUE(EncodeEcfChunk(events, chunk).ok());
    write(0, 0, chunk.data(), chunk.size());
    const std::vector<CdRow> rows = {{50, 60, 1, 10}, {51, 61, 1, 11}, {52, 62, 0, 12}};
    write(3, 1, rows.data(), rows.size() * sizeof(CdRow));
    write(6, 0, chunk.data(), chunk.size() - 1);
    write(12, 0, chunk.data(), chunk.size());  // of which two rows count
  }
  const Hdf5Contents read = ReadHdf5(path()).value();
  EXPECT_THAT(read.events, ElementsAre(events[0], events[1], events[2], Event{10, 50, 60, 1}, Event{11, 51, 61, 1},
                                       Event{12, 52, 62, 0}, events[0], events[1]));
  EXPECT_EQ(read.losses, (PipeLosses{.events = 6}));
}

// HDF5 itself reads the rows of a missing chunk as zeros.
TEST_F(Hdf5ReaderTest, RowsOfAMissingChunkAreLost) {
  constexpr hsize_t kRowsOfChunk = 16'384;
  {
    ForeignFile file(path());
    file.Group("/events");
    const std::vector<int32_t> ones(20'000, 1);
    for (const char* column : {"/events/y", "/events/p", "/events/t"}) {
      file.Write<int32_t>(column, H5T_NATIVE_INT32, ones);
    }
    const Hdf5Handle dataset = file.Dataset("/events/x", H5T_NATIVE_INT32, ones.size(), kRowsOfChunk);
    const hsize_t begin = kRowsOfChunk;
    ASSERT_GE(H5Dwrite_chunk(dataset.id(), H5P_DEFAULT, 0, &begin, kRowsOfChunk * sizeof(int32_t), ones.data()), 0);
  }
  const Hdf5Contents read = ReadHdf5(path()).value();
  EXPECT_EQ(read.losses, (PipeLosses{.events = kRowsOfChunk}));
  EXPECT_THAT(read.events, SizeIs(20'000 - kRowsOfChunk));
  EXPECT_THAT(read.events, Each(Event{1, 1, 1, 1}));
}

TEST_F(Hdf5ReaderTest, FilesThatHoldNoEventsAreErrors) {
  std::ofstream(path()) << "no HDF5";
  EXPECT_THAT(ErrorOfFile(), HasSubstr("is no HDF5 file, or is damaged"));
  EXPECT_EQ(ReadHdf5(directory_.File("none")).status().code(), absl::StatusCode::kNotFound);
  {
    ForeignFile file(path());
    file.Group("/davis");
    file.Write<int32_t>("/scale", H5T_NATIVE_INT32, {1});
  }
  EXPECT_THAT(ErrorOfFile(),
              HasSubstr("has neither /CD/events (Metavision) nor /events/x, y, p and t (DSEC), but: davis, scale"));
}

TEST_F(Hdf5ReaderTest, ColumnsOfAnotherShapeAreErrors) {
  const auto error = [this](hid_t type, hsize_t size, hsize_t chunk, H5Z_filter_t filter) {
    {
      ForeignFile file(path());
      file.Group("/events");
      for (const char* column : {"/events/y", "/events/p", "/events/t"})
        file.Write<int32_t>(column, H5T_NATIVE_INT32, {1});
      file.Dataset("/events/x", type, size, chunk, filter);
    }
    return ErrorOfFile();
  };
  EXPECT_THAT(error(H5T_NATIVE_DOUBLE, 1, 0, 0), HasSubstr("the dataset /events/x does not hold integers"));
  EXPECT_THAT(error(CdRowType().id(), 1, 0, 0), HasSubstr("the dataset /events/x does not hold integers"));
  EXPECT_THAT(error(H5T_NATIVE_INT32, 1'000'000'000'000, 10, 0),
              HasSubstr("states 1000000000000 rows, but the file does not hold them"));
  EXPECT_THAT(error(H5T_NATIVE_INT32, 1 << 28, 1 << 28, 0), HasSubstr("has chunks of more than 64 MiB"));
  EXPECT_THAT(error(H5T_NATIVE_INT32, 1, 1, 32015),
              HasSubstr("is compressed with Zstandard, for which Debian has no package"));
  EXPECT_THAT(error(H5T_NATIVE_INT32, 1, 1, 999), HasSubstr("is compressed with number 999"));
}

TEST_F(Hdf5ReaderTest, BloscNamesItsPackageWhereItIsMissing) {
  H5PLset_loading_state(0);
  {
    ForeignFile file(path());
    file.Group("/events");
    for (const char* column : {"/events/x", "/events/y", "/events/p", "/events/t"}) {
      file.Dataset(column, H5T_NATIVE_INT32, 1, 1, 32001);
    }
  }
  EXPECT_THAT(ErrorOfFile(), HasSubstr("install the Debian package hdf5-filter-plugin-blosc-serial"));
  H5PLset_loading_state(H5PL_ALL_PLUGIN);
}

// Truncated and changed files give an error or a count; the library must be guarded by a process of its own in case it
// crashes, see hdf5_program_test.
TEST_F(Hdf5ReaderTest, TruncatedFilesAreErrors) {
  ASSERT_TRUE(WriteHdf5(path(), {.header = {"", {1280, 720}, 0}, .events = TestEvents(20'000)}).ok());
  std::ifstream file(path(), std::ios::binary);
  const std::string whole{std::istreambuf_iterator<char>(file), {}};
  for (const size_t size : {whole.size() - 1, whole.size() / 2, size_t{2000}, size_t{100}}) {
    std::ofstream(path(), std::ios::binary) << whole.substr(0, size);
    EXPECT_THAT(ErrorOfFile(), HasSubstr("is no HDF5 file, or is damaged")) << size;
  }
}

}  // namespace
}  // namespace evpose::client

// SPDX-License-Identifier: Apache-2.0
#include "client/convert_hdf5/hdf5_writer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "client/convert_hdf5/hdf5_testing.h"
#include "core/base/temporary_directory_testing.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAre;
using ::testing::ElementsAreArray;
using ::testing::Eq;
using ::testing::FieldsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

TEST(Hdf5WriterTest, RoundTripsAreExact) {
  const TemporaryDirectory directory;
  Hdf5Contents written;
  written.header = {"", {1280, 720}, 1'600'000'000'000'000, 6384};
  written.events = TestEvents(50'001);
  written.triggers = {{100, 0, 1}, {300'000, 3, 0}, {9'000'000, 255, 1}};
  const std::string path = directory.File("a.hdf5");
  ASSERT_EQ(WriteHdf5(path, written), absl::OkStatus());
  const Hdf5Contents read = ReadHdf5(path).value();
  EXPECT_EQ(read.header, (PipeHeader{"Metavision HDF5 (ECF)", {1280, 720}, 1'600'000'000'000'000, 6384}));
  EXPECT_THAT(read.events, ElementsAreArray(written.events));
  EXPECT_THAT(read.triggers, ElementsAreArray(written.triggers));
  EXPECT_EQ(read.losses, PipeLosses{});
  EXPECT_FALSE(std::filesystem::exists(path + ".partial"));
}

TEST(Hdf5WriterTest, ARecordingWithoutEventsIsAFileWithoutEvents) {
  const TemporaryDirectory directory;
  ASSERT_EQ(WriteHdf5(directory.File("a.hdf5"), {.header = {"", {640, 480}, 0}}), absl::OkStatus());
  const Hdf5Contents read = ReadHdf5(directory.File("a.hdf5")).value();
  EXPECT_EQ(read.header.geometry, (SensorGeometry{640, 480}));
  EXPECT_THAT(read.events, IsEmpty());
  EXPECT_THAT(read.triggers, IsEmpty());
}

TEST(Hdf5WriterTest, WithoutCloseThereIsNoFile) {
  const TemporaryDirectory directory;
  { ASSERT_TRUE(Hdf5Writer::Create(directory.File("a.hdf5"), {"", {640, 480}, 0}).ok()); }
  EXPECT_TRUE(std::filesystem::is_empty(directory.path()));
}

TEST(Hdf5WriterTest, WhatTheFormatCannotHoldIsAnError) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("a.hdf5");
  EXPECT_THAT(WriteHdf5(path, {.header = {"", {2049, 720}, 0}}).message(),
              HasSubstr("a.hdf5: ECF holds events of sensors of up to 2048x2048 pixels, not of 2049x720"));
  EXPECT_THAT(WriteHdf5(path, {.header = {"", {1280, 720}, 0}, .events = {{1, 5000, 0, 0}}}).message(),
              HasSubstr("event 0 of a chunk (x 5000"));
  const int64_t day_us = int64_t{24} * 3600 * 1'000'000;
  EXPECT_THAT(
      WriteHdf5(path, {.header = {"", {1280, 720}, 0}, .events = {{1, 0, 0, 0}, {day_us + 2, 0, 0, 0}}}).message(),
      HasSubstr("between 1 us and 86400000002 us nothing happens for more than a day"));
  EXPECT_THAT(WriteHdf5("/dev/null", {.header = {"", {1280, 720}, 0}}).message(), HasSubstr("is not a regular file"));
  EXPECT_THAT(WriteHdf5(directory.File("none/a.hdf5"), {.header = {"", {1280, 720}, 0}}).message(),
              HasSubstr("none/a.hdf5: cannot be created"));
  EXPECT_TRUE(std::filesystem::is_empty(directory.path()));
}

// The entries are those of OpenEB's IndexesWriter.
TEST(PeriodIndexTest, EachPeriodHasAnEventAtOrBeforeIt) {
  PeriodIndex index;
  std::vector<IndexRow> rows;
  for (const int64_t t_us : {5'000, 5'100, 7'500, 7'400, 14'000, 14'001}) {
    EXPECT_TRUE(index.Add(t_us, 100, rows));
  }
  index.Finish(rows);
  EXPECT_EQ(index.offset_us(), -5'000);
  EXPECT_THAT(rows,
              ElementsAre(FieldsAre(Eq(0u), Eq(-1)), FieldsAre(Eq(0u), Eq(0)), FieldsAre(Eq(2u), Eq(2'500)),
                          FieldsAre(Eq(2u), Eq(2'500)), FieldsAre(Eq(2u), Eq(2'500)), FieldsAre(Eq(4u), Eq(9'000))));
}

TEST(PeriodIndexTest, TheRowsOfAGapComeInPieces) {
  PeriodIndex at_once, in_pieces;
  std::vector<IndexRow> all, rows, piece;
  for (const int64_t t_us : {5'000, 5'000'000, 5'000'001, 9'000'000}) {
    EXPECT_TRUE(at_once.Add(t_us, SIZE_MAX, all));
    while (!in_pieces.Add(t_us, 10, piece)) {
      ASSERT_EQ(piece.size(), 10u);
      rows.insert(rows.end(), piece.begin(), piece.end());
      piece.clear();
    }
  }
  rows.insert(rows.end(), piece.begin(), piece.end());
  ASSERT_EQ(rows.size(), all.size());
  for (size_t i = 0; i < rows.size(); ++i) {
    EXPECT_TRUE(rows[i].id == all[i].id && rows[i].ts == all[i].ts) << i;
  }
}

}  // namespace
}  // namespace evpose::client

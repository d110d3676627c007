// SPDX-License-Identifier: Apache-2.0
#include "client/containers/event_file_writer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "client/containers/containers_testing.h"
#include "core/base/temporary_directory_testing.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAreArray;
using ::testing::HasSubstr;

TEST(EventFileWriterTest, EveryFormatReadsBack) {
  const TemporaryDirectory directory;
  ASSERT_GE(EventFileFormats().size(), 3u);
  for (const EventFileFormat& format : EventFileFormats()) {
    const std::string path = directory.File(std::string("a") + std::string(format.suffix));
    EXPECT_EQ(ChooseEventFileFormat("", path)->name, format.name);
    const auto writer = format.create(path, {{346, 260}, 1700000000000000});
    if (writer.status().code() == absl::StatusCode::kFailedPrecondition) continue;  // evpose-hdf5 needs libhdf5
    ASSERT_TRUE(writer.ok()) << writer.status();
    const std::vector<Trigger> triggers = {{4000, 0, 1}, {5037, 15, 0}, {90000, 1, 1}};
    ASSERT_TRUE((*writer)->Write(FileEvents(), triggers).ok());
    EXPECT_FALSE(std::filesystem::exists(path));
    ASSERT_TRUE((*writer)->Close().ok());
    const auto recording = ReadAll(path);
    ASSERT_TRUE(recording.ok()) << recording.status();
    EXPECT_THAT(recording->events, ElementsAreArray(FileEvents()));
    EXPECT_THAT(recording->triggers, ElementsAreArray(format.has_triggers ? triggers : std::vector<Trigger>{}));
    EXPECT_EQ(recording->header.geometry, (SensorGeometry{346, 260}));
    EXPECT_TRUE(recording->header.geometry_is_stated);
    EXPECT_EQ(recording->header.time_offset_us, 1700000000000000);
  }
}

TEST(EventFileWriterTest, WhatAFormatCannotHoldIsFoundBefore) {
  const std::vector<Event> steps_back = {{5000, 1, 1, 1}, {4000, 1, 1, 1}};
  const std::vector<Event> outside = {{5000, 346, 1, 1}};
  const EventFileHeader header = {{346, 260}, 0};
  const auto check = [&header](const char* name, const std::vector<Event>& events) {
    return ChooseEventFileFormat(name, "")->check(header).value()->Check(events, {});
  };
  EXPECT_THAT(check("raw", steps_back).message(), HasSubstr("times must not decrease"));
  EXPECT_TRUE(check("dat", steps_back).ok());
  EXPECT_TRUE(check("csv", steps_back).ok());
  EXPECT_THAT(check("raw", outside).message(), HasSubstr("outside the sensor of 346x260"));
  EXPECT_THAT(check("dat", outside).message(), HasSubstr("outside the sensor of 346x260"));
  EXPECT_TRUE(check("csv", outside).ok());
  EXPECT_TRUE(check("hdf5", steps_back).ok());
  EXPECT_THAT(check("hdf5", {{1, 2048, 0, 0}}).message(), HasSubstr("event 0 at x 2048, y 0 lies beyond"));
  EXPECT_THAT(ChooseEventFileFormat("hdf5", "")->check({{2049, 720}, 0}).status().message(),
              HasSubstr("has more than 2048 columns or rows"));
  const std::vector<Trigger> wrong_input = {{5000, 16, 1}};
  EXPECT_THAT(ChooseEventFileFormat("raw", "")->check(header).value()->Check({}, wrong_input).message(),
              HasSubstr("a trigger of input 16"));
  EXPECT_THAT(ChooseEventFileFormat("raw", "")->check({{4096, 3000}, 0}).status().message(),
              HasSubstr("addresses 1x1"));
}

TEST(EventFileWriterTest, TheNumberOfAnEventIsThatInTheRecording) {
  const EventFileHeader header = {{346, 260}, 0};
  const std::vector<Event> first = {{5000, 1, 1, 1}, {5001, 1, 1, 1}};
  for (const char* name : {"raw", "hdf5"}) {
    const auto checker = ChooseEventFileFormat(name, "")->check(header).value();
    ASSERT_TRUE(checker->Check(first, {}).ok());
    const std::vector<Event> outside = {{5002, 1, 1, 1}, {5003, 2048, 1, 1}};
    EXPECT_THAT(checker->Check(outside, {}).message(), HasSubstr("event 3 at x 2048, y 1 lies")) << name;
  }
  const auto checker = ChooseEventFileFormat("raw", "")->check(header).value();
  ASSERT_TRUE(checker->Check(first, {}).ok());
  const std::vector<Event> steps_back = {{5002, 1, 1, 1}, {4000, 1, 1, 1}};
  EXPECT_THAT(checker->Check(steps_back, {}).message(), HasSubstr("event 3 is 4000 us after 5002 us"));
  const std::vector<Trigger> wrong_input = {{6000, 16, 1}};
  EXPECT_THAT(checker->Check({}, wrong_input).message(), HasSubstr("before event 3, a trigger of input 16"));
}

TEST(EventFileWriterTest, AnUnknownSuffixIsAnError) {
  EXPECT_THAT(ChooseEventFileFormat("", "a.png").status().message(),
              HasSubstr("a.png: its name ends with none of .raw"));
}

}  // namespace
}  // namespace evpose::client

// SPDX-License-Identifier: Apache-2.0
#include "client/containers/hdf5/event_pipe.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace evpose::client {
namespace {

using ::testing::ElementsAreArray;
using ::testing::HasSubstr;

const PipeHeader kHeader = {"Metavision HDF5 (ECF)", {1280, 720}, -5, 6384};
const std::vector<Event> kPipeEvents = {{5, 1, 2, 1}, {int64_t{1} << 40, 1279, 719, 0}};
const std::vector<Trigger> kPipeTriggers = {{7, 3, 1}, {int64_t{1} << 41, 255, 0}};

std::vector<uint8_t> AllRecords() {
  std::vector<uint8_t> bytes;
  AppendPipeHeader(kHeader, bytes);
  AppendPipeEvents(kPipeEvents, bytes);
  AppendPipeTriggers(kPipeTriggers, bytes);
  AppendPipeLosses({1, 2, 3}, bytes);
  AppendPipeEnd(bytes);
  return bytes;
}

TEST(EventPipeTest, RecordsRoundTrip) {
  const std::vector<uint8_t> bytes = AllRecords();
  absl::Span<const uint8_t> rest = bytes;
  PipeRecord record;
  for (const PipeRecordKind kind : {PipeRecordKind::kHeader, PipeRecordKind::kEvents, PipeRecordKind::kTriggers,
                                    PipeRecordKind::kLosses, PipeRecordKind::kEnd}) {
    ASSERT_TRUE(TakePipeRecord(rest, record).value());
    EXPECT_EQ(record.kind, kind);
  }
  EXPECT_EQ(record.header, kHeader);
  EXPECT_THAT(record.events, ElementsAreArray(kPipeEvents));
  EXPECT_THAT(record.triggers, ElementsAreArray(kPipeTriggers));
  EXPECT_EQ(record.losses, (PipeLosses{1, 2, 3}));
  EXPECT_TRUE(rest.empty());
}

TEST(EventPipeTest, AnIncompleteRecordWaits) {
  std::vector<uint8_t> bytes;
  AppendPipeEvents(kPipeEvents, bytes);
  for (size_t size = 0; size < bytes.size(); ++size) {
    absl::Span<const uint8_t> part = absl::MakeConstSpan(bytes).first(size);
    PipeRecord record;
    EXPECT_EQ(TakePipeRecord(part, record).value(), false);
    EXPECT_EQ(part.size(), size);
  }
}

// What a crashing evpose-hdf5 has written must not harm evpose.
TEST(EventPipeTest, DamagedRecordsAreErrors) {
  PipeRecord record;
  const auto error = [&record](const std::vector<uint8_t>& bytes) {
    absl::Span<const uint8_t> rest = bytes;
    return std::string(TakePipeRecord(rest, record).status().message());
  };
  for (const int64_t offset_us : {kMaxStateTimeUs + 1, -kMaxStateTimeUs - 1}) {
    std::vector<uint8_t> header;
    AppendPipeHeader({"", {1280, 720}, offset_us}, header);
    EXPECT_THAT(error(header), HasSubstr("is damaged"));
  }
  for (const int64_t zero_us : {kMaxStateTimeUs + 1, int64_t{-2}}) {
    std::vector<uint8_t> header;
    AppendPipeHeader({"", {1280, 720}, 0, zero_us}, header);
    EXPECT_THAT(error(header), HasSubstr("is damaged"));
  }
  EXPECT_THAT(error({9, 0, 0, 0, 0}), HasSubstr("is damaged"));
  EXPECT_THAT(error({2, 0xff, 0xff, 0xff, 0xff}), HasSubstr("is too long"));
  EXPECT_THAT(error({5, 1, 0, 0, 0, 0}), HasSubstr("is damaged"));
  std::vector<uint8_t> bytes;
  AppendPipeEvents({{Event{-1, 0, 0, 0}}}, bytes);
  EXPECT_THAT(error(bytes), HasSubstr("is damaged"));
  bytes.clear();
  AppendPipeTriggers({{Trigger{1, 0, 2}}}, bytes);
  EXPECT_THAT(error(bytes), HasSubstr("is damaged"));
  bytes.clear();
  AppendPipeHeader({"", {1 << 20, 1}, 0}, bytes);
  EXPECT_THAT(error(bytes), HasSubstr("is damaged"));
}

}  // namespace
}  // namespace evpose::client

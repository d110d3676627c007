// SPDX-License-Identifier: Apache-2.0
#include "client/containers/aedat/flat_table.h"

#include <flatbuffers/flatbuffers.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <vector>

namespace evpose::client {
namespace {

// A table with an i16 (field 0), a string (1), a vector of tables with an i64 (2) and nothing (3).
std::vector<uint8_t> ExampleBuffer() {
  flatbuffers::FlatBufferBuilder builder;
  const auto text = builder.CreateString("text");
  std::vector<flatbuffers::Offset<flatbuffers::Table>> children;
  for (const int64_t number : {11, 22}) {
    const auto child = builder.StartTable();
    builder.AddElement<int64_t>(4, number, 0);
    children.emplace_back(builder.EndTable(child));
  }
  const auto vector = builder.CreateVector(children);
  const auto table = builder.StartTable();
  builder.AddElement<int16_t>(4, -3, 0);
  builder.AddOffset(6, text);
  builder.AddOffset(8, vector);
  builder.Finish(flatbuffers::Offset<flatbuffers::Table>(builder.EndTable(table)), "TEST");
  return {builder.GetBufferPointer(), builder.GetBufferPointer() + builder.GetSize()};
}

// Reads everything; true if it is as written.
bool ReadsExample(absl::Span<const uint8_t> buffer) {
  const absl::StatusOr<FlatTable> table = FlatTable::Root(buffer, "TEST");
  if (!table.ok()) return false;
  const auto number = table->Number<int16_t>(0, 0);
  const auto text = table->String(1);
  const auto elements = table->Vector(2, 4);
  if (!number.ok() || !text.ok() || !elements.ok()) return false;
  int64_t sum = 0;
  for (size_t i = 0; i < elements->count; ++i) {
    const auto child = table->TableAt(*elements, i);
    const auto value = child.ok() ? child->Number<int64_t>(0, 0) : child.status();
    if (!value.ok()) return false;
    sum = static_cast<int64_t>(static_cast<uint64_t>(sum) + static_cast<uint64_t>(*value));
  }
  return *number == -3 && *text == "text" && sum == 33;
}

TEST(FlatTableTest, ReadsWhatTheLibraryWrites) { EXPECT_TRUE(ReadsExample(ExampleBuffer())); }

TEST(FlatTableTest, AbsentFieldsHaveTheirDefaults) {
  const std::vector<uint8_t> buffer = ExampleBuffer();
  const FlatTable table = FlatTable::Root(buffer, "TEST").value();
  EXPECT_EQ(table.Number<int32_t>(3, 7).value(), 7);
  EXPECT_EQ(table.Number<int32_t>(1000, 8).value(), 8);
  EXPECT_EQ(table.Vector(3, 16)->count, 0u);
  EXPECT_EQ(table.String(3).value(), "");
}

TEST(FlatTableTest, AnotherIdentifierIsAnError) {
  EXPECT_EQ(FlatTable::Root(ExampleBuffer(), "NONE").status().code(), absl::StatusCode::kDataLoss);
}

// Under AddressSanitizer no read may leave the buffer.
TEST(FlatTableTest, TruncatedAndChangedBuffersAreReadWithinTheirBounds) {
  const std::vector<uint8_t> whole = ExampleBuffer();
  for (size_t size = 0; size < whole.size(); ++size) {
    const std::vector<uint8_t> part(whole.begin(), whole.begin() + static_cast<int64_t>(size));
    (void)ReadsExample(part);
    EXPECT_FALSE(ReadsExample(absl::MakeConstSpan(part).first(size / 2)));
  }
  int num_unreadable = 0;
  for (size_t i = 0; i < whole.size(); ++i) {
    for (const uint8_t value : {0x00, 0x7f, 0x80, 0xff}) {
      std::vector<uint8_t> changed = whole;
      changed[i] = value;
      if (!ReadsExample(changed)) ++num_unreadable;
    }
  }
  EXPECT_GT(num_unreadable, 100);
}

}  // namespace
}  // namespace evpose::client

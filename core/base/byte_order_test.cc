// SPDX-License-Identifier: Apache-2.0
#include "core/base/byte_order.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace evpose {
namespace {

constexpr uint8_t kBytes[] = {0x81, 0x02, 0x03, 0x04, 0x05, 0x06, 0x07, 0x88};

TEST(ByteOrderTest, LoadsNumbersOfAllWidths) {
  EXPECT_EQ(LoadLittleEndian<uint8_t>(kBytes), 0x81);
  EXPECT_EQ(LoadLittleEndian<uint16_t>(kBytes), 0x0281);
  EXPECT_EQ(LoadLittleEndian<uint32_t>(kBytes), 0x04030281u);
  EXPECT_EQ(LoadLittleEndian<uint64_t>(kBytes), 0x8807060504030281u);
  EXPECT_EQ(LoadBigEndian<uint16_t>(kBytes), 0x8102);
  EXPECT_EQ(LoadBigEndian<uint32_t>(kBytes), 0x81020304u);
  EXPECT_EQ(LoadBigEndian<uint64_t>(kBytes), 0x8102030405060788u);
}

TEST(ByteOrderTest, BytesOfATextAreUnsigned) {
  EXPECT_THAT(AsBytes(std::string("a\0\xff", 3)), ::testing::ElementsAre('a', 0, 255));
  EXPECT_TRUE(AsBytes("").empty());
}

TEST(ByteOrderTest, KeepsTheSign) {
  EXPECT_EQ(LoadBigEndian<int16_t>(kBytes), -32510);
  EXPECT_LT(LoadLittleEndian<int64_t>(kBytes), 0);
}

TEST(ByteOrderTest, AppendsWhatItLoads) {
  std::vector<uint8_t> bytes;
  AppendLittleEndian<int16_t>(-2, bytes);
  AppendLittleEndian<uint32_t>(0x01020304, bytes);
  AppendLittleEndian<int64_t>(-5'000'000'000, bytes);
  ASSERT_EQ(bytes.size(), 14u);
  EXPECT_EQ(bytes[2], 0x04);
  EXPECT_EQ(LoadLittleEndian<int16_t>(bytes.data()), -2);
  EXPECT_EQ(LoadLittleEndian<uint32_t>(bytes.data() + 2), 0x01020304u);
  EXPECT_EQ(LoadLittleEndian<int64_t>(bytes.data() + 6), -5'000'000'000);
}

}  // namespace
}  // namespace evpose

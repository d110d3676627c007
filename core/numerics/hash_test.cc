// SPDX-License-Identifier: Apache-2.0
#include "core/numerics/hash.h"

#include <gtest/gtest.h>

#include <string_view>
#include <vector>

#include "core/base/byte_order.h"

namespace evpose {
namespace {

// FIPS 180-2, appendix B.
TEST(Sha256Test, KnownDigests) {
  EXPECT_EQ(Sha256Hex(AsBytes("")), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  EXPECT_EQ(Sha256Hex(AsBytes("abc")), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

TEST(Sha256Test, PiecesGiveTheDigestOfTheWhole) {
  Sha256 hash;
  hash.Update(AsBytes("a"));
  hash.Update({});
  hash.Update(AsBytes("bc"));
  EXPECT_EQ(hash.FinishHex(), Sha256Hex(AsBytes("abc")));
}

// RFC 3720, appendix B.4.
TEST(Crc32cTest, KnownValues) {
  EXPECT_EQ(Crc32c(std::vector<uint8_t>(32, 0x00)), 0x8A9136AAu);
  EXPECT_EQ(Crc32c(std::vector<uint8_t>(32, 0xFF)), 0x62A8AB43u);
  EXPECT_EQ(Crc32c({}), 0u);
}

// CRC-32C by its definition, bit by bit.
uint32_t Crc32cByBits(absl::Span<const uint8_t> bytes) {
  uint32_t crc = 0xFFFFFFFF;
  for (const uint8_t byte : bytes) {
    crc ^= byte;
    for (int bit = 0; bit < 8; ++bit) crc = crc >> 1 ^ ((crc & 1) != 0 ? 0x82F63B78u : 0u);
  }
  return ~crc;
}

TEST(Crc32cTest, EverySizeAndAlignment) {
  std::vector<uint8_t> bytes(80);
  for (size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<uint8_t>(i * 167 + 13);
  for (size_t begin = 0; begin < 8; ++begin) {
    for (size_t size = 0; begin + size <= bytes.size(); ++size) {
      const auto part = absl::MakeConstSpan(bytes).subspan(begin, size);
      ASSERT_EQ(Crc32c(part), Crc32cByBits(part)) << begin << " " << size;
    }
  }
}

}  // namespace
}  // namespace evpose

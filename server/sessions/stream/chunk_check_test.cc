// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/stream/chunk_check.h"

#include <gtest/gtest.h>

#include <string>

#include "core/base/byte_order.h"
#include "core/numerics/hash.h"
#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

constexpr uint32_t kMaxBytes = 64;

absl::Status Check(const EventChunk& chunk) { return CheckChunk(chunk, Encoding::kFlat64, kMaxBytes); }
EventChunk Chunk(size_t bytes) { return {.seq = 1, .payload = std::string(bytes, 'x')}; }

TEST(ChunkCheckTest, AcceptsWholeWordsUpToTheLimit) {
  EXPECT_TRUE(Check(Chunk(0)).ok()) << "an empty chunk may announce a discontinuity";
  EXPECT_TRUE(Check(Chunk(8)).ok());
  EXPECT_TRUE(Check(Chunk(kMaxBytes)).ok());
}

TEST(ChunkCheckTest, NamesTheWrongField) {
  EventChunk unnumbered = Chunk(8);
  unnumbered.seq = 0;
  EXPECT_EQ(GetErrorDetails(Check(unnumbered)).field, "events.seq");
  EXPECT_EQ(GetErrorDetails(Check(Chunk(kMaxBytes + 8))).field, "events.payload");
  EXPECT_EQ(GetErrorDetails(Check(Chunk(kMaxBytes - 1))).field, "events.payload") << "a word is cut";
  EXPECT_EQ(Check(Chunk(kMaxBytes - 1)).code(), absl::StatusCode::kInvalidArgument);
}

TEST(ChunkCheckTest, AChunkWithoutAnyFieldIsAKeepalive) {
  EXPECT_TRUE(IsKeepalive({}));
  EXPECT_FALSE(IsKeepalive(Chunk(0))) << "it has a number";
  EXPECT_FALSE(IsKeepalive({.payload = "x"}));
  EXPECT_FALSE(IsKeepalive({.discontinuity = true}));
  EXPECT_FALSE(IsKeepalive({.crc32c = 0}));
}

TEST(ChunkCheckTest, ComparesTheChecksum) {
  EventChunk chunk = Chunk(16);
  chunk.crc32c = Crc32c(AsBytes(chunk.payload));
  EXPECT_TRUE(Check(chunk).ok());
  chunk.payload[9] ^= 1;
  const absl::Status damaged = Check(chunk);
  EXPECT_EQ(damaged.code(), absl::StatusCode::kDataLoss);
  EXPECT_EQ(GetErrorDetails(damaged).reason, "CRC_MISMATCH");
}

}  // namespace
}  // namespace evpose::server

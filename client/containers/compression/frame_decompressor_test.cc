// SPDX-License-Identifier: Apache-2.0
#include "client/containers/compression/frame_decompressor.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <lz4frame.h>
#include <zstd.h>

#include <memory>
#include <vector>

namespace evpose::client {
namespace {

using ::testing::Each;
using ::testing::HasSubstr;
using ::testing::SizeIs;

class FrameDecompressorTest : public testing::TestWithParam<FrameFormat> {
 protected:
  // Compresses `size` bytes, all equal to `value`, to one frame.
  static std::vector<uint8_t> Frame(size_t size, uint8_t value) {
    const std::vector<uint8_t> content(size, value);
    const bool is_lz4 = GetParam() == FrameFormat::kLz4;
    std::vector<uint8_t> frame(is_lz4 ? LZ4F_compressFrameBound(size, nullptr) : ZSTD_compressBound(size));
    frame.resize(is_lz4 ? LZ4F_compressFrame(frame.data(), frame.size(), content.data(), size, nullptr)
                        : ZSTD_compress(frame.data(), frame.size(), content.data(), size, 1));
    return frame;
  }
};

TEST_P(FrameDecompressorTest, ContentBeyondTheLimitIsRefused) {
  FrameDecompressor decompressor;
  for (const size_t limit : {size_t{1000}, size_t{64} << 10, size_t{200} << 10}) {
    for (const size_t size : {limit, limit + 1}) {
      const std::vector<uint8_t> frame = Frame(size, 7);
      absl::Span<const uint8_t> rest = frame;
      decompressor.Clear();
      const absl::Status status = decompressor.Append(GetParam(), rest, limit);
      EXPECT_EQ(status.ok(), size == limit) << status;
      if (status.ok()) {
        EXPECT_THAT(decompressor.content(), SizeIs(size));
        EXPECT_THAT(decompressor.content(), Each(7));
      } else {
        EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted);
        EXPECT_THAT(status.message(), HasSubstr("has more than"));
      }
    }
  }
}

TEST_P(FrameDecompressorTest, FramesAreTakenOneByOne) {
  std::vector<uint8_t> frames = Frame(3, 1);
  const std::vector<uint8_t> second = Frame(2, 2);
  frames.insert(frames.end(), second.begin(), second.end());
  absl::Span<const uint8_t> rest = frames;
  FrameDecompressor decompressor;
  ASSERT_TRUE(decompressor.Append(GetParam(), rest, 5).ok());
  EXPECT_THAT(rest, SizeIs(second.size()));
  EXPECT_THAT(decompressor.content(), testing::ElementsAre(1, 1, 1));
  ASSERT_TRUE(decompressor.Append(GetParam(), rest, 5).ok());
  EXPECT_THAT(rest, SizeIs(0));
  EXPECT_THAT(decompressor.content(), testing::ElementsAre(1, 1, 1, 2, 2));
}

TEST_P(FrameDecompressorTest, EveryTruncationIsDamage) {
  const std::vector<uint8_t> frame = Frame(1000, 3);
  FrameDecompressor decompressor;
  for (size_t size = 0; size < frame.size(); ++size) {
    absl::Span<const uint8_t> rest = absl::MakeConstSpan(frame).first(size);
    decompressor.Clear();
    EXPECT_EQ(decompressor.Append(GetParam(), rest, 1000).code(), absl::StatusCode::kDataLoss) << size;
  }
}

// Begins a frame without its size, as programs that read from a pipe do, so that its header has the whole window.
std::vector<uint8_t> FrameWithWindow(int window_log, size_t size) {
  const std::unique_ptr<ZSTD_CCtx, decltype(&ZSTD_freeCCtx)> context(ZSTD_createCCtx(), ZSTD_freeCCtx);
  ZSTD_CCtx_setParameter(context.get(), ZSTD_c_windowLog, window_log);
  const std::vector<uint8_t> content(size, 5);
  std::vector<uint8_t> frame(ZSTD_compressBound(size));
  ZSTD_outBuffer output = {frame.data(), frame.size(), 0};
  ZSTD_inBuffer input = {content.data(), content.size(), 0};
  ZSTD_compressStream2(context.get(), &output, &input, ZSTD_e_continue);
  ZSTD_compressStream2(context.get(), &output, &input, ZSTD_e_end);
  frame.resize(output.pos);
  return frame;
}

TEST(FrameDecompressorWindowTest, TheWindowIsBoundedByTheContentAndByTheUsualSize) {
  const auto code = [](int window_log, size_t max_bytes) {
    const std::vector<uint8_t> frame = FrameWithWindow(window_log, 1000);
    absl::Span<const uint8_t> rest = frame;
    FrameDecompressor decompressor;
    return decompressor.Append(FrameFormat::kZstd, rest, max_bytes).code();
  };
  EXPECT_EQ(code(23, 1000), absl::StatusCode::kOk);
  EXPECT_EQ(code(24, 1000), absl::StatusCode::kDataLoss);
  EXPECT_EQ(code(25, size_t{32} << 20), absl::StatusCode::kOk);
  EXPECT_EQ(code(26, size_t{32} << 20), absl::StatusCode::kDataLoss);
  EXPECT_EQ(code(26, (size_t{32} << 20) + 1), absl::StatusCode::kOk);
  EXPECT_EQ(code(27, size_t{1} << 40), absl::StatusCode::kOk);
}

INSTANTIATE_TEST_SUITE_P(Formats, FrameDecompressorTest, testing::Values(FrameFormat::kLz4, FrameFormat::kZstd));

}  // namespace
}  // namespace evpose::client

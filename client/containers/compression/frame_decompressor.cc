// SPDX-License-Identifier: Apache-2.0
#include "client/containers/compression/frame_decompressor.h"

#include <lz4frame.h>
#include <zstd.h>

#include <algorithm>
#include <bit>

#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// First size of the buffer of a content, which is doubled when it is full.
constexpr size_t kFirstContentBytes = size_t{64} * 1024;
// The decompressor keeps a window of the content in memory, and refuses frames that state a larger one. Every decoder
// should support 8 MiB (RFC 8878, section 3.1.1.1.2). A compressor that does not know the size of the content when it
// begins a frame states such a window even if the content is short; this is why the limit is not below 8 MiB for short
// contents.
constexpr int kUsualWindowLog = 23;
constexpr int kMaxWindowLog = 27;  // without an option, programs decompress no larger ones

int WindowLogFor(size_t max_bytes) {
  const auto log = static_cast<int>(std::bit_width(std::max<size_t>(max_bytes, 1) - 1));  // rounded up
  return std::clamp(log, kUsualWindowLog, kMaxWindowLog);
}

absl::Status DamagedFrame(absl::string_view what) {
  return absl::DataLossError(absl::StrCat("a compressed frame is damaged: ", what));
}

}  // namespace

struct FrameDecompressor::Contexts {
  Contexts() { LZ4F_createDecompressionContext(&lz4, LZ4F_VERSION); }
  ~Contexts() {
    LZ4F_freeDecompressionContext(lz4);
    ZSTD_freeDCtx(zstd);
  }

  // Decompresses from the front of `bytes` to `content` + `size`. True at the end of the frame.
  absl::StatusOr<bool> Lz4(absl::Span<const uint8_t>& bytes, std::vector<uint8_t>& content, size_t& size) const {
    size_t written = content.size() - size, read = bytes.size();
    const size_t result = LZ4F_decompress(lz4, content.data() + size, &written, bytes.data(), &read, nullptr);
    if (LZ4F_isError(result) != 0) return DamagedFrame(LZ4F_getErrorName(result));
    bytes.remove_prefix(read);
    size += written;
    return result == 0;
  }
  absl::StatusOr<bool> Zstd(absl::Span<const uint8_t>& bytes, std::vector<uint8_t>& content, size_t& size) const {
    ZSTD_outBuffer output = {content.data(), content.size(), size};
    ZSTD_inBuffer input = {bytes.data(), bytes.size(), 0};
    const size_t result = ZSTD_decompressStream(zstd, &output, &input);
    if (ZSTD_isError(result) != 0) return DamagedFrame(ZSTD_getErrorName(result));
    bytes.remove_prefix(input.pos);
    size = output.pos;
    return result == 0;
  }

  LZ4F_dctx* lz4 = nullptr;
  ZSTD_DCtx* zstd = ZSTD_createDCtx();
};

FrameDecompressor::FrameDecompressor() : contexts_(std::make_unique<Contexts>()) {}
FrameDecompressor::~FrameDecompressor() = default;
FrameDecompressor::FrameDecompressor(FrameDecompressor&& other) noexcept = default;
FrameDecompressor& FrameDecompressor::operator=(FrameDecompressor&& other) noexcept = default;

absl::Status FrameDecompressor::Append(FrameFormat format, absl::Span<const uint8_t>& bytes, size_t max_bytes) {
  LZ4F_resetDecompressionContext(contexts_->lz4);
  ZSTD_DCtx_reset(contexts_->zstd, ZSTD_reset_session_only);
  ZSTD_DCtx_setParameter(contexts_->zstd, ZSTD_d_windowLogMax, WindowLogFor(max_bytes));
  while (true) {
    // One byte more than the limit is read, to distinguish a content that is too long from one of exactly the limit.
    if (size_ == content_.size()) {
      content_.resize(std::min(std::max(kFirstContentBytes, 2 * size_), std::max(size_, max_bytes) + 1));
    }
    const size_t former_size = size_, former_rest = bytes.size();
    EVPOSE_ASSIGN_OR_RETURN(const bool is_complete, format == FrameFormat::kLz4
                                                        ? contexts_->Lz4(bytes, content_, size_)
                                                        : contexts_->Zstd(bytes, content_, size_));
    if (size_ > max_bytes) {
      return absl::ResourceExhaustedError(absl::StrCat("a compressed frame has more than ", max_bytes, " bytes"));
    }
    if (is_complete) return absl::OkStatus();
    if (size_ == former_size && bytes.size() == former_rest && size_ < content_.size()) return DamagedFrame("it ends");
  }
}

}  // namespace evpose::client

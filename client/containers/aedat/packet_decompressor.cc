// SPDX-License-Identifier: Apache-2.0
#include "client/containers/aedat/packet_decompressor.h"

#include <lz4frame.h>
#include <zstd.h>

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr size_t kFirstContentBytes = size_t{64} * 1024;

absl::Status DamagedFrame(absl::string_view what) {
  return absl::DataLossError(absl::StrCat("a compressed packet is damaged: ", what));
}

}  // namespace

struct PacketDecompressor::Contexts {
  Contexts() { LZ4F_createDecompressionContext(&lz4, LZ4F_VERSION); }
  ~Contexts() {
    LZ4F_freeDecompressionContext(lz4);
    ZSTD_freeDCtx(zstd);
  }

  // Decompresses from the front of `packet` to `content` + `size`. True at the end of the frame.
  absl::StatusOr<bool> Lz4(absl::Span<const uint8_t>& packet, std::vector<uint8_t>& content, size_t& size) const {
    size_t written = content.size() - size, read = packet.size();
    const size_t result = LZ4F_decompress(lz4, content.data() + size, &written, packet.data(), &read, nullptr);
    if (LZ4F_isError(result) != 0) return DamagedFrame(LZ4F_getErrorName(result));
    packet.remove_prefix(read);
    size += written;
    return result == 0;
  }
  absl::StatusOr<bool> Zstd(absl::Span<const uint8_t>& packet, std::vector<uint8_t>& content, size_t& size) const {
    ZSTD_outBuffer output = {content.data(), content.size(), size};
    ZSTD_inBuffer input = {packet.data(), packet.size(), 0};
    const size_t result = ZSTD_decompressStream(zstd, &output, &input);
    if (ZSTD_isError(result) != 0) return DamagedFrame(ZSTD_getErrorName(result));
    packet.remove_prefix(input.pos);
    size = output.pos;
    return result == 0;
  }

  LZ4F_dctx* lz4 = nullptr;
  ZSTD_DCtx* zstd = ZSTD_createDCtx();
};

PacketDecompressor::PacketDecompressor(PacketCompression compression)
    : compression_(compression), contexts_(std::make_unique<Contexts>()) {}
PacketDecompressor::~PacketDecompressor() = default;

absl::StatusOr<absl::Span<const uint8_t>> PacketDecompressor::Decompress(absl::Span<const uint8_t> packet,
                                                                         size_t max_bytes) {
  if (compression_ == PacketCompression::kNone) return packet;
  LZ4F_resetDecompressionContext(contexts_->lz4);
  ZSTD_DCtx_reset(contexts_->zstd, ZSTD_reset_session_only);
  size_t size = 0;
  while (true) {
    if (size == content_.size()) {
      if (size > max_bytes) return DamagedFrame(absl::StrCat("it has more than ", max_bytes, " bytes"));
      content_.resize(std::max(kFirstContentBytes, 2 * size));
    }
    const size_t former_size = size, former_rest = packet.size();
    EVPOSE_ASSIGN_OR_RETURN(const bool is_complete, compression_ == PacketCompression::kLz4
                                                        ? contexts_->Lz4(packet, content_, size)
                                                        : contexts_->Zstd(packet, content_, size));
    if (is_complete) return absl::MakeConstSpan(content_).first(size);
    if (size == former_size && packet.size() == former_rest && size < content_.size()) return DamagedFrame("it ends");
  }
}

}  // namespace evpose::client

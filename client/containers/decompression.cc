// SPDX-License-Identifier: Apache-2.0
#include "client/containers/decompression.h"

#include <lz4frame.h>
#include <zstd.h>

namespace evpose::client {

bool DecompressZstd(std::string_view bytes, size_t size, std::string& out) {
  out.resize(size);
  const size_t written = ZSTD_decompress(out.data(), size, bytes.data(), bytes.size());
  return ZSTD_isError(written) == 0 && written == size;
}

bool DecompressLz4(std::string_view bytes, size_t size, std::string& out) {
  out.resize(size);
  LZ4F_dctx* context = nullptr;
  if (LZ4F_isError(LZ4F_createDecompressionContext(&context, LZ4F_VERSION)) != 0) return false;
  size_t read = 0, written = 0;
  bool is_valid = true;
  while (read < bytes.size()) {
    size_t out_size = size - written;
    size_t in_size = bytes.size() - read;
    const size_t result =
        LZ4F_decompress(context, out.data() + written, &out_size, bytes.data() + read, &in_size, nullptr);
    is_valid = LZ4F_isError(result) == 0 && in_size + out_size > 0;
    if (!is_valid) break;
    read += in_size;
    written += out_size;
  }
  LZ4F_freeDecompressionContext(context);
  return is_valid && written == size;
}

}  // namespace evpose::client

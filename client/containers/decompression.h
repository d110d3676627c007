// SPDX-License-Identifier: Apache-2.0

// Decompression of blocks whose size is known.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace evpose::client {

// Replace `out` by the content of the zstd or lz4 frames `bytes`, which must be `size` bytes. Return false if it is
// damaged or has another size.
bool DecompressZstd(std::string_view bytes, size_t size, std::string& out);
bool DecompressLz4(std::string_view bytes, size_t size, std::string& out);

}  // namespace evpose::client

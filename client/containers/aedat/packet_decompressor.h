// SPDX-License-Identifier: Apache-2.0

// Compressed packets of AEDAT 4.0: each is one frame of LZ4 or Zstandard.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"

namespace evpose::client {

enum class PacketCompression { kNone, kLz4, kZstd };

class PacketDecompressor {
 public:
  explicit PacketDecompressor(PacketCompression compression);
  ~PacketDecompressor();
  PacketDecompressor(const PacketDecompressor&) = delete;
  PacketDecompressor& operator=(const PacketDecompressor&) = delete;

  // The content of a packet, valid until the next call. Errors: DATA_LOSS for a damaged or incomplete frame, or one
  // with a content of more than `max_bytes`.
  absl::StatusOr<absl::Span<const uint8_t>> Decompress(absl::Span<const uint8_t> packet, size_t max_bytes);

 private:
  struct Contexts;

  const PacketCompression compression_;
  const std::unique_ptr<Contexts> contexts_;
  std::vector<uint8_t> content_;
};

}  // namespace evpose::client

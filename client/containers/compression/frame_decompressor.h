// SPDX-License-Identifier: Apache-2.0

// Decompression of frames of LZ4 and Zstandard in untrusted files.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/status.h"
#include "absl/types/span.h"

namespace evpose::client {

enum class FrameFormat { kLz4, kZstd };

// Keeps its memory for the next content.
class FrameDecompressor {
 public:
  FrameDecompressor();
  ~FrameDecompressor();
  FrameDecompressor(FrameDecompressor&& other) noexcept;
  FrameDecompressor& operator=(FrameDecompressor&& other) noexcept;

  // Removes the content of former frames.
  void Clear() { size_ = 0; }

  // Takes a frame from the front of `bytes` and appends its content. Errors: RESOURCE_EXHAUSTED if the content of all
  // frames has more than `max_bytes`; DATA_LOSS for a damaged or incomplete frame, or if a frame of Zstandard needs a
  // window of more than `max_bytes` (as a power of two) and 8 MiB.
  absl::Status Append(FrameFormat format, absl::Span<const uint8_t>& bytes, size_t max_bytes);

  // Valid until the next call of Append().
  absl::Span<const uint8_t> content() const { return absl::MakeConstSpan(content_).first(size_); }

 private:
  struct Contexts;

  std::unique_ptr<Contexts> contexts_;
  std::vector<uint8_t> content_;
  size_t size_ = 0;  // of the content
};

}  // namespace evpose::client

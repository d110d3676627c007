// SPDX-License-Identifier: Apache-2.0

// Records of a fixed size from bytes that arrive in pieces.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "absl/types/span.h"

namespace evpose::client {

template <size_t kBytes>
class RecordBuffer {
 public:
  // Takes bytes from the front of `bytes`; a pointer to the record that they complete, valid until the next call, or
  // nullptr if it is still incomplete.
  const uint8_t* Take(absl::Span<const uint8_t>& bytes) {
    if (size_ == 0 && bytes.size() >= kBytes) {
      const uint8_t* const record = bytes.data();
      bytes.remove_prefix(kBytes);
      return record;
    }
    const size_t taken = std::min(kBytes - size_, bytes.size());
    std::copy_n(bytes.begin(), taken, record_.begin() + size_);
    bytes.remove_prefix(taken);
    size_ += taken;
    if (size_ < kBytes) return nullptr;
    size_ = 0;
    return record_.data();
  }
  size_t pending_bytes() const { return size_; }

 private:
  std::array<uint8_t, kBytes> record_{};
  size_t size_ = 0;
};

}  // namespace evpose::client

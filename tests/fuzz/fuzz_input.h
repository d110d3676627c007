// SPDX-License-Identifier: Apache-2.0

// Reads the bytes of a fuzzer from the front as numbers, choices and strings. After the end all values are zero or
// empty.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>

#include "absl/types/span.h"

namespace evpose {

class FuzzInput {
 public:
  FuzzInput(const uint8_t* data, size_t size) : rest_(data, size) {}

  bool empty() const { return rest_.empty(); }
  uint8_t Byte() {
    if (rest_.empty()) return 0;
    const uint8_t byte = rest_.front();
    rest_.remove_prefix(1);
    return byte;
  }
  uint16_t Word() {
    const uint16_t low = Byte();
    return static_cast<uint16_t>(low | Byte() << 8);
  }
  // Returns a value from 0 to `count` - 1; `count` is at most 256.
  int Choice(int count) { return Byte() % count; }
  absl::Span<const uint8_t> Bytes(size_t size) {
    const absl::Span<const uint8_t> bytes = rest_.subspan(0, size);
    rest_.remove_prefix(bytes.size());
    return bytes;
  }
  std::string Text(size_t size) {
    const absl::Span<const uint8_t> bytes = Bytes(size);
    return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
  }
  absl::Span<const uint8_t> Rest() { return Bytes(rest_.size()); }
  std::string RestAsText() { return Text(rest_.size()); }

 private:
  absl::Span<const uint8_t> rest_;
};

}  // namespace evpose

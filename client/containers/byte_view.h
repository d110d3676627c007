// SPDX-License-Identifier: Apache-2.0

// Reads little-endian fields from the front of bytes that may end early.
#pragma once

#include <cstdint>
#include <string_view>

#include "core/base/byte_order.h"

namespace evpose::client {

class ByteView {
 public:
  explicit ByteView(std::string_view bytes) : bytes_(bytes) {}

  // False after a field that lies beyond the end; every field is then 0 or empty.
  bool ok() const { return is_ok_; }
  std::string_view rest() const { return bytes_; }

  template <typename Number>
  Number Take() {
    const std::string_view field = TakeBytes(sizeof(Number));
    return is_ok_ ? LoadLittleEndian<Number>(reinterpret_cast<const uint8_t*>(field.data())) : Number{0};
  }
  std::string_view TakeBytes(uint64_t size) {
    is_ok_ = is_ok_ && size <= bytes_.size();
    if (!is_ok_) return {};
    const std::string_view field = bytes_.substr(0, size);
    bytes_.remove_prefix(size);
    return field;
  }
  // A string of MCAP: its length in 32 bits, then its bytes.
  std::string_view TakeString() { return TakeBytes(Take<uint32_t>()); }

 private:
  std::string_view bytes_;
  bool is_ok_ = true;
};

}  // namespace evpose::client

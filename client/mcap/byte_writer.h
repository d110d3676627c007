// SPDX-License-Identifier: Apache-2.0

// Appends little-endian fields; the counterpart of ByteView.
#pragma once

#include <concepts>
#include <cstddef>
#include <cstdint>
#include <string_view>
#include <vector>

#include "core/base/byte_order.h"

namespace evpose::client {

class ByteWriter {
 public:
  template <std::integral Number>
  void Put(Number value) {
    AppendLittleEndian(value, bytes_);
  }
  void PutBytes(std::string_view bytes) { bytes_.insert(bytes_.end(), bytes.begin(), bytes.end()); }
  void PutZeros(size_t count) { bytes_.resize(bytes_.size() + count); }
  // A string of MCAP: its length in 32 bits, then its bytes.
  void PutString(std::string_view text) {
    Put(static_cast<uint32_t>(text.size()));
    PutBytes(text);
  }

  size_t size() const { return bytes_.size(); }
  void Clear() { bytes_.clear(); }
  // Valid until the next call that changes it.
  std::string_view bytes() const { return {reinterpret_cast<const char*>(bytes_.data()), bytes_.size()}; }

 private:
  std::vector<uint8_t> bytes_;
};

}  // namespace evpose::client

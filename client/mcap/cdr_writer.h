// SPDX-License-Identifier: Apache-2.0

// Writes a message in CDR as ROS 2 does (OMG DDS-XTypes 1.3, section 7.4.1, version 1 of the encoding, little-endian):
// a number is aligned to its size, counted from the fifth byte on.
#pragma once

#include <bit>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "client/mcap/byte_writer.h"

namespace evpose::client {

class CdrWriter {
 public:
  CdrWriter() { bytes_.PutBytes(std::string_view("\0\1\0\0", kEncapsulationBytes)); }

  template <std::integral Number>
  void Put(Number value) {
    const size_t misalignment = (bytes_.size() - kEncapsulationBytes) % sizeof(Number);
    if (misalignment != 0) bytes_.PutZeros(sizeof(Number) - misalignment);
    bytes_.Put(value);
  }
  void Put(float value) { Put(std::bit_cast<uint32_t>(value)); }
  void Put(double value) { Put(std::bit_cast<uint64_t>(value)); }
  // Appends the number of elements, which precedes the elements of a sequence.
  void PutCount(size_t count) { Put(static_cast<uint32_t>(count)); }
  // The length counts the final zero.
  void PutString(std::string_view text) {
    PutCount(text.size() + 1);
    bytes_.PutBytes(text);
    bytes_.PutZeros(1);
  }
  // A sequence of bytes.
  void PutBytes(std::string_view bytes) {
    PutCount(bytes.size());
    bytes_.PutBytes(bytes);
  }

  std::string message() const { return std::string(bytes_.bytes()); }

 private:
  static constexpr size_t kEncapsulationBytes = 4;

  ByteWriter bytes_;
};

}  // namespace evpose::client

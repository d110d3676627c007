// SPDX-License-Identifier: Apache-2.0

// The bytes of texts, and numbers in files and messages of a fixed byte order.
#pragma once

#include <concepts>
#include <cstddef>
#include <cstdint>
#include <string_view>
#include <type_traits>
#include <vector>

#include "absl/types/span.h"

namespace evpose {

inline absl::Span<const uint8_t> AsBytes(std::string_view text) {
  return {reinterpret_cast<const uint8_t*>(text.data()), text.size()};
}

// The number whose bytes, least significant first, are the sizeof(T) bytes at `bytes`.
template <std::integral T>
T LoadLittleEndian(const uint8_t* bytes) {
  std::make_unsigned_t<T> value = 0;
  for (size_t i = 0; i < sizeof(T); ++i) {
    value = static_cast<std::make_unsigned_t<T>>(value | static_cast<std::make_unsigned_t<T>>(bytes[i]) << (8 * i));
  }
  return static_cast<T>(value);
}

// The same with the most significant byte first.
template <std::integral T>
T LoadBigEndian(const uint8_t* bytes) {
  std::make_unsigned_t<T> value = 0;
  for (size_t i = 0; i < sizeof(T); ++i) {
    value = static_cast<std::make_unsigned_t<T>>(value | static_cast<std::make_unsigned_t<T>>(bytes[i])
                                                             << (8 * (sizeof(T) - 1 - i)));
  }
  return static_cast<T>(value);
}

template <std::integral T>
void AppendLittleEndian(T value, std::vector<uint8_t>& out) {
  for (size_t i = 0; i < sizeof(T); ++i) {
    out.push_back(static_cast<uint8_t>(static_cast<std::make_unsigned_t<T>>(value) >> (8 * i)));
  }
}

}  // namespace evpose

// SPDX-License-Identifier: Apache-2.0

// The header of a NumPy array (.npy): the types of its items and its shape (numpy:doc/neps/nep-0001-npy-format.rst).
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"

namespace evpose::client {

inline constexpr std::string_view kNpyMagic("\x93NUMPY", 6);

// A number in an item.
struct NpyField {
  std::string name;  // empty in an array of plain numbers
  char kind = 'i';   // 'i', 'u', 'f', 'b'; '?' for a type that cannot be read
  size_t size = 0;   // in bytes
  size_t offset = 0;
  bool is_big_endian = false;
};

struct NpyNumber {
  bool is_integer = false;
  int64_t integer = 0;    // value of a number of kind 'i', 'u' or 'b'; the largest int64_t for larger numbers
  double floating = 0.0;  // the same as floating point, or the number of kind 'f'
};

struct NpyHeader {
  std::vector<NpyField> fields;  // one without a name for plain numbers
  size_t item_bytes = 0;
  std::vector<int64_t> shape;
  bool is_fortran_order = false;
  size_t size_bytes = 0;  // offset of the first item

  int64_t num_items() const;  // numbers or records in the array
};

// Parses the header at the start of `prefix`; nullopt if it continues beyond. INVALID_ARGUMENT for another one.
absl::StatusOr<std::optional<NpyHeader>> ParseNpyHeader(std::string_view prefix);

// `item` has the item_bytes of the field's header.
NpyNumber ReadNumber(const NpyField& field, const uint8_t* item);

}  // namespace evpose::client

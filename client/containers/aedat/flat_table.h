// SPDX-License-Identifier: Apache-2.0

// Reads tables of FlatBuffers from untrusted bytes (client/containers/aedat/README.md, section 4).
#pragma once

#include <concepts>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/types/span.h"
#include "core/base/byte_order.h"
#include "core/base/status_macros.h"

namespace evpose::client {

// A table within a buffer, which must outlive it. Fields have the numbers of their order in the schema, from 0. All
// functions return DATA_LOSS if an offset or a size leads out of the buffer.
class FlatTable {
 public:
  // The elements of a vector.
  struct Elements {
    size_t begin = 0;  // position of the first element in the buffer
    size_t count = 0;
  };

  // The root of a buffer without size prefix. DATA_LOSS if the buffer has another identifier, which has four
  // characters.
  static absl::StatusOr<FlatTable> Root(absl::Span<const uint8_t> buffer, absl::string_view identifier);
  // The four characters of the identifier; empty if the buffer is too short.
  static absl::string_view Identifier(absl::Span<const uint8_t> buffer);

  // A number; `absent` if the table does not contain the field.
  template <std::integral T>
  absl::StatusOr<T> Number(int field, T absent) const {
    EVPOSE_ASSIGN_OR_RETURN(const std::optional<size_t> position, Position(field, sizeof(T)));
    return position.has_value() ? LoadLittleEndian<T>(buffer_.data() + *position) : absent;
  }
  // A vector of elements of `element_bytes` bytes; no elements if the table does not contain the field.
  absl::StatusOr<Elements> Vector(int field, size_t element_bytes) const;
  // A string; empty if the table does not contain the field.
  absl::StatusOr<absl::string_view> String(int field) const;
  // The table at `index` of a vector of tables, which Vector() returns for `element_bytes` = 4.
  absl::StatusOr<FlatTable> TableAt(const Elements& elements, size_t index) const;

 private:
  FlatTable(absl::Span<const uint8_t> buffer, size_t table, size_t fields, size_t num_fields)
      : buffer_(buffer), table_(table), fields_(fields), num_fields_(num_fields) {}
  static absl::StatusOr<FlatTable> At(absl::Span<const uint8_t> buffer, size_t table);
  // Follows the offset of 32 bits at `position`.
  static absl::StatusOr<size_t> Follow(absl::Span<const uint8_t> buffer, size_t position);
  // Position of a field of `bytes` bytes; nullopt if the table does not contain it.
  absl::StatusOr<std::optional<size_t>> Position(int field, size_t bytes) const;

  absl::Span<const uint8_t> buffer_;
  size_t table_;
  size_t fields_;  // position of the offsets of the fields, 16 bits each
  size_t num_fields_;
};

}  // namespace evpose::client

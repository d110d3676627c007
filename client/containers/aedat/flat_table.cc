// SPDX-License-Identifier: Apache-2.0
#include "client/containers/aedat/flat_table.h"

#include "absl/strings/str_cat.h"

namespace evpose::client {
namespace {

constexpr size_t kIdentifierBytes = 4;
constexpr size_t kOffsetBytes = 4;
constexpr size_t kFieldBytes = 2;         // size of the offset of a field
constexpr size_t kFieldsHeaderBytes = 4;  // two sizes before these offsets

bool Contains(absl::Span<const uint8_t> buffer, size_t position, size_t bytes) {
  return position <= buffer.size() && bytes <= buffer.size() - position;
}

absl::Status OutOfBuffer(size_t position) {
  return absl::DataLossError(absl::StrCat("a FlatBuffer refers to bytes beyond its end, at ", position));
}

}  // namespace

absl::string_view FlatTable::Identifier(absl::Span<const uint8_t> buffer) {
  if (!Contains(buffer, kOffsetBytes, kIdentifierBytes)) return "";
  return {reinterpret_cast<const char*>(buffer.data()) + kOffsetBytes, kIdentifierBytes};
}

absl::StatusOr<FlatTable> FlatTable::Root(absl::Span<const uint8_t> buffer, absl::string_view identifier) {
  if (Identifier(buffer) != identifier) return absl::DataLossError(absl::StrCat("a FlatBuffer is no ", identifier));
  EVPOSE_ASSIGN_OR_RETURN(const size_t table, Follow(buffer, 0));
  return At(buffer, table);
}

absl::StatusOr<size_t> FlatTable::Follow(absl::Span<const uint8_t> buffer, size_t position) {
  if (!Contains(buffer, position, kOffsetBytes)) return OutOfBuffer(position);
  return position + LoadLittleEndian<uint32_t>(buffer.data() + position);
}

absl::StatusOr<FlatTable> FlatTable::At(absl::Span<const uint8_t> buffer, size_t table) {
  if (!Contains(buffer, table, kOffsetBytes)) return OutOfBuffer(table);
  // A signed offset, to be subtracted.
  const int64_t fields = static_cast<int64_t>(table) - LoadLittleEndian<int32_t>(buffer.data() + table);
  if (fields < 0 || !Contains(buffer, static_cast<size_t>(fields), kFieldsHeaderBytes)) return OutOfBuffer(table);
  const size_t bytes = LoadLittleEndian<uint16_t>(buffer.data() + fields);
  if (bytes < kFieldsHeaderBytes || !Contains(buffer, static_cast<size_t>(fields), bytes)) return OutOfBuffer(table);
  return FlatTable(buffer, table, static_cast<size_t>(fields) + kFieldsHeaderBytes,
                   (bytes - kFieldsHeaderBytes) / kFieldBytes);
}

absl::StatusOr<std::optional<size_t>> FlatTable::Position(int field, size_t bytes) const {
  if (static_cast<size_t>(field) >= num_fields_) return std::nullopt;
  const size_t offset = LoadLittleEndian<uint16_t>(buffer_.data() + fields_ + static_cast<size_t>(field) * kFieldBytes);
  if (offset == 0) return std::nullopt;
  if (!Contains(buffer_, table_ + offset, bytes)) return OutOfBuffer(table_ + offset);
  return table_ + offset;
}

absl::StatusOr<FlatTable::Elements> FlatTable::Vector(int field, size_t element_bytes) const {
  EVPOSE_ASSIGN_OR_RETURN(const std::optional<size_t> position, Position(field, kOffsetBytes));
  if (!position.has_value()) return Elements{};
  EVPOSE_ASSIGN_OR_RETURN(const size_t vector, Follow(buffer_, *position));
  if (!Contains(buffer_, vector, kOffsetBytes)) return OutOfBuffer(vector);
  const Elements elements = {vector + kOffsetBytes, LoadLittleEndian<uint32_t>(buffer_.data() + vector)};
  if (!Contains(buffer_, elements.begin, elements.count * element_bytes)) return OutOfBuffer(vector);
  return elements;
}

absl::StatusOr<absl::string_view> FlatTable::String(int field) const {
  EVPOSE_ASSIGN_OR_RETURN(const Elements elements, Vector(field, 1));
  return absl::string_view(reinterpret_cast<const char*>(buffer_.data()) + elements.begin, elements.count);
}

absl::StatusOr<FlatTable> FlatTable::TableAt(const Elements& elements, size_t index) const {
  EVPOSE_ASSIGN_OR_RETURN(const size_t table, Follow(buffer_, elements.begin + index * kOffsetBytes));
  return At(buffer_, table);
}

}  // namespace evpose::client

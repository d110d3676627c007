// SPDX-License-Identifier: Apache-2.0

// Serialization of state for checkpoints and stored records. A state that was read has the same bits as the saved one.
//
// One function lists the fields for both directions:
//
//   struct Sighting {
//     int64_t t_us;
//     State state;
//     std::vector<double> scores;
//     static void VisitState(auto& archive, auto& self) {
//       auto& [t_us, state, scores] = self;  // does not compile if a member is missing
//       archive(t_us, AtMost(state, State::kLast), scores);
//     }
//   };
//   StateWriter writer;                     StateReader reader(bytes);
//   writer(sighting, count);                reader(sighting, count);
//   std::string bytes = writer.Take();      absl::Status status = reader.Finish();
//
// A field may be a bool, an integer or floating-point number of fixed width, an enum within AtMost(), a std::string, an
// optional, pair, array, vector or deque of fields, an Eigen matrix of fixed size, a type with VisitState(), or a type
// with SaveState(StateWriter&) const and LoadState(StateReader&). Format: numbers are little-endian, floating-point
// numbers by their bits; a bool is a byte, 0 or 1; a list or string is its length (64 bits) and its elements; an
// optional is a bool and, if it is 1, the value. The bytes have no version or type: the caller stores them in a record
// that has.
//
// The reader accepts damaged and hostile bytes. It keeps the first error (status()); after it every number read is zero
// and every list empty, so that reading code need not check each step. Values that were read must not be used before
// the status was checked. Allocations are bounded by a small multiple of the number of bytes given.
#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <deque>
#include <optional>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"

namespace evpose {

static_assert(std::endian::native == std::endian::little,
              "numbers are copied from memory, whose order must be little-endian");

// Has a yield point (yield_point.h) after every kPieceBytes, because a state may have many megabytes. The bytes are
// kept in pieces of this size until Take(): a string that grew to such a size would be copied as a whole at one point.
class StateWriter {
 public:
  static constexpr bool kReading = false;
  static constexpr size_t kPieceBytes = size_t{64} * 1024;

  template <typename... Fields>
  void operator()(const Fields&... fields);

  // The number of elements that follow, for types that write their elements themselves.
  void Count(const size_t& count);
  // A number that is usually small, as a varint: 7 bits per byte from the lowest on, bit 7 set in all but the last
  // byte.
  void Varint(const uint64_t& number);
  void Bytes(absl::string_view bytes);  // preceded by their length
  void Raw(const void* bytes, size_t size) {
    piece_.append(static_cast<const char*>(bytes), size);
    if (piece_.size() >= kPieceBytes) EndPiece();
  }
  // A condition on values that were read; a writer does not test it.
  void Check(bool, absl::string_view) {}

  size_t size() const { return ended_bytes_ + piece_.size(); }
  std::string Take();

 private:
  void EndPiece();

  std::vector<std::string> ended_;  // the pieces before piece_
  size_t ended_bytes_ = 0;          // of their bytes
  std::string piece_;
};

class StateReader {
 public:
  static constexpr bool kReading = true;

  explicit StateReader(absl::string_view bytes) : bytes_(bytes) {}

  template <typename... Fields>
  void operator()(Fields&&... fields);

  // Fails for a count above the number of remaining bytes: an element has at least one byte.
  void Count(size_t& count);
  void Varint(uint64_t& number);
  // Returns a view into the reader's bytes.
  absl::string_view Bytes();
  // Copies `size` bytes; zeros if fewer remain.
  void Raw(void* bytes, size_t size);
  // Fails unless `good`, with an error text such as "the row lies outside the sensor".
  void Check(bool good, absl::string_view what) {
    if (!good) Fail(what);
  }
  void Fail(absl::string_view what);

  bool ok() const { return status_.ok(); }
  size_t remaining() const { return bytes_.size() - position_; }
  // The first error: DATA_LOSS with its cause and the position of the byte.
  const absl::Status& status() const { return status_; }
  // The same; remaining bytes are an error, too. The last call.
  absl::Status Finish();

 private:
  absl::string_view bytes_;
  size_t position_ = 0;
  absl::Status status_;
};

// A number or enum that must lie in [first, last]. The bounds are evaluated when InRange() is called, so that a bound
// which is itself read can be used only in a later archive(...) call, not in the call that reads it.
template <typename Field>
struct StateInRange {
  Field& field;
  std::remove_const_t<Field> first;
  std::remove_const_t<Field> last;
};

template <typename Field>
StateInRange<Field> InRange(Field& field, std::type_identity_t<std::remove_const_t<Field>> first,
                            std::type_identity_t<std::remove_const_t<Field>> last) {
  return {field, first, last};
}

// The same for [0, last].
template <typename Field>
StateInRange<Field> AtMost(Field& field, std::type_identity_t<std::remove_const_t<Field>> last) {
  return {field, static_cast<std::remove_const_t<Field>>(0), last};
}

// A floating-point number or matrix without infinite elements or NaN.
template <typename Field>
struct StateFinite {
  Field& field;
};

template <typename Field>
StateFinite<Field> Finite(Field& field) {
  return {field};
}

namespace state_internal {

template <typename T, template <typename...> class Template>
inline constexpr bool kIs = false;
template <template <typename...> class Template, typename... Arguments>
inline constexpr bool kIs<Template<Arguments...>, Template> = true;

template <typename T>
inline constexpr bool kIsArray = false;
template <typename T, size_t kSize>
inline constexpr bool kIsArray<std::array<T, kSize>> = true;

template <typename T>
concept SavesItself = requires(const T& saved, T& loaded, StateWriter& writer, StateReader& reader) {
  saved.SaveState(writer);
  loaded.LoadState(reader);
};

template <typename T, typename Archive>
concept Visitable = requires(Archive& archive, T& self) {
  T::VisitState(archive, self);
};

template <typename T>
concept FixedMatrix = requires(T& matrix) {
  requires T::SizeAtCompileTime >
  0;
  matrix.data();
};

template <typename Archive, typename Field>
void Visit(Archive& archive, Field& field);

template <typename Archive, typename List>
void VisitList(Archive& archive, List& list) {
  if constexpr (Archive::kReading) {
    size_t count = 0;
    archive.Count(count);
    list.clear();
    // Grows element by element: resize() would allocate for a false count before the missing bytes are noticed.
    for (size_t i = 0; i < count && archive.ok(); ++i) {
      typename List::value_type item{};  // a variable of its own, because vector<bool> has no references
      Visit(archive, item);
      list.push_back(std::move(item));
    }
    if (!archive.ok()) list.clear();
  } else {
    archive.Count(list.size());
    for (const typename List::value_type& item : list) Visit(archive, item);
  }
}

template <typename Archive, typename Field>
void VisitOptional(Archive& archive, Field& field) {
  bool has_value = field.has_value();
  Visit(archive, has_value);
  if constexpr (Archive::kReading) {
    field.reset();
    if (has_value) field.emplace();
  }
  if (has_value) Visit(archive, *field);
}

template <typename Archive>
void VisitBool(Archive& archive, auto& field) {
  uint8_t byte = field ? 1 : 0;
  archive.Raw(&byte, 1);
  archive.Check(byte <= 1, "a bool is neither 0 nor 1");
  if constexpr (Archive::kReading) field = byte == 1;
}

template <typename Archive, typename Field>
void VisitInRange(Archive& archive, const StateInRange<Field>& range) {
  archive.Raw(&range.field, sizeof(Field));
  if constexpr (Archive::kReading) {
    // This form of the condition is false for NaN.
    if (range.field >= range.first && range.field <= range.last) return;
    archive.Fail("a number or enum lies outside its range");
    range.field = range.first;
  }
}

template <typename Archive, typename Field>
void VisitFinite(Archive& archive, const StateFinite<Field>& finite) {
  Visit(archive, finite.field);
  if constexpr (Archive::kReading) {
    // x - x is NaN for infinity and NaN.
    bool all_finite = true;
    if constexpr (std::is_floating_point_v<Field>) {
      all_finite = finite.field - finite.field == 0;
    } else {
      for (int i = 0; i < Field::SizeAtCompileTime; ++i) {
        all_finite &= finite.field.data()[i] - finite.field.data()[i] == 0;
      }
    }
    archive.Check(all_finite, "a number is infinite or NaN");
  }
}

template <typename Archive, typename Field>
void Visit(Archive& archive, Field& field) {
  using T = std::remove_const_t<Field>;
  static_assert(!std::is_enum_v<T>, "an enum is read within AtMost(field, last value)");
  if constexpr (std::is_same_v<T, bool>) {
    VisitBool(archive, field);
  } else if constexpr (std::is_arithmetic_v<T>) {
    archive.Raw(&field, sizeof(T));
  } else if constexpr (kIs<T, StateInRange>) {
    VisitInRange(archive, field);
  } else if constexpr (kIs<T, StateFinite>) {
    VisitFinite(archive, field);
  } else if constexpr (SavesItself<T>) {
    if constexpr (Archive::kReading) {
      field.LoadState(archive);
    } else {
      field.SaveState(archive);
    }
  } else if constexpr (Visitable<T, Archive>) {
    T::VisitState(archive, field);
  } else if constexpr (std::is_same_v<T, std::string>) {
    if constexpr (Archive::kReading) {
      field = std::string(archive.Bytes());
    } else {
      archive.Bytes(field);
    }
  } else if constexpr (kIs<T, std::optional>) {
    VisitOptional(archive, field);
  } else if constexpr (kIs<T, std::pair>) {
    Visit(archive, field.first);
    Visit(archive, field.second);
  } else if constexpr (kIsArray<T>) {
    for (auto& item : field) Visit(archive, item);
  } else if constexpr (kIs<T, std::vector> || kIs<T, std::deque>) {
    VisitList(archive, field);
  } else {
    static_assert(FixedMatrix<T>, "this type cannot be serialized: give it VisitState(archive, self)");
    for (int i = 0; i < T::SizeAtCompileTime; ++i) Visit(archive, field.data()[i]);
  }
}

}  // namespace state_internal

template <typename... Fields>
void StateWriter::operator()(const Fields&... fields) {
  (state_internal::Visit(*this, fields), ...);
}

template <typename... Fields>
void StateReader::operator()(Fields&&... fields) {
  (state_internal::Visit(*this, fields), ...);
}

}  // namespace evpose

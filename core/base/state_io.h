// SPDX-License-Identifier: Apache-2.0

// State as bytes, bit for bit, and back: checkpoints and the records beside them.
//
// One function names the fields for both directions:
//
//   struct Sighting {
//     int64_t t_us;
//     State state;
//     std::vector<double> scores;
//     static void VisitState(auto& archive, auto& self) {
//       auto& [t_us, state, scores] = self;  // does not compile when a member is added and not thought of
//       archive(t_us, AtMost(state, State::kLast), scores);
//     }
//   };
//   StateWriter writer;                     StateReader reader(bytes);
//   writer(sighting, count);                reader(sighting, count);
//   std::string bytes = writer.Take();      absl::Status status = reader.Finish();
//
// Fields may be bool, integers and floating-point numbers of fixed width, enums within AtMost(), std::string, optional,
// pair, array, vector and deque of fields, Eigen matrices of fixed size, types with VisitState(), and types with
// SaveState(StateWriter&) const and LoadState(StateReader&). Numbers are little-endian, floating-point ones their bits.
//
// The reader may be given damaged or hostile bytes. The first thing that is wrong stays (status()), and from there on
// every number read is zero and every list empty, so that code which reads need not look at each step; but nothing that
// was read may be used before the status is. No more is allocated than a small multiple of the bytes that are there.
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

static_assert(std::endian::native == std::endian::little, "numbers are copied as the little-endian machine has them");

class StateWriter {
 public:
  static constexpr bool kReading = false;

  template <typename... Fields>
  void operator()(const Fields&... fields);

  // The number of things that follow, for what no field type fits.
  void Count(const size_t& count);
  // A number that is mostly small, in as many bytes as it has groups of seven bits.
  void Varint(const uint64_t& number);
  void Bytes(absl::string_view bytes);  // with their length before them
  void Raw(const void* bytes, size_t size) { bytes_.append(static_cast<const char*>(bytes), size); }
  // What a reader asks of what it has read; a writer need not ask.
  void Check(bool, absl::string_view) {}

  size_t size() const { return bytes_.size(); }
  std::string Take() { return std::move(bytes_); }

 private:
  std::string bytes_;
};

class StateReader {
 public:
  static constexpr bool kReading = true;

  explicit StateReader(absl::string_view bytes) : bytes_(bytes) {}

  template <typename... Fields>
  void operator()(Fields&&... fields);

  // At most as large as the number of bytes that remain: what follows is at least a byte each.
  void Count(size_t& count);
  void Varint(uint64_t& number);
  // A view into the reader's bytes.
  absl::string_view Bytes();
  // Zeros when there are not enough bytes.
  void Raw(void* bytes, size_t size);
  // Fails with `what`, as in "the row lies outside the sensor", unless `good`.
  void Check(bool good, absl::string_view what) {
    if (!good) Fail(what);
  }
  void Fail(absl::string_view what);

  bool ok() const { return status_.ok(); }
  size_t remaining() const { return bytes_.size() - position_; }
  // DATA_LOSS with what was wrong first, and where.
  const absl::Status& status() const { return status_; }
  // The same, and bytes that are left over are wrong, too. Call last.
  absl::Status Finish();

 private:
  absl::string_view bytes_;
  size_t position_ = 0;
  absl::Status status_;
};

// A number or enum that is to lie within first..last, which are what they are when the range is made: a bound that was
// read is known in the next call only, not further back in the same one.
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

// 0..last.
template <typename Field>
StateInRange<Field> AtMost(Field& field, std::type_identity_t<std::remove_const_t<Field>> last) {
  return {field, static_cast<std::remove_const_t<Field>>(0), last};
}

// A floating-point number or a matrix of them, none of which may be infinite or NaN.
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

// Not with resize(): a count that lies would allocate before the bytes are found to be missing.
template <typename List>
void ReadList(StateReader& reader, List& list) {
  size_t count = 0;
  reader.Count(count);
  list.clear();
  for (size_t i = 0; i < count && reader.ok(); ++i) {
    typename List::value_type item{};  // on its own: vector<bool> has no references
    Visit(reader, item);
    list.push_back(std::move(item));
  }
  if (!reader.ok()) list.clear();
}

template <typename Archive, typename List>
void VisitList(Archive& archive, List& list) {
  if constexpr (Archive::kReading) {
    ReadList(archive, list);
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
  archive.Check(byte <= 1, "a truth value is neither 0 nor 1");
  if constexpr (Archive::kReading) field = byte == 1;
}

template <typename Archive, typename Field>
void VisitInRange(Archive& archive, const StateInRange<Field>& range) {
  archive.Raw(&range.field, sizeof(Field));
  if constexpr (Archive::kReading) {
    // Written so that NaN is outside.
    if (range.field >= range.first && range.field <= range.last) return;
    archive.Fail("a number or a choice outside its range");
    range.field = range.first;
  }
}

template <typename Archive, typename Field>
void VisitFinite(Archive& archive, const StateFinite<Field>& finite) {
  Visit(archive, finite.field);
  if constexpr (Archive::kReading) {
    // x - x is NaN for what is not finite.
    bool all_finite = true;
    if constexpr (std::is_floating_point_v<Field>) {
      all_finite = finite.field - finite.field == 0;
    } else {
      for (int i = 0; i < Field::SizeAtCompileTime; ++i) {
        all_finite &= finite.field.data()[i] - finite.field.data()[i] == 0;
      }
    }
    archive.Check(all_finite, "a number is infinite or none");
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
    static_assert(FixedMatrix<T>, "no field of a state: give it VisitState(archive, self)");
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

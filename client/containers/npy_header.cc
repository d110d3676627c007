// SPDX-License-Identifier: Apache-2.0
#include "client/containers/npy_header.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <limits>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// Bounds memory; the header of an array of events has some hundred bytes.
constexpr size_t kMaxNpyHeaderBytes = size_t{64} * 1024;
constexpr size_t kMaxItemBytes = 4096;  // bounds the piece that is read; an event has at most some tens of bytes
constexpr int kMaxDepth = 8;            // nesting of sequences in a literal; the header of an array has three levels

// A literal of Python: a string, a word or number, or a sequence (tuple, list, dictionary of keys and values).
struct Literal {
  enum class Kind { kString, kWord, kSequence };
  Kind kind = Kind::kWord;
  std::string text;
  std::vector<Literal> items;
};

class LiteralParser {
 public:
  explicit LiteralParser(std::string_view text) : text_(text) {}

  std::optional<Literal> Parse(int depth = 0) {
    SkipBlanks();
    if (text_.empty() || depth > kMaxDepth) return std::nullopt;
    const char first = text_[0];
    if (first == '\'' || first == '"') return ParseString(first);
    if (first == '(' || first == '[' || first == '{') return ParseSequence(depth);
    Literal word;
    const auto is_word = [](char c) { return absl::ascii_isalnum(static_cast<unsigned char>(c)) || c == '-'; };
    while (!text_.empty() && is_word(text_[0])) TakeTo(word.text);
    if (word.text.empty()) return std::nullopt;
    return word;
  }

 private:
  void TakeTo(std::string& out) {
    out += text_[0];
    text_.remove_prefix(1);
  }

  void SkipBlanks() {
    while (!text_.empty() && (text_[0] == ' ' || text_[0] == '\n' || text_[0] == ',' || text_[0] == ':')) {
      text_.remove_prefix(1);
    }
  }

  std::optional<Literal> ParseString(char quote) {
    Literal literal{Literal::Kind::kString, {}, {}};
    text_.remove_prefix(1);
    while (!text_.empty() && text_[0] != quote) TakeTo(literal.text);
    if (text_.empty()) return std::nullopt;
    text_.remove_prefix(1);
    return literal;
  }

  std::optional<Literal> ParseSequence(int depth) {
    Literal literal{Literal::Kind::kSequence, {}, {}};
    text_.remove_prefix(1);
    while (true) {
      SkipBlanks();
      if (text_.empty()) return std::nullopt;
      if (text_[0] == ')' || text_[0] == ']' || text_[0] == '}') break;
      std::optional<Literal> item = Parse(depth + 1);
      if (!item) return std::nullopt;
      literal.items.push_back(*std::move(item));
    }
    text_.remove_prefix(1);
    return literal;
  }

  std::string_view text_;
};

absl::Status HeaderError(absl::string_view what) {
  return absl::InvalidArgumentError(absl::StrCat("the header of the NumPy array ", what));
}

// "<u2", "|b1", "<f8". The kind of a type that cannot be read is '?'.
absl::StatusOr<NpyField> ParseType(const std::string& text) {
  NpyField field;
  size_t size = 0;
  const bool has_order = !text.empty() && (text[0] == '<' || text[0] == '>' || text[0] == '|' || text[0] == '=');
  const size_t kind = has_order ? 1 : 0;
  if (text.size() < kind + 2) return HeaderError("has an item of an unknown type");
  std::string digits = text.substr(kind + 1);
  digits = digits.substr(0, digits.find('['));  // the unit of a time, "<M8[us]"
  if (!absl::SimpleAtoi(digits, &size) || size > kMaxItemBytes) return HeaderError("has an item of an unknown type");
  field.is_big_endian = text[0] == '>';
  field.kind = text[kind];
  field.size = field.kind == 'U' ? 4 * size : size;
  const bool is_number =
      (field.kind == 'b' && size == 1) || (field.kind == 'f' && (size == 4 || size == 8)) ||
      ((field.kind == 'i' || field.kind == 'u') && (size == 1 || size == 2 || size == 4 || size == 8));
  if (!is_number) field.kind = '?';
  return field;
}

absl::Status ReadTypes(const Literal& descr, NpyHeader& header) {
  if (descr.kind == Literal::Kind::kString) {
    EVPOSE_ASSIGN_OR_RETURN(const NpyField field, ParseType(descr.text));
    header.fields = {field};
    header.item_bytes = field.size;
    return absl::OkStatus();
  }
  for (const Literal& entry : descr.items) {
    const bool is_field = entry.items.size() == 2 && entry.items[0].kind == Literal::Kind::kString &&
                          entry.items[1].kind == Literal::Kind::kString;
    if (!is_field) return HeaderError("has items with arrays or items inside");
    EVPOSE_ASSIGN_OR_RETURN(NpyField field, ParseType(entry.items[1].text));
    field.name = entry.items[0].text;
    field.offset = header.item_bytes;
    header.item_bytes += field.size;
    if (header.item_bytes > kMaxItemBytes) return HeaderError("has items above 4096 bytes");
    header.fields.push_back(std::move(field));
  }
  return absl::OkStatus();
}

absl::Status ReadDictionary(const Literal& dictionary, NpyHeader& header) {
  bool has_types = false;
  bool has_shape = false;
  for (size_t i = 0; i + 1 < dictionary.items.size(); i += 2) {
    const std::string& key = dictionary.items[i].text;
    const Literal& value = dictionary.items[i + 1];
    if (key == "descr") {
      has_types = true;
      EVPOSE_RETURN_IF_ERROR(ReadTypes(value, header));
    } else if (key == "fortran_order") {
      header.is_fortran_order = value.text == "True";
    } else if (key == "shape") {
      has_shape = true;
      for (const Literal& length : value.items) {
        int64_t number = 0;
        if (!absl::SimpleAtoi(length.text, &number) || number < 0) return HeaderError("has no valid shape");
        header.shape.push_back(number);
      }
    }
  }
  if (!has_types || !has_shape || header.item_bytes == 0) return HeaderError("states no types or no shape");
  return absl::OkStatus();
}

}  // namespace

int64_t NpyHeader::num_items() const {
  int64_t count = 1;
  for (const int64_t length : shape) {
    if (__builtin_mul_overflow(count, length, &count)) return std::numeric_limits<int64_t>::max();
  }
  return count;
}

absl::StatusOr<std::optional<NpyHeader>> ParseNpyHeader(std::string_view prefix) {
  const auto byte = [&prefix](size_t i) { return static_cast<size_t>(static_cast<unsigned char>(prefix[i])); };
  if (!kNpyMagic.starts_with(prefix.substr(0, kNpyMagic.size()))) return HeaderError("is missing");
  if (prefix.size() < 12) return std::nullopt;
  const size_t version = byte(6);
  if (version < 1 || version > 3) return HeaderError(absl::StrCat("has the unknown version ", version));
  const size_t begin = version == 1 ? 10 : 12;
  const size_t size = version == 1 ? byte(8) | byte(9) << 8 : byte(8) | byte(9) << 8 | byte(10) << 16 | byte(11) << 24;
  if (size > kMaxNpyHeaderBytes) return HeaderError("is above 64 KiB");
  if (prefix.size() < begin + size) return std::nullopt;
  const std::optional<Literal> dictionary = LiteralParser(prefix.substr(begin, size)).Parse();
  if (!dictionary) return HeaderError("is not a dictionary");
  NpyHeader header;
  EVPOSE_RETURN_IF_ERROR(ReadDictionary(*dictionary, header));
  header.size_bytes = begin + size;
  return header;
}

NpyNumber ReadNumber(const NpyField& field, const uint8_t* item) {
  std::array<uint8_t, 8> bytes = {};
  std::copy_n(item + field.offset, field.size, bytes.begin());
  if (field.is_big_endian) std::reverse(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(field.size));
  uint64_t bits = 0;
  std::memcpy(&bits, bytes.data(), sizeof(bits));
  if (field.kind == 'f') {
    double value = 0.0;
    float narrow = 0.0F;
    std::memcpy(&value, bytes.data(), sizeof(value));
    std::memcpy(&narrow, bytes.data(), sizeof(narrow));
    return {false, 0, field.size == 8 ? value : static_cast<double>(narrow)};
  }
  auto integer = static_cast<int64_t>(std::min<uint64_t>(bits, std::numeric_limits<int64_t>::max()));
  if (field.kind == 'i') {
    const int unused_bits = 64 - 8 * static_cast<int>(field.size);
    integer = static_cast<int64_t>(bits << unused_bits) >> unused_bits;  // extends the sign
  }
  return {true, integer, static_cast<double>(integer)};
}

}  // namespace evpose::client
